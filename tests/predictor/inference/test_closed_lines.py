"""Signals in forecasts: closed stop lines are among what a network sees."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_predictor.inference.closed_lines import LENGTH, ClosedLines
from litsim_predictor.inference.contract import HISTORY
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.scenario import Scenario

Build = Callable[..., AgentTable]
STOP_X = -114.6
"""Where WA_0, WA_1 and WA_2 end, which lead along +x; WA_0 leads straight on and to the right."""
GROUPS = {"straight": ["WA_0 -> AB_0", "WA_1"], "right": ["WA_0 -> AAS_0"], "left": ["WA_2"], "side": ["ANA_0"]}


@pytest.fixture
def street(make_scenario: Callable[..., Any], track: type) -> Callable[..., Scenario]:
    def made(*changes: tuple[float, str, str], last: int = 80) -> Scenario:
        far = track(9, x=-200.0, y=-4.95, speed=0.0, last=last)
        signals = {"groups": GROUPS, "changes": [list(change) for change in changes]}
        return make_scenario(far, track(1, x=-190.0, y=-8.25, last=last), net="urban_like", signals=signals, ego=1)

    return made


def all_show(state: str, *others: str) -> list[tuple[float, str, str]]:
    return [(0.0, group, "green" if group in others else state) for group in GROUPS]


def test_a_line_is_closed_if_all_connections_from_its_lane_are(street: Callable[..., Scenario]) -> None:
    scenario = street(*all_show("red", "right"), (2.0, "left", "green"), (2.0, "right", "amber"))
    assert scenario.signals is not None
    lines = ClosedLines(scenario.signals)
    at = {tuple(np.round(pose[:2], 2)): row for row, pose in enumerate(lines.pose)}
    rows = [at[STOP_X, y] for y in (-8.25, -4.95, -1.65)]
    assert lines.closed(0)[0, rows].tolist() == [False, True, True]
    assert lines.closed(20)[0, rows].tolist() == [True, True, False]


def test_what_a_network_sees_of_lines_is_near_and_as_old_as_they_are_closed(
    street: Callable[..., Scenario], agent_table: Build
) -> None:
    scenario = street(*all_show("green"), (1.0, "straight", "red"))
    assert scenario.signals is not None
    lines = ClosedLines(scenario.signals)
    agent = {"id": 1, "x": STOP_X - 30.0, "y": -8.25, "speed": 10.0, "yaw": 0.0}
    assert not len(lines.near(agent_table(9, agent)).scene)
    seen = lines.near(agent_table(14, agent))
    assert seen.series[0, -1].tolist() == pytest.approx([STOP_X, -4.95, 0.0, 0.0], abs=0.01)
    assert seen.observed.sum(axis=1).tolist() == [3] and seen.observed.shape == (1, HISTORY)
    assert seen.size[:, 0].tolist() == [LENGTH]
    assert not len(lines.near(agent_table(14, {**agent, "x": 200.0})).scene)
