"""Forecasts along lanes that bend.

Networks answer in the agents' frames, which are straight, and so nearly are the roads that they are trained on. Where
the lane ahead of an agent bends, within a junction above all, what they mean is taken in lane-aligned frames: so much
ahead is so far along the lane's centre line, so much to the left is beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.contract import AgentFutures, FurtherFutures
from litsim_predictor.inference.in_map import turned_gaussians
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap, LanePosition

FRAMES = 151
"""Frames along a lane, a metre from one to the next: 5 s at 30 m/s."""
BEND = 0.15
"""[rad] by which a lane turns, at least, to count as one that bends; on the roads trained on it is 0.11 at most."""
LATERAL_MAX, BRAKING = 8.0, 2.5
"""[m/s2] No car turns harder than the first; before a turn, people brake by the second at most."""
CHORD = 5
"""Length [m] over which the curvature of a lane is measured."""

Futures = TypeVar("Futures", AgentFutures, FurtherFutures)


@dataclass(frozen=True)
class LaneFrames:
    """Frames along the lanes ahead, for the m of n agents whose lanes bend.

    Attributes:
        row: (m,) of the agent, ascending.
        pose: (m, FRAMES, 3) x, y [m] and heading [rad] in the agent's frame at every metre along its lane, as far
            beside the centre line as the agent is now; the first is where the agent is.
    """

    row: IntArray
    pose: FloatArray

    def __len__(self) -> int:
        return len(self.row)

    @classmethod
    def of_scenes(cls, scenes: Sequence[LaneFrames], agents: int) -> LaneFrames:
        """Returns the frames of several scenes, each with its agents in `agents` rows of its own."""
        row = np.concatenate([number * agents + scene.row for number, scene in enumerate(scenes)])
        return cls(row, np.concatenate([scene.pose for scene in scenes]))


NO_LANE_FRAMES = LaneFrames(np.empty(0, np.int64), np.empty((0, FRAMES, 3)))


class LaneFrameFinder:
    """Finds the frames ahead on the net of `lane_map`; remembers from which lanes on the way ahead bends."""

    def __init__(self, lane_map: LaneMap) -> None:
        self.lane_map = lane_map
        self._bends = np.zeros(len(lane_map.lanes), np.bool_)
        self._known = np.zeros(len(lane_map.lanes), np.bool_)

    def ahead(self, position: LanePosition, along: BoolArray, speed: FloatArray) -> LaneFrames:
        """Returns the frames of those of n agents whose lanes bend, of those that drive `along` (n,) their lanes.

        An agent too fast for a bend, even if it brakes until there, goes straight on where it begins: diverging
        lanes of a junction overlap at first.
        """
        is_learned = self._known[position.lane]
        if not is_learned.all():
            self._learn(np.unique(position.lane[~is_learned]))
        rows = np.flatnonzero(self._bends[position.lane] & along)
        if not len(rows):
            return NO_LANE_FRAMES
        heading, d = position.heading[rows, None], position.d[rows, None]
        way = self.lane_map.poses_along(position.lane[rows], position.s[rows], FRAMES)
        x, y = to_body(way[..., 0] - way[:, :1, 0], way[..., 1] - way[:, :1, 1], heading)
        turn = wrap_angle(way[:, :1, 2] - heading) + np.unwrap(way[..., 2]) - way[:, :1, 2]
        pose = np.stack([x, y, turn], axis=-1)
        _straighten_beyond_grip(pose, speed[rows])
        pose[..., 0] -= d * np.sin(pose[..., 2])
        pose[..., 1] += d * (np.cos(pose[..., 2]) - 1.0)
        return LaneFrames(rows, pose)

    def _learn(self, lanes: IntArray) -> None:
        """Record for each of `lanes` whether the way ahead of an agent on it can bend."""
        for lane in lanes:
            steps = math.ceil(self.lane_map.lanes[lane].length) + FRAMES
            headings = np.unwrap(self.lane_map.poses_along(np.array([lane]), np.zeros(1), steps)[0, :, 2])
            turns = np.ptp(sliding_window_view(headings, FRAMES), axis=1)
            self._bends[lane], self._known[lane] = turns.max() >= BEND, True


def _straighten_beyond_grip(pose: FloatArray, speed: FloatArray) -> None:
    """Let frames `pose` (m, FRAMES, 3) go straight on where agents at `speed` (m,) [m/s] are too fast, in place."""
    ahead = np.arange(FRAMES, dtype=np.float64)
    curvature = np.abs(pose[:, CHORD:, 2] - pose[:, :-CHORD, 2]) / CHORD
    too_fast = (speed[:, None] ** 2 - 2.0 * BRAKING * ahead[:-CHORD]) * curvature > LATERAL_MAX
    for k in np.flatnonzero(too_fast.any(axis=1)):
        begin = int(too_fast[k].argmax())
        x, y, heading = pose[k, begin]
        beyond = ahead[: FRAMES - begin]
        pose[k, begin:, 0], pose[k, begin:, 1] = x + beyond * np.cos(heading), y + beyond * np.sin(heading)
        pose[k, begin:, 2] = heading


def from_lane_frames(futures: AgentFutures, lane_frames: LaneFrames) -> AgentFutures:
    """Returns `futures` of n agents in the map's frame: a network forecasts agents with `lane_frames` along them."""
    if not len(lane_frames):
        return futures
    row = futures.further.row
    way = np.minimum(np.searchsorted(lane_frames.row, row), len(lane_frames) - 1)
    bent = np.flatnonzero(lane_frames.row[way] == row)
    further = _bent(futures.further, bent, lane_frames.pose[way[bent]])
    return replace(_bent(futures, lane_frames.row, lane_frames.pose), further=further)


def _bent(futures: Futures, row: IntArray, pose: FloatArray) -> Futures:
    """Returns `futures` (n) in the map's frame: agents `row` (r,) are forecast along frames `pose` (r, FRAMES, 3)."""
    mean, scale, correlation = futures.mean.copy(), futures.scale.copy(), futures.correlation.copy()
    mean[row], scale[row], correlation[row] = bend(pose, mean[row], scale[row], correlation[row])
    return replace(futures, mean=mean, scale=scale, correlation=correlation)


def bend(
    pose: FloatArray, mean: Float32Array, scale: Float32Array, correlation: Float32Array
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Returns Gaussians of r agents that are meant along their lanes, as they are in the agents' frames.

    Args:
        pose: (r, FRAMES, 3) of the lanes; see :class:`LaneFrames`.
        mean, scale, correlation: (r, T, 2), (r, T, 2), (r, T) along and across them; see :class:`.AgentFutures`.
    """
    metre = np.fmin(np.fmax(np.floor(mean[..., 0]), 0), FRAMES - 1).astype(np.int64)  # 0 for NaN
    frame = np.take_along_axis(pose, metre[..., None], axis=1).reshape(-1, 3)
    ahead = (mean - np.stack([metre, np.zeros_like(metre)], axis=-1)).astype(np.float32)
    one_by_one = ahead.reshape(-1, 1, 2), scale.reshape(-1, 1, 2), correlation.reshape(-1, 1)
    turned, covariance, _ = turned_gaussians(*one_by_one, frame)
    return (
        turned.reshape(mean.shape).astype(np.float32),
        covariance[..., :2].reshape(mean.shape),
        covariance[..., 2].reshape(correlation.shape),
    )


def unbend(pose: FloatArray, path: FloatArray) -> FloatArray:
    """Returns paths (r, T, 2) [m] of r agents as they are along their lanes: the inverse of :func:`bend`.

    Args:
        pose: (r, FRAMES, 3) of the lanes; see :class:`LaneFrames`.
        path: (r, T, 2) in the agents' frames [m].
    """
    away = np.hypot(*(path[:, :, None] - pose[:, None, :, :2]).transpose(3, 0, 1, 2))
    metre = away.argmin(axis=-1)
    x, y, heading = np.take_along_axis(pose, metre[..., None], axis=1).transpose(2, 0, 1)
    ahead, left = to_body(path[..., 0] - x, path[..., 1] - y, heading)
    return np.stack([metre + ahead, left], axis=-1)
