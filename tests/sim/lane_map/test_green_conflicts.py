"""Programs of nets in which connections that conflict have priority green together."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from litsim_data.cli import main
from litsim_sim.lane_map.green_conflicts import conflicting_pairs, may_give_way, program_conflicts
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.scenario import packaged, packaged_nets

URBAN = packaged("nets/urban_like.net.xml")
MAIN = 'duration="28" state="GGGgrrrGGGgrrr"'  # of both junctions; WA and BA go straight, turn right, turn left


@pytest.fixture
def net(tmp_path: Path) -> Callable[[str], Path]:
    """The packaged street with another state in the first phase of the light at junction A."""

    def made(state: str) -> Path:
        text = URBAN.read_text()
        assert text.count(MAIN) == 2
        path = tmp_path / "street.net.xml"
        path.write_text(text.replace(MAIN, f'duration="28" state="{state}"', 1))
        return path

    return made


@pytest.mark.parametrize("name", packaged_nets())
def test_packaged_nets_have_no_such_program(name: str) -> None:
    assert program_conflicts(packaged(f"nets/{name}.net.xml")) == ()


def test_a_left_turn_with_priority_and_oncoming_traffic_too(net: Callable[[str], Path]) -> None:
    (said,) = program_conflicts(net("GGGGrrrGGGgrrr"))
    assert said == (
        "junction A: program 0 of light A has G for BA_0 -> AAN_0 and WA_2 -> AAN_0 (and 2 more pairs), which "
        "conflict, in phase 0, 0 to 28 s into the cycle; expected g for those that give way"
    )


def test_a_left_turn_that_gives_way_is_legal_and_so_is_one_alone(net: Callable[[str], Path]) -> None:
    assert program_conflicts(net("GGGgrrrGGGgrrr")) == ()
    assert program_conflicts(net("rrrGrrrrrrGrrr")) == ()


def test_the_check_of_a_map_misses_a_goal(net: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    """SUMO warns only of connections that merge, and these cross."""
    with pytest.raises(SystemExit, match="1"):
        main(["map", "--check", str(net("gGGgrrrGGGGrrr"))])
    (said,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("MISSED")]
    assert said.startswith("MISSED: junction A: program 0 of light A has G for BA_2 -> AAS_0 and WA_0 -> AB_0 (and 1 ")


def test_a_net_that_does_not_say_who_conflicts_has_no_conflicts(tmp_path: Path) -> None:
    path = tmp_path / "street.net.xml"
    path.write_text(re.sub(r"<request .*/>", "", URBAN.read_text()))
    links = read_links(path)
    assert len(links) == 28 and conflicting_pairs(links) == [] and program_conflicts(path) == ()


def test_connections_of_one_edge_are_no_pairs_and_each_pair_is_found_once() -> None:
    links = read_links(URBAN)
    pairs = [{links[i].name, links[j].name} for i, j in conflicting_pairs(links)]
    assert len(pairs) == 76 == len({frozenset(pair) for pair in pairs})
    assert all(len({name.partition("_")[0] for name in pair}) == 2 for pair in pairs)


@pytest.mark.parametrize(
    ("degrees", "turns", "usual"),
    [(180, True, True), (150, True, True), (20, True, True), (90, True, False), (120, True, False), (20, False, False)],
)
def test_who_turns_gives_way_to_the_same_and_to_the_opposite_direction(degrees: int, turns: bool, usual: bool) -> None:
    link = replace(read_links(URBAN)[0], turns=False)
    other = replace(link, turns=turns, heading=link.heading + np.deg2rad(degrees))
    assert may_give_way(link, other) == may_give_way(other, link) == usual
