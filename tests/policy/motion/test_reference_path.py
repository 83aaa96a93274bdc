"""Reference paths, against shapely; and a pursuit that ends up on them."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.motion.reference_path import (
    BEYOND,
    SPACING,
    ReferencePath,
    lane_path,
    logged_path,
    onto_lane,
    pursuit_reach,
    pursuit_yaw_rate,
    route_path,
)
from litsim_sim.core.dynamics import Motion, VehicleLimits, bicycle_step
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.scenario import packaged


@st.composite
def winding_paths(draw: st.DrawFn) -> ReferencePath:
    """Polylines of up to 12 segments that turn by at most 1 rad at a time."""
    count = draw(st.integers(1, 12))
    sizes = np.array(draw(st.lists(st.floats(0.5, 20.0), min_size=count, max_size=count)))
    turns = np.array(draw(st.lists(st.floats(-1.0, 1.0), min_size=count, max_size=count)))
    heading = draw(st.floats(-3.0, 3.0)) + np.cumsum(turns)
    steps = sizes[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    start = np.array([draw(st.floats(-100, 100)), draw(st.floats(-100, 100))])
    return ReferencePath(start + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]))


def project(path: ReferencePath, x: float, y: float) -> tuple[float, float]:
    s, d = path.project(np.array([x]), np.array([y]))
    return float(s[0]), float(d[0])


# ReferencePath


@given(winding_paths())
def test_the_arc_length_is_that_of_shapely_and_headings_are_those_of_the_segments(path: ReferencePath) -> None:
    assert path.s[-1] == pytest.approx(shapely.LineString(path.points).length)
    steps = np.diff(path.points, axis=0)
    middle = 0.5 * (path.s[1:] + path.s[:-1])
    turned = wrap_angle(path.heading(middle) - np.arctan2(steps[:, 1], steps[:, 0]))
    assert turned == pytest.approx(np.zeros(len(turned)), abs=1e-6)


def test_a_path_through_crowded_points_drops_them_and_keeps_the_rest() -> None:
    points = np.array([[0.0, 0.0], [0.1, 0.3], [0.2, -0.3], [1.0, 0.0], [1.2, 0.0], [5.0, 0.0]])
    path = ReferencePath.through(points)
    assert path.points.tolist() == [[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]]


def test_a_path_through_one_place_only_is_refused() -> None:
    with pytest.raises(ValueError, match="two points"):
        ReferencePath.through(np.array([[3.0, 1.0], [3.1, 1.0], [3.0, 1.1]]))


# logged_path and lane_path


def test_a_logged_path_follows_the_log_and_then_the_lane(make_scenario, track, lane_centres) -> None:
    ego, other = track(1, x=100.0, y=lane_centres[1]), track(2, x=60.0, y=lane_centres[2] + 0.6, last=40)
    scenario = make_scenario(ego, other)
    path = logged_path(scenario.log, scenario.lane_map, 2)
    log = scenario.log.table(40)
    end, offset = project(path, log.x[1], log.y[1])
    assert end == pytest.approx(40.0, abs=0.01) and offset == pytest.approx(0.0, abs=0.01)
    assert path.s[-1] - end == pytest.approx(BEYOND, abs=2.0 * SPACING + 3.0)
    y = np.array([path.point(s)[1] for s in np.arange(0.0, path.s[-1], 1.0)])
    assert y[:40] == pytest.approx(np.full(40, lane_centres[2] + 0.6), abs=0.01)
    assert y[-1] == pytest.approx(lane_centres[2], abs=0.05), "the offset fades out"
    assert (np.diff(y) < 0.01).all() and (np.diff(y) > -0.05).all()


@pytest.mark.parametrize("left", [-1.7, 0.0, 1.7])
@pytest.mark.parametrize("yaw", [-0.06, 0.0, 0.06])
def test_a_logged_path_has_no_kink_and_stays_on_the_road_wherever_the_log_ends(
    make_scenario, track, lane_centres, left: float, yaw: float
) -> None:
    """Among them are logs that end just before one lane becomes the next."""
    ego, ends = track(1, x=100.0), [*np.arange(150.0, 250.0, 7.0), *np.arange(380.0, 480.0, 7.0)]
    others = [
        track(10 + i, x=end - 10.0, y=lane_centres[2] + left - 10.0 * np.sin(yaw), yaw=yaw, last=10)
        for i, end in enumerate(ends)
    ]
    scenario = make_scenario(ego, *others)
    for other in others:
        path = logged_path(scenario.log, scenario.lane_map, other.id)
        turns = np.abs(wrap_angle(np.diff(path.heading(path.s[:-1] + 1e-9))))
        assert turns.max() < 0.13, other
        points = np.array([path.point(s) for s in np.arange(0.0, path.s[-1], 1.0)])
        points = points[points[:, 0] < scenario.lane_map.bounds[2]]
        assert scenario.lane_map.inside_road(*points.T).all(), other


def test_the_path_of_a_standing_vehicle_leads_along_its_lane(make_scenario, track, lane_centres) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=200.0, y=lane_centres[3], speed=0.0))
    path = logged_path(scenario.log, scenario.lane_map, 2)
    assert path.points[0] == pytest.approx([200.0, lane_centres[3]])
    assert path.heading(np.arange(0.0, 100.0)) == pytest.approx(np.zeros(100), abs=1e-3)


def test_a_lane_path_is_the_centre_line_from_a_pose_on(make_scenario, track, lane_centres) -> None:
    lane_map = make_scenario(track(1, x=100.0)).lane_map
    path = lane_path(lane_map, 120.0, lane_centres[3] + 1.0, 0.1, length=200.0)
    assert path.points[0] == pytest.approx([120.0, lane_centres[3]], abs=0.01)
    assert path.s[-1] == pytest.approx(200.0, abs=SPACING)
    assert np.abs(path.points[:, 1] - lane_centres[3]).max() < 0.01


# pursuit_yaw_rate

STRAIGHT = ReferencePath(np.column_stack([np.arange(0.0, 400.0), np.zeros(400)]))
ARC = ReferencePath(200.0 * np.column_stack([np.sin(np.arange(0, 1.5, 0.005)), 1 - np.cos(np.arange(0, 1.5, 0.005))]))


def follow(path: ReferencePath, x: float, y: float, yaw: float, speed: float, steps: int) -> np.ndarray:
    """Offsets (steps,) from `path` of a vehicle that pursues it at constant speed."""
    one, offsets = np.ones(1), []
    motion = Motion(x * one, y * one, yaw * one, speed * one, 0 * one, 0 * one)
    for _ in range(steps):
        rate = pursuit_yaw_rate(path, motion.x[0], motion.y[0], motion.yaw[0], motion.speed[0])
        motion = bicycle_step(motion, 4.5 * one, 0 * one, rate * one, VehicleLimits())
        offsets.append(project(path, motion.x[0], motion.y[0])[1])
    return np.array(offsets)


def test_at_rest_pursuit_does_not_turn() -> None:
    assert pursuit_yaw_rate(STRAIGHT, 10.0, 2.0, 0.3, 0.0) == 0.0


def test_pursuit_reaches_a_second_ahead_but_at_least_four_metres() -> None:
    assert (pursuit_reach(0.0), pursuit_reach(4.0), pursuit_reach(15.0)) == (4.0, 4.0, 15.0)


@given(st.floats(3.0, 30.0), st.floats(-3.5, 3.5), st.floats(-0.15, 0.15))
def test_pursuit_comes_onto_a_straight_path_and_stays(speed: float, offset: float, yaw: float) -> None:
    offsets = follow(STRAIGHT, 5.0, offset, yaw, speed, 150)
    assert np.abs(offsets[100:]).max() < 0.05
    assert np.abs(offsets).max() < abs(offset) + 1.0 + 0.5 * speed * abs(yaw), "no wide swings"


@pytest.mark.parametrize("speed", [2.0, 10.0, 20.0])
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_pursuit_follows_a_bend(speed: float, offset: float) -> None:
    offsets = follow(ARC, 0.0, offset, 0.0, speed, 120)
    assert np.abs(offsets[80:]).max() < 0.25


def test_a_path_along_the_route_changes_no_lane(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=200.0), track(2, x=100.0, yaw=0.05, last=100))
    path = route_path(scenario.log, scenario.lane_map, 2, np.array([100.0, -5.49, 0.05]))
    np.testing.assert_allclose(path.points[0], [100.0, -5.49], atol=0.01)
    np.testing.assert_allclose(path.points[:, 1], -5.49, atol=0.1)
    assert logged_path(scenario.log, scenario.lane_map, 2).points[50, 1] > -4.0, "its log does"


def test_a_logged_path_is_made_once_for_all_runs_of_a_log_alone_or_joined(make_scenario, track) -> None:
    scenario = make_scenario(track(4, x=60.0), track(9, x=90.0))
    other = make_scenario(track(4, x=65.0))
    lanes = scenario.lane_map
    path = logged_path(scenario.log, lanes, 9)
    assert logged_path(scenario.around(9, 1).log, lanes, 9) is path
    joined = BatchedScenario.of((other, scenario))
    assert logged_path(joined.log, lanes, joined.agent(1, 9)) is path
    first = logged_path(joined.log, lanes, joined.agent(0, 4))
    assert first is logged_path(other.log, lanes, 4)
    assert first is not logged_path(scenario.log, lanes, 4)


def test_a_path_that_has_left_the_map_goes_straight_on(lane_centres) -> None:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    beyond = onto_lane(lane_map, np.array([100.0, lane_centres[1] + 60.0]), 0.5)
    assert np.hypot(*beyond[0] - [100.0, lane_centres[1] + 60.0]) == pytest.approx(3.0 * SPACING)
    steps = np.diff(beyond, axis=0)
    assert np.arctan2(steps[:, 1], steps[:, 0]) == pytest.approx(np.full(len(steps), 0.5))
