"""Signals that give green to connections that conflict are told, at load and at conversion."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.recorded_signals import survey
from litsim_sim.scenario.scenario import Scenario, packaged
from litsim_sim.scenario.signal_conflicts import green_conflicts
from litsim_sim.scenario.signals import SignalsFile, signals_of

NET = packaged("nets/urban_like.net.xml")
STREETS = sorted(packaged("suites/small", "litsim_eval").glob("street_*.yaml"))
GROUPS = {"main": ["WA", "BA"], "side": ["ANA", "ASA"]}
CROSS = [[0.0, "main", "green"], [0.0, "side", "red"], [4.0, "side", "green"], [6.0, "main", "amber"]]
SAID = (
    "junction A: groups main and side are both green at 4 s, and for 2 s in all, though ANA_0 -> AAS_0 and "
    "BA_0 -> AW_0 (and 29 more pairs) conflict; are connections and times right, or is one of them green_permissive?"
)


def told(groups: dict[str, list[str]], changes: list[list[Any]], start_frame: int = 0, steps: int = 100) -> list[str]:
    given = SignalsFile.model_validate({"groups": groups, "changes": changes})
    return green_conflicts(given, signals_of(given, read_links(NET), steps, start_frame), start_frame)


@pytest.fixture
def load(make_scenario: Any, track: Any) -> Callable[[Any], Scenario]:
    """A scenario of a car on WA_1 that stands for 10 s, from frame 20 on, with these signals."""
    car = track(1, x=-150.0, y=-4.95, speed=0.0, first=20, last=120, length=4.0, width=1.8)
    return lambda signals: make_scenario(car, history_steps=10, net="urban_like", signals=signals)


def test_streets_that_cross_are_told_with_junction_connections_and_time() -> None:
    assert told(GROUPS, CROSS) == [SAID]


@pytest.mark.parametrize("state", ["green_permissive", "amber", "red", "unavailable", "dark"])
def test_other_states_conflict_with_nobody(state: str) -> None:
    assert told(GROUPS, [[0.0, "main", "green"], [0.0, "side", state]]) == []


def test_plain_colours_do_not_say_that_a_left_turn_gives_way_to_oncoming_traffic() -> None:
    plain = [[0.0, "main", "green"], [0.0, "side", "red"]]
    assert told(GROUPS, plain) == []
    apart = {"west": ["WA"], "east": ["BA"], "side": ["ANA", "ASA"]}
    assert told(apart, [[0.0, "west", "green"], [0.0, "east", "green"], [0.0, "side", "red"]]) == []


@pytest.mark.parametrize("permissive", ["green_permissive", "amber_permissive"])
def test_where_some_states_are_permissive_all_others_are_not(permissive: str) -> None:
    groups = {"through": ["WA_1", "BA_1"], "left": ["WA_2"], "side": ["ANA", "ASA"]}
    begin = [[0.0, "through", "green"], [0.0, "side", "red"]]
    late = [[0.0, "left", permissive], [3.0, "left", "green"], [5.0, "left", "red"]]
    (said,) = told(groups, [*begin, *late])
    assert said.startswith(
        "junction A: groups left and through are both green at 3 s, and for 2 s in all, though BA_1 -> AW_1 and "
        "WA_2 -> AAN_0 conflict; "
    )
    assert told(groups, [*begin, *late[:1]]) == []


def test_a_group_may_conflict_with_itself() -> None:
    (said,) = told({"all": ["WA_1", "ASA_0"]}, [[0.0, "all", "green"]])
    assert said.startswith("junction A: group all is green at 0 s, and for 10 s in all, though ASA_0 -> AAN_0 and")


def test_a_program_is_checked_likewise_and_each_junction_is_told() -> None:
    program = {"phases": [{"duration_s": 5.0, "states": {"main": "green"}}, {"duration_s": 5.0}]}
    program["phases"][0]["states"]["side"] = "green"
    groups = {"main": ["WA", "EB"], "side": ["ANA", "BNB"]}
    given = SignalsFile.model_validate({"groups": groups, "program": program})
    said = green_conflicts(given, signals_of(given, read_links(NET), 400, 0), 0)
    assert [each.partition(" are ")[0] for each in said] == [f"junction {j}: groups main and side" for j in "AB"]
    assert all("at 0 s, and for 20 s in all" in each for each in said)


def test_times_count_from_frame_0_of_the_recording() -> None:
    assert told(GROUPS, CROSS, 45, 100)[0].startswith("junction A: groups main and side are both green at 4.5 s")
    assert told(GROUPS, CROSS, round(6.0 / STEP_S), 100) == []


def test_a_scenario_warns_as_it_is_loaded_once(
    load: Callable[[Any], Scenario], caplog: pytest.LogCaptureFixture
) -> None:
    path = Path(load({"groups": GROUPS, "changes": CROSS}).file.recording).with_suffix(".yaml")
    Scenario.load(path)
    assert caplog.messages == [f"{path}: signals: {SAID}"]
    load({"groups": GROUPS, "changes": CROSS[:2]})
    assert len(caplog.messages) == 1


def test_a_conversion_warns(load: Callable[[Any], Scenario]) -> None:
    given = SignalsFile.model_validate({"groups": GROUPS, "changes": CROSS})
    lines = survey(given, NET, load(None).recording, "made")
    assert lines[2:] == [f"signals    WARNING: {SAID}"]


@pytest.mark.parametrize("path", STREETS, ids=lambda path: path.stem)
def test_generated_traffic_has_no_conflicting_greens(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    signals = Scenario.load(path).signals
    assert signals is not None and len(signals.links) == 28
    assert caplog.messages == []
