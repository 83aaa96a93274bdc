"""Segments of centre lines: their geometry, and that the grid finds all that are near."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_sim.lane_map.net_lanes import read_lanes
from litsim_sim.lane_map.segment_grid import REACH, SegmentGrid
from litsim_sim.scenario.scenario import packaged

LANES = sorted(read_lanes(packaged("nets/urban_like.net.xml")), key=lambda lane: lane.id)
POINTS = np.concatenate([lane.centerline for lane in LANES])
BOUNDS = (*map(float, POINTS.min(axis=0)), *map(float, POINTS.max(axis=0)))
GRID = SegmentGrid(LANES, BOUNDS)  # type: ignore[arg-type]


def test_segments_lie_lane_after_lane() -> None:
    assert len(GRID) == sum(len(lane.s) - 1 for lane in LANES)
    assert (np.diff(GRID.lane) >= 0).all()
    for index, lane in enumerate(LANES):
        mine = GRID.lane == index
        np.testing.assert_allclose(GRID.start_s[mine] + GRID.size[mine], lane.s[1:])
        np.testing.assert_allclose(GRID.start_x[mine] + GRID.size[mine] * GRID.cos[mine], lane.centerline[1:, 0])


def test_along_and_left_of_a_segment() -> None:
    segment = int(np.argmax(GRID.size))
    at, forward = (
        np.array([GRID.start_x[segment], GRID.start_y[segment]]),
        np.array([GRID.cos[segment], GRID.sin[segment]]),
    )
    x, y = at + 3.0 * forward + 2.0 * np.array([-forward[1], forward[0]])
    assert GRID.project(x, y, np.array(segment)) == pytest.approx((3.0, 2.0))
    assert GRID.distance(x, y, np.array(segment)) == pytest.approx(2.0)
    x, y = at - 4.0 * forward + 3.0 * np.array([-forward[1], forward[0]])
    assert GRID.distance(x, y, np.array(segment)) == pytest.approx(5.0)  # from its start


def test_candidates_hold_every_segment_within_reach() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(BOUNDS[0], BOUNDS[2], 300), rng.uniform(BOUNDS[1], BOUNDS[3], 300)
    every = np.broadcast_to(np.arange(len(GRID)), (300, len(GRID)))
    near = GRID.distance(x[:, None], y[:, None], every) <= REACH
    assert near.any()
    for row, candidates in enumerate(GRID.candidates(x, y)):
        assert set(np.flatnonzero(near[row])) <= set(candidates)
    assert (GRID.candidates(np.array([1e6]), np.array([0.0])) == -1).all()


def test_poses_on_a_lane_and_beyond_its_ends() -> None:
    index = int(np.argmax([lane.length for lane in LANES]))
    lane = LANES[index]
    s = np.array([*lane.s, lane.length + 7.0])
    x, y, heading = GRID.pose_at(np.full(len(s), index), s)
    np.testing.assert_allclose(np.stack([x, y], axis=1)[:-1], lane.centerline, atol=1e-9)
    beyond = lane.centerline[-1] + 7.0 * np.array([np.cos(heading[-1]), np.sin(heading[-1])])
    np.testing.assert_allclose([x[-1], y[-1]], beyond, atol=1e-9)
