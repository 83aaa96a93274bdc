"""Segments of centre lines: their geometry, and that the grid finds all that are near."""

import numpy as np

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import read_lanes
from litsim_sim.lane_map.segment_grid import REACH, any_within, distance, grid_over, segments_of
from litsim_sim.scenario.scenario import packaged

LANES = sorted(read_lanes(packaged("nets/urban_like.net.xml")), key=lambda lane: lane.id)
POINTS = np.concatenate([lane.centerline for lane in LANES])
BOUNDS = (*map(float, POINTS.min(axis=0)), *map(float, POINTS.max(axis=0)))
SEGMENTS = segments_of(LANES)


def test_segments_lie_lane_after_lane() -> None:
    of = SEGMENTS
    assert len(of.size) == sum(len(lane.s) - 1 for lane in LANES)
    for lane, first, end in zip(LANES, of.first, of.first[1:], strict=False):
        own = slice(first, end)
        np.testing.assert_allclose(of.start_s[own] + of.size[own], lane.s[1:])
        np.testing.assert_allclose(of.start_x[own] + of.size[own] * of.cos[own], lane.centerline[1:, 0])


def test_the_grid_finds_every_segment_within_reach() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(BOUNDS[0], BOUNDS[2], 300), rng.uniform(BOUNDS[1], BOUNDS[3], 300)
    count, grid = len(SEGMENTS.size), grid_over(BOUNDS, SEGMENTS)  # type: ignore[arg-type]
    away = distance(x[:, None], y[:, None], SEGMENTS, np.arange(count))
    for reach in (3.0, REACH):
        within = any_within(x, y, grid, SEGMENTS, np.full(count, reach))
        assert within.any() and np.array_equal(within, (away <= reach).any(axis=1))


def test_poses_on_a_lane_and_beyond_its_ends() -> None:
    index = int(np.argmax([lane.length for lane in LANES]))
    lane = LANES[index]
    s = np.array([*lane.s, lane.length + 7.0])
    x, y, heading = LaneMap(LANES).pose_at(np.full(len(s), index), s)
    np.testing.assert_allclose(np.stack([x, y], axis=1)[:-1], lane.centerline, atol=1e-9)
    beyond = lane.centerline[-1] + 7.0 * np.array([np.cos(heading[-1]), np.sin(heading[-1])])
    np.testing.assert_allclose([x[-1], y[-1]], beyond, atol=1e-9)
