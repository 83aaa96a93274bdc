"""Stop lines: who has to stop where, and that everybody that LitSim drives does."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.policy_c import PolicyC
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_policy.motion.car_following import GAP_MIN, IdmConfig
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import lane_path, logged_path
from litsim_policy.motion.stop_lines import StopLines, idm_at_signals
from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable, ControlTable, EgoCommand, EgoMode
from litsim_sim.core.signals import SignalState
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.scenario import Scenario, packaged
from litsim_sim.scenario.signals import Signals
from litsim_sim.world.world import World
from made_agents import takeover

NET = packaged("nets/urban_like.net.xml")
LINKS = read_links(NET)
LINE, Y = -114.6, {"WA_0": -8.25, "WA_1": -4.95, "WA_2": -1.65}
LENGTH = 4.0


def showing(**states: SignalState) -> Signals:
    """Signals that never change: `right` and `straight` of WA_0 and WA_1, `left`; of all others nothing is known."""
    names = ("left", "rest", "right", "straight")
    turns = {"WA_0 -> AAS_0": "right", "WA_0 -> AB_0": "straight", "WA_1 -> AB_1": "straight", "WA_2 -> AAN_0": "left"}
    group = np.array([names.index(turns.get(link.name, "rest")) for link in LINKS])
    shown = [[int(states.get(name, SignalState.UNAVAILABLE))] for name in names]
    return Signals(names, LINKS, group, np.array(shown, np.uint8))


def path_over(link: str) -> np.ndarray:
    """The way from 80 m before the stop line over a junction by the connection named `link`, and 40 m on."""
    found = next(each for each in LINKS if each.name == link)
    before = found.stop - 80.0 * np.array([np.cos(found.heading), np.sin(found.heading)])
    on = found.exit + 40.0 * np.array([np.cos(found.exit_heading), np.sin(found.exit_heading)])
    return np.array([before, found.stop, found.exit, on])


def at_speeds(*speeds: float) -> AgentTable:
    """Agents of which nothing else is looked at, at step 0."""
    columns = {"id": np.arange(len(speeds)), "speed": np.array(speeds), "length": np.full(len(speeds), LENGTH)}
    return AgentTable(0, *(columns.get(name, np.zeros(len(speeds))) for name in ARRAY_FIELDS))


def gap(signals: Signals, link: str, to_line: float, speed: float) -> float:
    """Of an agent whose front is `to_line` m before the line, on the way over `link`."""
    lines = StopLines(signals)
    batch, s = PathBatch.of([path_over(link)]), np.array([80.0 - to_line - 0.5 * LENGTH])
    return float(lines.gaps(at_speeds(speed), np.array([0]), batch, s)[0])


def test_the_signal_of_the_own_way_counts() -> None:
    signals = showing(straight=SignalState.GREEN, right=SignalState.RED, left=SignalState.RED_AMBER)
    assert gap(signals, "WA_0 -> AAS_0", 30.0, 10.0) == pytest.approx(30.0)
    assert gap(signals, "WA_0 -> AB_0", 30.0, 10.0) == np.inf  # the same lane
    assert gap(signals, "WA_1 -> AB_1", 30.0, 10.0) == np.inf
    assert gap(signals, "WA_2 -> AAN_0", 30.0, 10.0) == pytest.approx(30.0)
    assert gap(signals, "EB_1 -> BA_1", 30.0, 10.0) == np.inf  # nothing is known of it


@pytest.mark.parametrize("state", SignalState)
def test_states(state: SignalState) -> None:
    stops = {SignalState.RED, SignalState.RED_AMBER, SignalState.AMBER, SignalState.AMBER_PERMISSIVE}
    assert (gap(showing(straight=state), "WA_1 -> AB_1", 40.0, 10.0) < np.inf) == (state in stops)


def test_who_cannot_stop_drives_on() -> None:
    red, amber = showing(straight=SignalState.RED), showing(straight=SignalState.AMBER)
    needs_4 = 10.0**2 / (2.0 * 4.0)
    assert gap(red, "WA_1 -> AB_1", needs_4, 10.0) == pytest.approx(needs_4)
    assert gap(amber, "WA_1 -> AB_1", needs_4, 10.0) == np.inf
    assert gap(amber, "WA_1 -> AB_1", 2.0 * needs_4, 10.0) == pytest.approx(2.0 * needs_4)
    assert gap(red, "WA_1 -> AB_1", 5.0, 10.0) == np.inf  # 10 m/s2
    assert gap(red, "WA_1 -> AB_1", -0.5, 0.0) == GAP_MIN  # on the line
    assert gap(red, "WA_1 -> AB_1", -1.5, 0.0) == np.inf  # past it


def test_several_agents_are_answered_as_one_is() -> None:
    signals = showing(straight=SignalState.RED, left=SignalState.AMBER)
    ways = ["WA_2 -> AAN_0", "EB_1 -> BA_1", "WA_1 -> AB_1", "WA_0 -> AB_0"]
    to_line, speed = np.array([20.0, 20.0, 35.0, 4.0]), [8.0, 8.0, 12.0, 2.0]
    alone = [gap(signals, way, t, v) for way, t, v in zip(ways, to_line, speed, strict=True)]
    table, rows, paths = at_speeds(*speed), np.arange(4), PathBatch.of([path_over(way) for way in ways])
    together = StopLines(signals).gaps(table, rows, paths, 80.0 - to_line - 0.5 * LENGTH)
    assert together == pytest.approx(alone)
    assert StopLines(None).gaps(table, rows, paths, np.ones(4)).tolist() == [np.inf] * 4


@given(speed=st.floats(0.0, 20.0), before=st.floats(-8.0, 2.0), distance=st.floats(0.1, 200.0))
def test_a_red_light_only_ever_slows_down(speed: float, before: float, distance: float) -> None:
    given_, fast = np.array([before]), np.array([speed])
    limited = idm_at_signals(IdmConfig(), fast, fast, given_, np.array([distance]))
    assert limited[0] <= before
    assert idm_at_signals(IdmConfig(), fast, fast, given_, np.array([np.inf]))[0] == before


# The loop: everybody stops before the line, and goes on at green.

CHANGES = [[0.0, "east", "red"], [9.0, "east", "green"]]
Answer = Callable[[AgentTable], ControlTable]


@pytest.fixture(scope="module")
def approach(make_scenario: Any, track: Any) -> Scenario:
    """Agent 2 drives at 12 m/s towards a light that is red until 9 s; the ego stands far from there."""
    signals = {"groups": {"east": ["WA_0", "WA_1", "WA_2"]}, "changes": CHANGES}
    far = track(1, x=220.0, y=-4.95, speed=0.0, last=160)
    comes = track(2, x=-210.0, y=Y["WA_1"], speed=12.0, last=160)
    return make_scenario(far, comes, net="urban_like", signals=signals)


def yields(scenario: Scenario) -> Answer:
    policy = YieldPolicy(scenario)
    path = logged_path(scenario.log, scenario.lane_map, 2).points
    return lambda table: policy.act(table, TakeoverTable(table.step, (takeover(2, reference_path=path),)))


def policy_c(scenario: Scenario) -> Answer:
    """Whatever its network asks for."""
    says = SimpleNamespace(observation=ObservationConfig(), mean=lambda seen: np.tile([0.2, 0.0, 0.0], (len(seen), 1)))
    policy = PolicyC(scenario, network=says)
    path = logged_path(scenario.log, scenario.lane_map, 2).points
    return lambda table: policy.act(table, TakeoverTable(table.step, (takeover(2, reference_path=path),)))


@pytest.mark.parametrize("make", [yields, policy_c])
def test_agents_under_control_stop_at_red(approach: Scenario, make: Callable[[Scenario], Answer]) -> None:
    answer, world = make(approach), World(approach)
    table, front = world.reset(), []
    for _ in range(150):
        row = table.row(2)
        front.append(float(table.x[row] + 0.5 * table.length[row]))
        table = world.step(answer(table), EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG))
    assert max(front[:91]) < LINE + 0.5
    assert front[90] > LINE - 12.0, "it stops at the line, not anywhere"
    assert front[149] > LINE + 2.0, "it goes on at green"


def test_the_idm_ego_stops_at_red_and_goes_at_green(make_scenario: Any, track: Any, drive: Any) -> None:
    signals = {"groups": {"east": ["WA_0", "WA_1"]}, "changes": CHANGES}
    comes = track(1, x=-180.0, y=Y["WA_1"], speed=10.0, last=150)
    for given_, stops in ((signals, True), (None, False)):
        scenario = make_scenario(comes, net="urban_like", **({"signals": given_} if given_ else {}))
        front = drive(scenario, "idm", "replay").series(1, "x") + 2.25
        assert (front[:91].max() < LINE) == stops
        assert front[-1] > LINE + 5.0


def test_lane_paths_of_the_ego_find_their_light(approach: Scenario) -> None:
    """The path that egos follow is made of the net's lanes, curves over the junction included."""
    for lane, y in Y.items():
        path = lane_path(approach.lane_map, -150.0, y, 0.0)
        found = StopLines(approach.signals).gaps(at_speeds(5.0), np.array([0]), path.batch, np.zeros(1))
        assert found == pytest.approx([150.0 + LINE - 0.5 * LENGTH], abs=0.1), lane
