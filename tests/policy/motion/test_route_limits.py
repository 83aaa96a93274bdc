"""What a path to a goal may not do: bend tighter than a vehicle that steers less, leave the road, end askew."""

from itertools import pairwise

import numpy as np
import pytest

from litsim_policy.motion import bezier
from litsim_policy.motion.reference_path import ReferencePath
from litsim_policy.motion.route import Router
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged

GENTLE = 0.02  # [1/m] of a long vehicle


@pytest.fixture(scope="module")
def motorway() -> LaneMap:
    return LaneMap.from_net(packaged("nets/us101_like.net.xml"))


def bend(path: ReferencePath) -> float:
    """Largest curvature [1/m] of the polyline."""
    turned = np.abs(wrap_angle(np.diff(path.heading(path.s[:-1] + 1e-9))))
    return float((turned / (0.5 * (np.diff(path.s)[1:] + np.diff(path.s)[:-1]))).max())


def test_no_path_bends_tighter_than_the_limit_that_was_given(motorway, lane_centres) -> None:
    router, free = Router(motorway, VehicleLimits(curvature_max=GENTLE)), Router(motorway)
    tight = 0
    for far, speed in [(far, speed) for far in np.arange(15.0, 80.0, 2.5) for speed in (2.0, 8.0, 15.0)]:
        start, goal = np.array([100.0, lane_centres[0], 0.0]), np.array([100.0 + far, lane_centres[1], 0.0])
        path, usual = router.path(start, speed, goal), free.path(start, speed, goal)
        assert path is None or bend(path) <= 1.2 * GENTLE
        tight += usual is not None and bend(usual) > 1.5 * GENTLE
    assert tight > 3, "without the limit some would"
    assert (
        router.path(np.array([100.0, lane_centres[0], 0.0]), 15.0, np.array([180.0, lane_centres[1], 0.0])) is not None
    )


def test_a_path_that_would_leave_the_road_is_none(motorway) -> None:
    """Centre 5 cm from the edge and heading for it: every curve that begins so crosses it first."""
    router, goal = Router(motorway), np.array([160.0, -1.83, 0.0])
    assert router.path(np.array([100.0, -0.05, 0.3]), 10.0, goal) is None
    assert router.path(np.array([100.0, -0.2, -0.05]), 10.0, goal) is not None
    assert router.path(np.array([100.0, 0.3, -0.05]), 10.0, goal) is not None, "who is off it already may come back"


@pytest.mark.parametrize("turn", [-0.4, 0.4])
def test_it_ends_tangent_to_the_lane_however_the_goal_is_turned(motorway, lane_centres, turn: float) -> None:
    path = Router(motorway).path(
        np.array([100.0, lane_centres[1], 0.0]), 10.0, np.array([160.0, lane_centres[1] + 0.5, turn])
    )
    assert path is not None
    assert path.heading(path.s[-1:] - 1e-6) == pytest.approx([0.0], abs=0.02)


@pytest.mark.parametrize("end", [(20.0, 3.66, 0.0), (20.0, 5.0, np.pi / 2), (8.0, 14.0, 1.2), (3.0, 9.0, 2.5)])
def test_the_largest_curvature_is_found_wherever_it_is(end: tuple[float, float, float]) -> None:
    """Against the bend of points that lie close."""
    control = bezier.between(np.zeros(3), np.array(end))
    points = bezier.points(control, 0.005)
    heading = np.unwrap(np.arctan2(*np.diff(points, axis=0).T[::-1]))
    length = np.hypot(*np.diff(points, axis=0).T)
    seen = max(abs(b - a) / s for (a, b), s in zip(pairwise(heading), length[1:], strict=True))
    assert bezier.curvature_max(control) == pytest.approx(seen, rel=0.05)
