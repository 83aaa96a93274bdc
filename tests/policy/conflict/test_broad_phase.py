"""The tests before the exact one rule out nothing: boxes that stand still, where no motion hides a mistake."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from litsim_policy.conflict.detection import ConflictDetector

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.futures import PredictedMotion
from strips import Strips

LENGTH, WIDTH = 4.5, 2.0  # [m]
PAIR = np.array([[0, 1]])


@pytest.fixture(scope="module")
def detector(make_scenario, track) -> ConflictDetector:
    return ConflictDetector(make_scenario(track(1, x=100.0)).log, 1e3, ConflictConfig(horizon=0.3))


def standing(x: float, y: float, yaw: float, sigma: float, valid: tuple[bool, ...] = (True,) * 3) -> PredictedMotion:
    """Both rows alike, over three steps."""
    state = [x, y, yaw, sigma**2, sigma**2, 0.0]
    return PredictedMotion(np.tile(state, (2, len(valid), 1)), np.tile(valid, (2, 1)))


def found(agent_table, detector: ConflictDetector, a: PredictedMotion, b: PredictedMotion, least: float) -> np.ndarray:
    """(3,) probabilities that the boxes of a and b overlap."""
    table = agent_table(0, {"id": 1}, {"id": 2})
    return detector.overlap_probability(table, a, b, PAIR, least)[0]


@given(
    st.tuples(st.floats(-14.0, 14.0), st.floats(-10.0, 10.0)),
    st.tuples(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1)),
    st.tuples(st.floats(0.0, 3.0), st.floats(0.05, 4.0)),
    st.floats(0.02, 0.7),
)
@example((6.0, 0.0), (0.0, 0.0), (0.0, 1.0), 0.05)  # beyond the circles around both boxes, within the spread
@example((-6.0, 0.0), (0.0, 0.0), (1.0, 0.05), 0.05)
@example((0.0, 3.0), (0.0, 0.0), (0.0, 1.0), 0.05)
@example((0.0, -3.0), (0.0, 0.0), (0.0, 1.0), 0.05)
@example((4.0, 0.0), (0.0, 0.0), (0.0, 0.1), 0.5)  # their centres are at different places, and they never move
@example((-4.0, 0.0), (0.0, 0.0), (0.0, 0.1), 0.5)
def test_nothing_likely_is_ruled_out(agent_table, detector, delta, yaws, sigmas, least: float) -> None:
    a, b = standing(0.0, 0.0, yaws[0], sigmas[0]), standing(*delta, yaws[1], sigmas[1])
    size = np.array([LENGTH]), np.array([WIDTH])
    strips = Strips.of(np.array([yaws[0]]), np.array([yaws[1]]), size, size)
    spread = np.array([[sigmas[0] ** 2 + sigmas[1] ** 2]] * 2 + [[0.0]])
    exact = strips.probability(np.array([delta[0]]), np.array([delta[1]]), spread)[0]
    expected = exact if exact >= least else 0.0
    assert found(agent_table, detector, a, b, least) == pytest.approx(np.full(3, expected), abs=1e-9)


@pytest.mark.parametrize(
    ("valid_a", "valid_b"), [((True, False, True), (True, True, True)), ((True, True, True), (True, False, True))]
)
def test_whoever_is_not_there_overlaps_nobody(agent_table, detector, valid_a, valid_b) -> None:
    a, b = standing(0.0, 0.0, 0.0, 0.0, valid_a), standing(1.0, 0.0, 0.0, 0.0, valid_b)
    assert found(agent_table, detector, a, b, 0.5).tolist() == [1.0, 0.0, 1.0]
