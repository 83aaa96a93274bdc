"""How fast the traffic ahead of each agent drives, far beyond the neighbours that a network attends to.

All agents on the road are read, also where a network otherwise sees only a region of interest: means over vehicles a
hundred metres ahead cost little, and tell at what speed an agent will drive there.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.contract import SPEED_CHANNEL, STRIDE
from litsim_predictor.inference.joint.units import (
    TRAFFIC_AGO,
    TRAFFIC_CHANNELS,
    TRAFFIC_KNOTS,
    TRAFFIC_SOME,
    TRAFFIC_WIDTHS,
)
from litsim_sim.core.history import History
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Bools, Floats, Floats2, Ints, OutSingles2, Singles, float32, kernel

BLOCK = 16
"""Vehicles that are passed over together where none of them matters; those with ids close to each other often are."""
SLACK = 1.0  # [m] by which circles around them are widened, since the rest is computed in single precision
KNOTS, WIDTHS = np.array(TRAFFIC_KNOTS, np.float32), np.array(TRAFFIC_WIDTHS, np.float32)


class Traffic(NamedTuple):
    """The m vehicles on the roads of one scene or of several.

    Attributes:
        pose: (m, 3) x, y [m] and heading [rad] in frame map.
        speed: (m,) [m/s].
        earlier, seen: (m,) speed [m/s] :data:`.joint.units.TRAFFIC_AGO` steps of a model ago, and whether it is known.
        scene: (m,) number of the scene, ascending.
    """

    pose: Floats2
    speed: Singles
    earlier: Singles
    seen: Bools
    scene: Ints

    @classmethod
    def of_table(cls, table: AgentTable, history: History) -> Self:
        """Returns all vehicles of `table`, which is the newest in `history`, a history of the HISTORY_CHANNELS."""
        obstacle = table.obstacle
        vehicles = table.take(~obstacle) if obstacle.any() else table
        values, there = history.window(vehicles.id, 2, STRIDE * TRAFFIC_AGO)
        pose = poses(vehicles.x, vehicles.y, vehicles.yaw)
        earlier = values[:, 0, SPEED_CHANNEL]
        return cls(pose, vehicles.speed.astype(np.float32), earlier.astype(np.float32), there[:, 0], vehicles.scene)

    @classmethod
    def of_agents(cls, frame: FloatArray, history: Float32Array, observed: BoolArray) -> Self:
        """Returns the agents of one scene; see :class:`.contract.AgentInputs`."""
        speed, ago = history[..., SPEED_CHANNEL], -1 - TRAFFIC_AGO
        return cls(frame, speed[:, -1], speed[:, ago], observed[:, ago], np.zeros(len(frame), np.int64))

    def ahead_of(self, frame: FloatArray, speed: Float32Array, scene: IntArray | None = None) -> Float32Array:
        """Returns features (n, TRAFFIC_CHANNELS) of traffic ahead of agents in `scene` (n,); see :func:`look_ahead`."""
        scene = np.zeros(len(frame), np.int64) if scene is None else scene
        ahead = np.empty((len(frame), TRAFFIC_CHANNELS), np.float32)
        first, end = self.scene.searchsorted(scene), self.scene.searchsorted(scene, "right")
        look_ahead(frame, speed, first, end, self, ahead)
        return ahead


def poses(x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """Returns x, y [m] and yaw [rad] of n agents as one array (n, 3)."""
    pose = np.empty((len(x), 3))
    pose[:, 0], pose[:, 1], pose[:, 2] = x, y, yaw
    return pose


@kernel
def _enclosed(pose: Floats2) -> Floats2:
    """Return circles (b, 3), x, y and radius [m], around blocks of the vehicles at `pose` (m, 3), in their order."""
    circles = np.zeros(((len(pose) + BLOCK - 1) // BLOCK, 3))
    for b in range(len(circles)):
        begin, end = b * BLOCK, min((b + 1) * BLOCK, len(pose))
        circles[b, 0], circles[b, 1] = pose[(begin + end) // 2, 0], pose[(begin + end) // 2, 1]
        for j in range(begin, end):
            away = math.hypot(pose[j, 0] - circles[b, 0], pose[j, 1] - circles[b, 1])
            circles[b, 2] = max(circles[b, 2], away + SLACK)
    return circles


@kernel
def _interval(ahead: np.float32) -> int:
    """Return the number of the knot behind a vehicle, which is so far ahead [m], before the last knot."""
    interval = 0
    while ahead >= KNOTS[interval + 1]:
        interval += 1
    return interval


@kernel
def _reaches_ahead(circle: Floats, frame: Floats, cos: float, sin: float) -> bool:
    """Whether a `circle` (3,) reaches where vehicles count for an agent in its `frame` (3,) with this heading."""
    x, y, radius = circle[0] - frame[0], circle[1] - frame[1], circle[2]
    ahead, left = cos * x + sin * y, abs(cos * y - sin * x)
    return KNOTS[0] - radius < ahead < KNOTS[-1] + radius and left < WIDTHS[-1] + radius


@kernel
def look_ahead(frame: Floats2, own: Singles, first: Ints, end: Ints, traffic: Traffic, out: OutSingles2) -> None:
    """Write the traffic ahead of each of n agents, along its frame and in its direction.

    For one's own lane, then for all lanes, and at each inner one of :data:`.TRAFFIC_KNOTS`: how much faster the
    vehicles there are in the mean [m/s], how much faster they have become in the last second [m/s], and how many there
    are, at most 1. Vehicles count the less the farther they are from the knot and to the side, linearly, and by the
    cosine of the angle to the frame, so that nothing jumps. Without vehicles, all are 0.

    Args:
        frame: (n, 3) x, y [m] and heading [rad] of the agent frames.
        own: (n,) speeds of the agents [m/s].
        first, end: (n,) first and end row (exclusive) of the vehicles that may be ahead of an agent.
        traffic: all vehicles.
        out: (n, TRAFFIC_CHANNELS).
    """
    pose, speed, earlier, seen, _ = traffic
    places, one, none, some = len(KNOTS) - 2, float32(1.0), float32(0.0), float32(TRAFFIC_SOME)
    shares = np.empty(places * len(WIDTHS), np.float32)  # of the vehicles at a place whose earlier speed is known
    blocks = _enclosed(pose)
    direction = np.empty((len(pose), 2), np.float32)
    for j in range(len(pose)):
        direction[j, 0], direction[j, 1] = np.cos(pose[j, 2]), np.sin(pose[j, 2])
    for i in range(len(frame)):
        features = out[i]
        features[:], shares[:] = none, none
        cos, sin = float32(np.cos(frame[i, 2])), float32(np.sin(frame[i, 2]))
        for b in range(first[i] // BLOCK, (end[i] + BLOCK - 1) // BLOCK):
            if not _reaches_ahead(blocks[b], frame[i], cos, sin):
                continue
            for j in range(max(first[i], b * BLOCK), min(end[i], (b + 1) * BLOCK)):
                dx, dy = float32(pose[j, 0] - frame[i, 0]), float32(pose[j, 1] - frame[i, 1])
                ahead, left = cos * dx + sin * dy, abs(cos * dy - sin * dx)
                along = cos * direction[j, 0] + sin * direction[j, 1]
                if ahead <= KNOTS[0] or ahead >= KNOTS[-1] or along <= none:
                    continue
                interval = _interval(ahead)  # the vehicle counts for the knot behind it and for the next
                before, after = KNOTS[interval], KNOTS[interval + 1]
                for w in range(len(WIDTHS)):
                    if left >= WIDTHS[w]:
                        continue
                    aside = along * (one - left / WIDTHS[w])
                    for k in range(max(interval - 1, 0), min(interval + 1, places)):
                        near = (
                            (after - ahead) / (after - before) if k < interval else (ahead - before) / (after - before)
                        )
                        share, place = aside * near, places * w + k
                        features[3 * place] += share * (speed[j] - own[i])
                        if seen[j]:
                            features[3 * place + 1] += share * (speed[j] - earlier[j])
                            shares[place] += share
                        features[3 * place + 2] += share
        for place in range(len(shares)):
            features[3 * place] /= features[3 * place + 2] + some
            features[3 * place + 1] /= shares[place] + some
            features[3 * place + 2] = min(features[3 * place + 2], one)
