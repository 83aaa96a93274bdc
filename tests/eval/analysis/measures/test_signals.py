"""Red lights that are run: by whom, where, and what the recording did there."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_eval.analysis.measures.signals import passages
from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.scene import OBSTACLE_KINDS, AgentTable, Controller
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals
from made_runs import make_run, table

NET = packaged("nets/urban_like.net.xml")
STEPS = 41
LINE = -114.6
GREEN_FROM = 21


@pytest.fixture(scope="module")
def signals() -> Signals:
    """Traffic from the west has red until it has green at step GREEN_FROM; of the others nothing is known."""
    links = read_links(NET)
    group = np.array([0 if link.from_lane.startswith("WA") else 1 for link in links])
    states = np.full((2, STEPS), int(SignalState.UNAVAILABLE), np.uint8)
    states[0, :GREEN_FROM], states[0, GREEN_FROM:] = int(SignalState.RED), int(SignalState.GREEN)
    return Signals(("east", "rest"), links, group, states)


def tables(**by_agent: Any) -> list[AgentTable]:
    """Two cars on WA_1 at 10 m/s: 1 has its front 5 m before the line at step 0, 2 has 25 m."""
    first, second = (
        {"id": 1, "y": -4.95, **by_agent.get("first", {})},
        {"id": 2, "y": -4.95, **by_agent.get("second", {})},
    )
    return [table(k, first | {"x": LINE - 2.0 - 5.0 + k}, second | {"x": LINE - 2.0 - 25.0 + k}) for k in range(STEPS)]


def test_who_passes_at_what(signals: Signals) -> None:
    drivers = {"first": {"controller": Controller.EGO}, "second": {"controller": Controller.POLICY}}
    at_red, at_green = passages(signals, tables(**drivers))
    assert (at_red.agent, at_red.step, at_red.state, at_red.at_red) == (1, 6, SignalState.RED, True)
    assert (at_red.connection, at_red.group, at_red.controller) == ("WA_1 -> AB_1", "east", Controller.EGO)
    assert (at_green.agent, at_green.step, at_green.at_red) == (2, 26, False)
    assert passages(signals, []) == []


def test_lights_of_lanes_are_not_for_pedestrians_and_cyclists(signals: Signals) -> None:
    for kind in OBSTACLE_KINDS:
        found = passages(signals, tables(first={"kind": kind}))
        assert [passage.agent for passage in found] == [2]


def test_metrics_count_by_driver_and_know_the_log(signals: Signals) -> None:
    run = tables(first={"controller": Controller.EGO}, second={"controller": Controller.POLICY})
    late = [table.take(np.array([1])) for table in run]
    metrics = compute_metrics(make_run(run, late, signals=signals, net_xml=NET.read_bytes(), history_steps=2))
    found = metrics["signals"]
    assert (found["passed"], found["red_ego"], found["red_controlled"], found["red_log"]) == (2, 1, 0, 0)
    assert found["reds"] == [{"agent": 1, "step": 6, "connection": "WA_1 -> AB_1", "group": "east", "by": "ego"}]
    assert compute_metrics(make_run(run, late, net_xml=NET.read_bytes(), history_steps=2))["signals"] is None


def test_what_is_passed_in_the_history_is_not_of_the_run(signals: Signals) -> None:
    run = tables()
    for history, passed in ((5, 2), (6, 1)):  # the first passes at step 6
        metrics = compute_metrics(make_run(run, run, signals=signals, net_xml=NET.read_bytes(), history_steps=history))
        assert metrics["signals"]["passed"] == passed


@pytest.mark.parametrize(("amber_from", "run_amber"), [(2, 1), (10, 0)])
def test_amber_is_run_by_who_could_stop_when_it_began(signals: Signals, amber_from: int, run_amber: int) -> None:
    """The ego, at 10 m/s, is 35 m before the line at step 0, and needs 26.4 m: 10 within 1 s, and 16.4 to brake."""
    states = signals.states.copy()
    states[0] = np.where(np.arange(STEPS) < amber_from, SignalState.GREEN, SignalState.AMBER)
    run = [replace(table, x=table.x - 30.0) for table in tables(first={"speed": 10.0})]
    changed = Signals(signals.groups, signals.links, signals.link_group, states)
    made = make_run(run, run, signals=changed, net_xml=NET.read_bytes(), history_steps=1)
    assert compute_metrics(made)["signals"]["amber_ego"] == run_amber
