"""Traffic lights on a net whose map has none: by a file of groups, and by who stops and starts."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from litsim_data.cli import main as data
from litsim_data.maps.light_proposal import propose_lights
from litsim_data.maps.lights import place_lights
from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink, read_links
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import SignalsFile, signals_of
from litsim_sim.world.sumo import SumoMirror

STREET = packaged("nets/urban_like.net.xml")
SECONDS, CYCLE_S = 300, 58.0


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packaged street without its traffic lights."""
    text = re.sub(r"<tlLogic.*?</tlLogic>", "", STREET.read_text(), flags=re.DOTALL)
    text = re.sub(r' tl="[^"]*" linkIndex="[^"]*"', "", text).replace('type="traffic_light"', 'type="priority"')
    path: Path = tmp_path_factory.mktemp("dark") / "dark.net.xml"
    path.write_text(text)
    assert not read_links(path)
    return path


@pytest.fixture(scope="module")
def driven(dark: Path) -> Path:
    """Five cycles of traffic at the lights of the packaged street."""
    path = dark.with_name("street.parquet")
    data(["synthesize", "--net", "urban_like", "--seed", "5321", "--seconds", str(SECONDS), "--out", str(path)])
    return path


def links_of(net: Path) -> dict[str, SignalLink]:
    return {link.name: link for link in read_links(net)}


def test_lights_are_where_the_groups_say_and_nothing_else_changes(dark: Path, tmp_path: Path) -> None:
    lit, groups = tmp_path / "lit.net.xml", tmp_path / "groups.yaml"
    content = {"groups": {"1": ["WA"], "2": ["BA_2 -> AAS_0"], "9": []}, "states": {"file": "not_there_yet.csv"}}
    groups.write_text(yaml.safe_dump(content))
    data(["map", "--lights", str(dark), "--signals", str(groups), "--out", str(lit)])
    there = links_of(STREET)
    assert links_of(lit).keys() == {name for name in there if name.startswith("WA_")} | {"BA_2 -> AAS_0"}
    for name, link in links_of(lit).items():
        assert (link.junction, link.via, link.turns) == (there[name].junction, there[name].via, there[name].turns)
        assert link.stop.tolist() == there[name].stop.tolist()
    assert {*links_of(lit)["BA_2 -> AAS_0"].foes} == {*there["BA_2 -> AAS_0"].foes} & links_of(lit).keys()
    one, other = LaneMap.from_net(dark).lanes, LaneMap.from_net(lit).lanes
    assert [lane.id for lane in one] == [lane.id for lane in other]
    assert all(np.array_equal(a.centerline, b.centerline) for a, b in zip(one, other, strict=True))


def test_sumo_shows_what_the_signals_of_such_a_net_show(dark: Path, tmp_path: Path, agent_table: Any) -> None:
    lit, groups = tmp_path / "lit.net.xml", {"1": ["WA"], "2": ["BA"]}
    place_lights(dark, groups, lit, "here")
    signals = signals_of(
        SignalsFile(groups=groups, changes=[(0.0, "1", "red"), (0.0, "2", "green")]), read_links(lit), 5
    )
    mirror = SumoMirror(lit, 0, signals)
    try:
        mirror.show(agent_table(0))
        import libsumo

        shown = libsumo.trafficlight.getRedYellowGreenState("A")
        letters = {name: shown[link.index] for name, link in links_of(lit).items()}
    finally:
        mirror.close()
    assert letters == {name: "r" if name.startswith("WA") else "G" for name in links_of(lit)}


@pytest.mark.parametrize(
    ("groups", "why"),
    [
        ({"1": ["WB"]}, "WB: the net has no such controlled connection, lane or edge; near: WA"),
        ({"1": ["WA"], "2": ["WA_0"]}, "WA_0 -> AAS_0 is in groups 1 and 2"),
        ({"1": []}, "no group controls a connection"),
    ],
)
def test_groups_that_do_not_fit_the_net_are_refused(
    dark: Path, tmp_path: Path, groups: dict[str, list[str]], why: str
) -> None:
    with pytest.raises(InputError, match=re.escape(why)):
        place_lights(dark, groups, tmp_path / "lit.net.xml", "groups.yaml")


def test_a_junction_with_other_lights_is_left_alone(dark: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "first.net.xml", tmp_path / "second.net.xml"
    place_lights(dark, {"1": ["WA"]}, first, "here")
    place_lights(first, {"1": ["WA"], "2": ["EB"]}, second, "here")  # at another one
    assert {link.junction for link in read_links(second)} == {"A", "B"}
    with pytest.raises(InputError, match=r"junction A of .* has lights on other connections"):
        place_lights(first, {"1": ["WA"], "2": ["BA"]}, second, "here")


def test_lights_are_proposed_where_they_are_with_their_times(
    dark: Path, driven: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lit, picture = tmp_path / "lit.net.xml", tmp_path / "lit.png"
    words = ["--recording", str(driven), "--out", str(lit), "--picture", str(picture)]
    data(["map", "--lights", str(dark), *words])
    assert links_of(lit).keys() == links_of(STREET).keys()
    assert picture.stat().st_size > 10_000
    told = capsys.readouterr().err
    assert "junction A: lights on 14 connections" in told
    assert re.findall(r"(\d+) at red", told) and set(re.findall(r"(\d+) at red", told)) == {"0"}
    recording = Recording.read(driven)
    truth = SignalsFile.model_validate(recording.header.signals)
    proposed = SignalsFile.model_validate(yaml.safe_load((tmp_path / "lit_signals.yaml").read_text()))
    shown = [signals_of(file, read_links(net), SECONDS * 10) for file, net in ((truth, STREET), (proposed, lit))]
    for link in links_of(STREET):
        one, other = (of.states[of.link_group[of.link_names.index(link)]] for of in shown)
        for state in ("green", "red"):
            assert apart(changes_to(one, state), changes_to(other, state)) <= 2.0, link
        assert {*one[600:].tolist()} == {*other[600:].tolist()}, link  # who turns left gives way


def changes_to(states: np.ndarray, state: str) -> np.ndarray:
    """Times within the cycle [s] at which states (steps,) become green, permissive or not, or red."""
    shows = np.isin(states, (5, 6) if state == "green" else (3,))
    return np.flatnonzero(~shows[:-1] & shows[1:]) * 0.1 % CYCLE_S


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """How far any of the times is from the nearest of the others, within the cycle [s]."""
    assert len(one) >= 4 and len(other) >= 4
    off = np.abs(one[:, None] - other)
    return float(np.minimum(off, CYCLE_S - off).min(axis=1).max())


def test_traffic_without_lights_shows_none(dark: Path) -> None:
    recording = Recording.read(packaged("scenarios/us101_like.parquet"))
    with pytest.raises(InputError, match="the recording shows no traffic light"):
        propose_lights(read_links(dark, lights=False), Log.from_recording(recording, 0, 200))


@pytest.mark.parametrize("words", [[], ["--signals", "a.yaml", "--recording", "b.parquet"]])
def test_either_a_file_or_a_recording_says_where(
    dark: Path, words: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        data(["map", "--lights", str(dark), "--out", "out.net.xml", *words])
    assert "either a file of groups with --signals, or a recording" in capsys.readouterr().err
