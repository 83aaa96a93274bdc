"""Ways to a goal: graph search and curves, on the motorway and on turns inside junctions of the packaged nets."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from litsim_policy.motion.reference_path import ReferencePath
from litsim_policy.motion.route import CHANGE_COST, Router
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged

CURVATURE_MAX = VehicleLimits().curvature_max


@pytest.fixture(scope="module")
def motorway() -> LaneMap:
    return LaneMap.from_net(packaged("nets/us101_like.net.xml"))


@pytest.fixture(scope="module")
def town() -> LaneMap:
    return LaneMap.from_net(packaged("nets/urban_like.net.xml"))


@pytest.fixture(scope="module")
def motorway_router(motorway: LaneMap) -> Router:
    return Router(motorway)


@pytest.fixture(scope="module")
def town_router(town: LaneMap) -> Router:
    return Router(town)


def pose(lane_map: LaneMap, lane: int, s: float, left: float = 0.0, turn: float = 0.0) -> np.ndarray:
    x, y, yaw = (float(v) for v in lane_map.pose_at(lane, s))
    return np.array([x - left * np.sin(yaw), y + left * np.cos(yaw), yaw + turn])


def check(lane_map: LaneMap, path: ReferencePath, start: np.ndarray, goal: np.ndarray) -> None:
    """What every path to a goal is."""
    assert path.points[0] == pytest.approx(start[:2]) and path.points[-1] == pytest.approx(goal[:2])
    at = lane_map.nearest(goal[:1], goal[1:2], goal[2:])
    ends = wrap_angle(path.heading(path.s[[0, -2]] + 1e-6) - np.array([start[2], at.heading[0]]))
    assert np.abs(ends).max() < 0.12, "tangent, as far as a polyline of 1 m can be"
    step = 0.5 * (np.diff(path.s)[1:] + np.diff(path.s)[:-1])
    bend = np.abs(wrap_angle(np.diff(path.heading(path.s[:-1] + 1e-9)))) / step
    assert bend.max(initial=0.0) <= 1.25 * CURVATURE_MAX, "between pieces the polyline may kink a little"
    assert np.diff(path.s).min() > 0.0


@settings(max_examples=60)
@given(
    st.tuples(st.integers(0, 4), st.integers(0, 4)),
    st.tuples(st.floats(20.0, 200.0), st.floats(25.0, 100.0)),
    st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
    st.floats(-0.08, 0.08),
    st.floats(0.0, 25.0),
)
@example((0, 2), (163.0, 25.0), (1.0, 0.0), 0.0, 0.0)  # the edge with the goal's lane begins shortly after the start
def test_paths_on_the_motorway_keep_what_they_promise(
    motorway, motorway_router, lane_centres, lanes, along, left, turn, speed
) -> None:
    start = np.array([along[0], lane_centres[lanes[0]] + left[0], turn])
    ahead = along[1] + 25.0 * abs(lanes[0] - lanes[1])
    goal = np.array([along[0] + ahead, lane_centres[lanes[1]] + left[1], 0.0])
    path = motorway_router.path(start, speed, goal)
    assert path is not None
    check(motorway, path, start, goal)
    assert motorway.inside_road(*path.points.T).all()


def turns(lane_map: LaneMap) -> list[tuple[int, int, int]]:
    """Lanes before, inside and behind a junction where the way turns by more than 0.5 rad."""
    found = []
    for row, lane in enumerate(lane_map.lanes):
        for name in lane.successors:
            inner = lane_map.row(name)
            within = lane_map.lanes[inner]
            if not within.is_internal or len(within.successors) != 1:
                continue
            behind = lane_map.row(within.successors[0])
            heading = [float(lane_map.pose_at(inner, s)[2]) for s in (0.0, within.length)]
            if abs(wrap_angle(np.array(heading[1] - heading[0]))) > 0.5 and not lane_map.lanes[behind].is_internal:
                found.append((row, inner, behind))
    return found


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.floats(5.0, 30.0), st.floats(5.0, 30.0), st.floats(-0.5, 0.5), st.floats(2.0, 10.0))
def test_paths_through_turns_inside_junctions(town, town_router, which, before, behind, left, speed) -> None:
    ways = turns(town)
    first, inner, last = ways[which % len(ways)]
    assume(town.lanes[first].length > before and town.lanes[last].length > behind)
    start, goal = pose(town, first, town.lanes[first].length - before, left), pose(town, last, behind)
    path = town_router.path(start, speed, goal)
    if path is None:
        assert town.lanes[inner].length < 12.0, "only a short turn can be too tight"
        return
    check(town, path, start, goal)
    assert town.inside_road(*path.points.T).all()
    middle = pose(town, inner, 0.5 * town.lanes[inner].length)
    assert abs(path.project(middle[:1], middle[1:2])[1][0]) < 2.0, "through this turn and no other"


def test_most_turns_of_a_town_can_be_driven(town, town_router) -> None:
    found = [
        town_router.path(pose(town, first, max(0.0, town.lanes[first].length - 15.0)), 6.0, pose(town, last, 12.0))
        for first, _, last in turns(town)
    ]
    assert len(found) > 10 and sum(path is not None for path in found) >= 0.9 * len(found)


def test_a_goal_on_a_turn_inside_a_junction_is_reached(town, town_router) -> None:
    reached = 0
    for first, inner, _ in turns(town):
        if town.lanes[inner].length < 10.0:
            continue
        start = pose(town, first, max(0.0, town.lanes[first].length - 15.0))
        goal = pose(town, inner, 0.5 * town.lanes[inner].length)
        path = town_router.path(start, 6.0, goal)
        if path is not None:
            check(town, path, start, goal)
            reached += 1
    assert reached > 10


@pytest.mark.parametrize("net", ["i80", "us101", "us101_like", "urban_like"])
def test_ways_are_those_that_scipy_finds(net: str) -> None:
    lane_map = LaneMap.from_net(packaged(f"nets/{net}.net.xml"))
    router, lanes = Router(lane_map), lane_map.lanes
    costs = np.zeros((len(lanes), len(lanes)))
    for row, lane in enumerate(lanes):
        for name in lane.successors:
            costs[row, lane_map.row(name)] = lane.length
        for name in filter(None, (lane.left, lane.right)):
            costs[row, lane_map.row(name)] = CHANGE_COST
    cost, before = dijkstra(csr_array(costs), return_predecessors=True)
    for start, goal in np.ndindex(costs.shape):
        way = router.lanes_between(start, goal)
        assert (way is None) == np.isinf(cost[start, goal])
        assert all(before[start, b] == a for a, b in pairwise(way or []))


def test_there_is_no_way_back_on_a_motorway(motorway, motorway_router, lane_centres) -> None:
    ahead, behind = (np.array([x, lane_centres[1], 0.0]) for x in (200.0, 100.0))
    assert motorway_router.path(ahead, 10.0, behind) is None
    assert motorway_router.path(ahead, 10.0, ahead) is None


def test_a_change_of_lane_too_short_to_drive_is_none(motorway_router, lane_centres) -> None:
    start, goal = np.array([100.0, lane_centres[0], 0.0]), np.array([103.0, lane_centres[3], 0.0])
    assert motorway_router.path(start, 10.0, goal) is None


def test_there_is_no_way_to_where_the_map_has_no_road(motorway_router, lane_centres) -> None:
    on_road, beside = (np.array([100.0, y, 0.0]) for y in (lane_centres[1], lane_centres[1] + 60.0))
    ahead = np.array([80.0, 0.0, 0.0])
    assert motorway_router.path(on_road, 10.0, on_road + ahead) is not None
    assert motorway_router.path(on_road, 10.0, beside + ahead) is None


def test_a_path_that_would_leave_the_road_is_none(motorway_router) -> None:
    """Centre 5 cm from the edge and heading for it: every curve that begins so crosses it first."""
    goal, starts = np.array([160.0, -1.83, 0.0]), ((-0.05, 0.3), (-0.2, -0.05), (0.3, -0.05))
    off, along, back = (motorway_router.path(np.array([100.0, y, yaw]), 10.0, goal) for y, yaw in starts)
    assert off is None and along is not None
    assert back is not None, "who is off it already may come back"


@pytest.mark.parametrize("turn", [-0.4, 0.4])
def test_it_ends_tangent_to_the_lane_however_the_goal_is_turned(motorway_router, lane_centres, turn: float) -> None:
    start, goal = np.array([100.0, lane_centres[1], 0.0]), np.array([160.0, lane_centres[1] + 0.5, turn])
    path = motorway_router.path(start, 10.0, goal)
    assert path is not None
    assert path.heading(path.s[-1:] - 1e-6) == pytest.approx([0.0], abs=0.02)
