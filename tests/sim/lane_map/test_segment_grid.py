"""Segments of centre lines: their geometry, and that the grid finds all that are near."""

from __future__ import annotations

import numpy as np

from litsim_sim.lane_map.net_lanes import read_lanes
from litsim_sim.lane_map.segment_grid import REACH, SegmentGrid
from litsim_sim.scenario.scenario import packaged

LANES = sorted(read_lanes(packaged("nets/urban_like.net.xml")), key=lambda lane: lane.id)
POINTS = np.concatenate([lane.centerline for lane in LANES])
BOUNDS = (*map(float, POINTS.min(axis=0)), *map(float, POINTS.max(axis=0)))
GRID = SegmentGrid(LANES, BOUNDS)  # type: ignore[arg-type]


def test_segments_lie_lane_after_lane() -> None:
    of = GRID.segments
    assert len(of.size) == sum(len(lane.s) - 1 for lane in LANES)
    assert (np.diff(GRID.lane) >= 0).all()
    for index, lane in enumerate(LANES):
        own = GRID.lane == index
        np.testing.assert_allclose(of.start_s[own] + of.size[own], lane.s[1:])
        np.testing.assert_allclose(of.start_x[own] + of.size[own] * of.cos[own], lane.centerline[1:, 0])


def test_the_grid_finds_every_segment_within_reach() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(BOUNDS[0], BOUNDS[2], 300), rng.uniform(BOUNDS[1], BOUNDS[3], 300)
    distance = GRID.distance(x[:, None], y[:, None], np.arange(len(GRID.lane)))
    for reach in (3.0, REACH):
        within = GRID.any_within(x, y, np.full(len(GRID.lane), reach))
        assert within.any() and np.array_equal(within, (distance <= reach).any(axis=1))


def test_poses_on_a_lane_and_beyond_its_ends() -> None:
    index = int(np.argmax([lane.length for lane in LANES]))
    lane = LANES[index]
    s = np.array([*lane.s, lane.length + 7.0])
    x, y, heading = GRID.pose_at(np.full(len(s), index), s)
    np.testing.assert_allclose(np.stack([x, y], axis=1)[:-1], lane.centerline, atol=1e-9)
    beyond = lane.centerline[-1] + 7.0 * np.array([np.cos(heading[-1]), np.sin(heading[-1])])
    np.testing.assert_allclose([x[-1], y[-1]], beyond, atol=1e-9)
