"""Signals in forecasts: closed stop lines are among what a network sees."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_predictor.forecast import Forecast
from litsim_predictor.inference.closed_lines import LENGTH, ClosedLines
from litsim_predictor.inference.contract import HISTORY
from litsim_predictor.models import make_predictor
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.batched import BatchedScenario
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


def driven(scenario: Scenario, build: Build, speed: float, front_to_line: float, steps: int = 31) -> Forecast:
    """The last forecast of one who drives up to the line of WA_1, in the last step so far from it."""
    predictor = make_predictor("default", scenario)
    for step in range(steps):
        x = STOP_X - 2.25 - front_to_line - 0.1 * speed * (steps - 1 - step)
        out = predictor.forecast(build(step, {"id": 1, "x": x, "y": -4.95, "speed": speed, "yaw": 0.0}))
    return out


@pytest.mark.parametrize(("speed", "gap", "less"), [(10.0, 30.0, 12.0), (8.0, 20.0, 12.0), (0.0, 1.5, 1.5)])
def test_who_can_stop_at_a_closed_line_is_forecast_to_come_less_far(
    street: Callable[..., Scenario], agent_table: Build, speed: float, gap: float, less: float
) -> None:
    """Than at green, though nobody has braked so far."""
    at_red, at_green = (
        driven(street(*all_show("red", *others)), agent_table, speed, gap).mean[0, -1, 0]
        for others in (("side",), ("straight", "right", "left"))
    )
    assert at_green - at_red > less, (at_red - STOP_X, at_green - STOP_X)


def test_each_scene_of_a_batch_has_its_own_lines(street: Callable[..., Scenario], agent_table: Build) -> None:
    scenes = [street(*all_show("red")), street(*all_show("red", "straight", "right", "left"), last=90)]
    batch = BatchedScenario.of(scenes)
    together, alone = make_predictor("default", batch), [make_predictor("default", scene) for scene in scenes]
    for step in range(4):
        table = batch.log.table(step)
        joint = together.forecast(table)
        apart = [one.forecast(own) for one, own in zip(alone, batch.tables(table), strict=True)]
        assert np.array_equal(joint.mean, np.concatenate([own.mean for own in apart]))
        assert len(joint.id) and not np.array_equal(apart[0].mean, apart[1].mean)
