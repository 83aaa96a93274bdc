"""Futures in agent frames as forecasts in frame map."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_predictor.forecast import Forecast
from litsim_predictor.inference.contract import AgentFutures, FurtherFutures
from litsim_predictor.inference.in_map import forecast_in_map
from litsim_sim.core.scene import AgentTable

Build = Callable[..., AgentTable]
X, Y, TURN = 100.0, -20.0, 0.3
MEAN = np.array([[1.0, 0.0], [2.0, 0.5], [2.0, 0.5]])
SCALE, CORRELATION = (2.0, 0.5), 0.4


def placed(build: Build, further: float = 1.0) -> Forecast:
    """Of two agents in one place: the first with a second mode, whose means are `further` times as far away."""
    agents = build(7, *({"id": k, "x": X, "y": Y, "yaw": TURN, "speed": 5.0} for k in (3, 4)))
    frame = np.tile([X, Y, TURN], (2, 1))

    def gaussians(times: float, n: int) -> Any:
        wide = np.tile(np.float32(SCALE), (n, len(MEAN), 1))
        correlation = np.full((n, len(MEAN)), np.float32(CORRELATION))
        return np.tile((times * MEAN).astype(np.float32), (n, 1, 1)), wide, correlation

    probability = np.array([[0.7, 0.3], [1.0, 0.0]], np.float32)
    second = FurtherFutures(np.array([0]), np.array([1]), *gaussians(further, 1))
    return forecast_in_map(AgentFutures(probability, *gaussians(1.0, 2), second), frame, agents)


def test_means_headings_and_covariances_are_turned_with_the_frame(agent_table: Build) -> None:
    out = placed(agent_table, further=2.0)
    turn = np.array([[math.cos(TURN), -math.sin(TURN)], [math.sin(TURN), math.cos(TURN)]])
    assert out.mean[1] == pytest.approx(np.array([X, Y]) + MEAN @ turn.T)
    assert out.modes.mean[0] == pytest.approx(np.array([X, Y]) + 2.0 * MEAN @ turn.T)
    expected = TURN + np.array([0.0, math.atan2(0.5, 1.0), math.atan2(0.5, 1.0)])  # who stands keeps his heading
    assert out.yaw[1] == pytest.approx(expected) and out.modes.yaw[0] == pytest.approx(expected)

    across = CORRELATION * SCALE[0] * SCALE[1]
    turned = turn @ np.array([[SCALE[0] ** 2, across], [across, SCALE[1] ** 2]]) @ turn.T
    sigma = np.sqrt(np.diag(turned))
    assert out.covariance[0, 2] == pytest.approx([*sigma, turned[0, 1] / sigma.prod()], rel=1e-6)
    assert out.modes.row.tolist() == [0] and out.modes.probability == pytest.approx([0.3])


def test_what_is_no_number_is_not_valid(agent_table: Build) -> None:
    assert placed(agent_table).valid.all() and len(placed(agent_table).modes) == 1
    broken = placed(agent_table, further=math.nan)
    assert broken.valid.all() and not len(broken.modes)
