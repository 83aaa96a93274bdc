"""Cubic curves between poses."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.motion import bezier
from litsim_sim.core.geometry import wrap_angle

places = st.tuples(st.floats(-50, 50), st.floats(-50, 50))


def direction(points: np.ndarray) -> np.ndarray:
    return np.arctan2(*np.diff(points, axis=0).T[::-1])


@given(places, st.floats(-3, 3), st.floats(8, 60), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_a_curve_starts_and_ends_at_its_poses_and_tangent_to_them(place, yaw, far, aside, turn) -> None:
    start = np.array([*place, yaw])
    end = np.array([place[0] + far * np.cos(yaw + aside), place[1] + far * np.sin(yaw + aside), yaw + turn])
    control = bezier.between(start, end)
    points = bezier.points(control, 0.05)
    assert points[0].tolist() == start[:2].tolist() and points[-1].tolist() == end[:2].tolist()
    ends = wrap_angle(direction(points)[[0, -1]] - np.array([start[2], end[2]]))
    assert ends == pytest.approx([0.0, 0.0], abs=0.02)
    assert np.hypot(*np.diff(points, axis=0).T).max() < 0.2


@pytest.mark.parametrize("turn", [0.3, np.pi / 2, -np.pi / 2, 2.0])
@pytest.mark.parametrize("radius", [6.0, 20.0])
def test_a_turn_is_nearly_a_circular_arc(turn: float, radius: float) -> None:
    side = np.sign(turn)
    end = np.array([radius * np.sin(abs(turn)), side * radius * (1 - np.cos(turn)), turn])
    control = bezier.between(np.zeros(3), end)
    points = bezier.points(control, 0.1)
    assert np.hypot(points[:, 0], points[:, 1] - side * radius) == pytest.approx(radius, rel=0.01)
    assert bezier.curvature_max(control) == pytest.approx(1.0 / radius, rel=0.15)


def test_straight_on_there_is_no_curvature() -> None:
    assert bezier.curvature_max(bezier.between(np.zeros(3), np.array([10.0, 0.0, 0.0]))) == pytest.approx(0.0, abs=1e-9)


def test_a_curve_of_no_length_bends_without_bound() -> None:
    assert bezier.curvature_max(bezier.between(np.zeros(3), np.zeros(3))) == np.inf


@pytest.mark.parametrize("end", [(20.0, 3.66, 0.0), (20.0, 5.0, np.pi / 2), (8.0, 14.0, 1.2), (3.0, 9.0, 2.5)])
def test_the_largest_curvature_is_found_wherever_it_is(end: tuple[float, float, float]) -> None:
    """Against the bend of points that lie close."""
    control = bezier.between(np.zeros(3), np.array(end))
    points = bezier.points(control, 0.005)
    heading = np.unwrap(direction(points))
    length = np.hypot(*np.diff(points, axis=0).T)
    seen = max(abs(b - a) / s for (a, b), s in zip(pairwise(heading), length[1:], strict=True))
    assert bezier.curvature_max(control) == pytest.approx(seen, rel=0.05)
