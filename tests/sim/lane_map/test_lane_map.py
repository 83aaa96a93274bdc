"""Lane queries: geometry by hand, and properties on the packaged nets."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString, points

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged, packaged_nets
from made_lanes import lane_of

# The others have other layouts: i80 in test_maps_motorway.py, urban_like with its traffic.
NETS = {name: LaneMap.from_net(packaged(f"nets/{name}.net.xml")) for name in ("us101", "us101_like")}
LIKE = NETS["us101_like"]


def one(value: float) -> np.ndarray:
    return np.array([value])


# Packaged nets


def test_layout_of_the_packaged_nets() -> None:
    assert set(packaged_nets()) >= {*NETS, "i80"}
    for lane_map in NETS.values():
        assert len(lane_map.lanes) == 5 + 6 + 5 + 2
        assert not any(lane.is_internal for lane in lane_map.lanes)
        by_id = {lane.id: lane for lane in lane_map.lanes}
        assert by_id["upstream_0"].successors == ("weave_1",)
        assert by_id["on_ramp_0"].successors == ("weave_0",)
        assert by_id["weave_0"].successors == ("off_ramp_0",)
        assert by_id["downstream_4"].successors == ()
        assert (by_id["weave_0"].right, by_id["weave_0"].left) == (None, "weave_1")
        assert (by_id["weave_5"].right, by_id["weave_5"].left) == ("weave_4", None)
        assert [lane_map.row(lane.id) for lane in lane_map.lanes] == list(range(18))


@pytest.mark.parametrize("name", NETS)
def test_lanes_of_the_packaged_nets_follow_each_other_without_gaps_or_kinks(name: str) -> None:
    lane_map = NETS[name]
    for lane in lane_map.lanes:
        for successor in lane.successors:
            after = lane_map.lanes[lane_map.row(successor)]
            assert np.hypot(*(after.centerline[0] - lane.centerline[-1])) < 0.03
            directions = [
                np.arctan2(*np.diff(line, axis=0)[::-1].T) for line in (lane.centerline[-2:], after.centerline[:2])
            ]
            assert abs(float(directions[1][0] - directions[0][0])) < 0.01


# Projection


@settings(max_examples=60, deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(NETS)))
def test_projection_finds_the_lane_that_a_pose_was_taken_from(data: st.DataObject, name: str) -> None:
    lane_map = NETS[name]
    main = [row for row, lane in enumerate(lane_map.lanes) if "ramp" not in lane.edge_id]
    row = data.draw(st.sampled_from(main))
    lane = lane_map.lanes[row]
    s = np.array(data.draw(st.lists(st.floats(1.0, lane.length - 1.0), min_size=1, max_size=9)))
    d = np.array(data.draw(st.lists(st.floats(-0.45, 0.45), min_size=len(s), max_size=len(s)))) * lane.width
    x, y, heading = lane_map.pose_at(row, s)
    at = lane_map.nearest(x - d * np.sin(heading), y + d * np.cos(heading), heading)
    assert (at.lane == row).all()
    np.testing.assert_allclose(at.s, s, atol=0.05)
    np.testing.assert_allclose(at.d, d, atol=0.01)
    np.testing.assert_allclose(at.heading, heading, atol=0.02)


@pytest.mark.parametrize("name", sorted(NETS))
def test_headings_around_are_those_of_the_lane_before_and_beyond_even_where_it_ends(name: str) -> None:
    lane_map, random = NETS[name], np.random.default_rng(3)
    rows = random.integers(len(lane_map.lanes), size=60)
    s = random.uniform(-10.0, 10.0 + np.array([lane_map.lanes[row].length for row in rows]))
    found = lane_map.headings_around(rows, s, 20.0)
    assert found.shape == (60, 2)
    for column, by in enumerate((-20.0, 20.0)):
        assert (found[:, column] == lane_map.pose_at(rows, s + by)[2]).all()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(sorted(NETS)))
def test_nearest_is_the_nearest_on_and_far_off_the_net(seed: int, name: str) -> None:
    lane_map, rng = NETS[name], np.random.default_rng(seed)
    x0, y0, x1, y1 = lane_map.bounds
    x, y = rng.uniform(x0 - 100, x1 + 100, 50), rng.uniform(y0 - 100, y1 + 100, 50)
    distances = np.array([LineString(lane.centerline).distance(points(x, y)) for lane in lane_map.lanes])
    at = lane_map.nearest(x, y)
    np.testing.assert_allclose(distances[at.lane, np.arange(50)], distances.min(axis=0), atol=1e-9)
    half = np.array([lane.width / 2 for lane in lane_map.lanes])[:, None]
    clear = (np.abs(distances - half) > 0.01).all(axis=0)  # not on an edge
    np.testing.assert_array_equal(lane_map.inside_road(x, y)[clear], (distances < half).any(axis=0)[clear])


def test_left_is_positive() -> None:
    at = LIKE.nearest(np.array([50.0, 50.0]), np.array([-8.15, -10.15]))
    assert [LIKE.lanes[i].id for i in at.lane] == ["upstream_2", "upstream_2"]
    np.testing.assert_allclose(at.d, [1.0, -1.0], atol=1e-6)


def test_lanes_that_lead_elsewhere_are_handicapped() -> None:
    two_way = LaneMap([lane_of("east", [(0, 0), (100, 0)]), lane_of("west", [(100, 3), (0, 3)])])
    east, west = two_way.row("east"), two_way.row("west")
    x, y = one(50.0), one(2.0)  # nearer to "west"
    assert two_way.nearest(x, y).lane[0] == west
    assert two_way.nearest(x, y, one(0.0)).lane[0] == east
    assert two_way.nearest(x, y, one(np.pi)).lane[0] == west
    assert two_way.nearest(x, y, one(0.0)).d[0] == pytest.approx(2.0)


def test_lanes_inside_junctions_are_handicapped() -> None:
    crossing = LaneMap(
        [
            lane_of("a", [(0, 0), (10, 0)], ":j_0"),
            lane_of(":j_0", [(10, 0.3), (30, 0.3)], "b"),
            lane_of("b", [(30, 0), (60, 0)]),
        ]
    )
    assert crossing.lanes[crossing.nearest(one(10.2), one(0.3)).lane[0]].id == "a"
    assert crossing.lanes[crossing.nearest(one(20.0), one(0.3)).lane[0]].id == ":j_0"


# Paths


@settings(max_examples=60, deadline=None)
@given(data=st.data(), name=st.sampled_from(sorted(NETS)), length=st.floats(0.5, 1500.0))
def test_paths_have_their_length_and_no_kinks(data: st.DataObject, name: str, length: float) -> None:
    lane_map = NETS[name]
    row = data.draw(st.integers(0, len(lane_map.lanes) - 1))
    s = data.draw(st.floats(0.0, lane_map.lanes[row].length))
    path = lane_map.path_from(row, s, length)
    steps = np.diff(path, axis=0)
    sizes = np.hypot(*steps.T)
    assert sizes.sum() == pytest.approx(length, abs=0.1)
    assert (sizes > 0).all()
    np.testing.assert_allclose(path[0], np.array(lane_map.pose_at(row, s)[:2]), atol=1e-9)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    assert np.abs(turns[np.minimum(sizes[1:], sizes[:-1]) > 0.5]).max(initial=0.0) < 0.12


@settings(deadline=None)
@given(st.data(), st.sampled_from([*NETS, "urban_like"]))
def test_ways_lead_along_paths(data: st.DataObject, name: str) -> None:
    lane_map = NETS.get(name) or LaneMap.from_net(packaged(f"nets/{name}.net.xml"))
    lane = data.draw(st.integers(0, len(lane_map.lanes) - 1))
    s = data.draw(st.floats(0.0, lane_map.lanes[lane].length))
    way = lane_map.poses_along(np.array([lane]), one(s), 60, 2.0)[0]
    path = LineString(lane_map.path_from(lane, s, 118.0))
    assert np.hypot(*(way[:, :2] - [path.interpolate(2.0 * k).coords[0] for k in range(60)]).T).max() < 0.01
    steps = np.diff(way[:, :2], axis=0)
    straight = np.abs(np.diff(way[:, 2])) < 1e-9
    assert np.cos(np.arctan2(steps[straight, 1], steps[straight, 0]) - way[:-1, 2][straight]) == pytest.approx(
        np.ones(straight.sum()), abs=1e-3
    )


def test_path_leaves_the_net_straight_on() -> None:
    path = LIKE.path_from(LIKE.row("downstream_4"), 200.0, 500.0)
    np.testing.assert_allclose(path, [[589.0, -1.83], [640.0, -1.83], [1089.0, -1.83]], atol=0.01)


def test_path_follows_the_edges_of_a_route_through_a_junction() -> None:
    fork = LaneMap(
        [
            lane_of("a", [(0, 0), (10, 0)], ":on", ":left"),
            lane_of(":on", [(10, 0), (20, 0)], "on"),
            lane_of(":left", [(10, 0), (20, 5)], "left"),
            lane_of("on", [(20, 0), (30, 0)]),
            lane_of("left", [(20, 5), (30, 10)]),
        ]
    )
    start = fork.row("a"), 5.0, 5.0 + np.hypot(10, 5)
    edges = {name: fork.lanes[fork.row(name)].edge_id for name in ("a", ":on", "on", "left")}
    np.testing.assert_allclose(fork.path_from(*start)[-1], [16.18 + 5, 0], atol=0.01)
    turned = fork.path_from(*start, {edges["a"], edges[":on"], edges["left"]})
    np.testing.assert_allclose(turned[-1], [20, 5], atol=0.01)
    np.testing.assert_allclose(fork.path_from(*start, {"elsewhere"}), fork.path_from(*start))


# Boxes


@pytest.mark.parametrize(
    ("x", "y", "yaw", "length", "width", "expected"),
    [
        (50.0, -9.15, 0.0, 5.0, 2.0, True),  # in the middle of upstream_2
        (50.0, -8.4, 0.0, 5.0, 2.0, True),  # at its left edge
        (50.0, -8.2, 0.0, 5.0, 2.0, False),  # over it
        (50.0, -9.15, 0.5, 5.0, 2.0, False),  # turned out of it
        (176.0, -9.15, 0.0, 17.0, 2.5, True),  # across the joint of two lanes that follow each other
        (100.0, 5.0, 0.0, 5.0, 2.0, False),  # off the road
    ],
)
def test_boxes_inside_a_lane(x: float, y: float, yaw: float, length: float, width: float, expected: bool) -> None:
    assert LIKE.inside_lane(one(x), one(y), one(yaw), one(length), one(width)).tolist() == [expected]


def test_points_on_the_road() -> None:
    x, y = np.array([50.0, 50.0, 50.0, 300.0, 300.0]), np.array([-0.01, 0.01, -18.4, -18.4, -22.1])
    assert LIKE.inside_road(x, y).tolist() == [True, False, False, True, False]
    assert LIKE.inside_road(np.array([1e6]), np.array([np.nan])).tolist() == [False]


def test_no_points() -> None:
    none = np.empty(0)
    assert len(LIKE.nearest(none, none, none).lane) == 0
    assert LIKE.inside_road(none, none).tolist() == []
    assert LIKE.inside_lane(none, none, none, none, none).tolist() == []
