"""Penalties of policy C in training: collision, leaving road and log, discomfort, and need of a guard.

Ramps are smooth as in RAIL (Bhattacharyya 2019), since a step in the penalty has no useful gradient. The penalty for
need of a guard comes at once, that of a collision seconds later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.pair_geometry import overlap, within, within_scenes
from litsim_sim.core.quantities import NonNegative, Number, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray, index_of
from litsim_sim.kernels.compiled import Bools2, Floats, Floats3, Ints, kernel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log

JERK_FULL = 8.37  # [m/s3] jerk at which the penalty is full
BRAKE_FROM, BRAKE_FULL = 3.0, 4.5  # [m/s2] braking at which the penalty begins and is full
EDGE_FROM, EDGE_FULL = 0.5, -0.1  # [m] likewise, from the agent's side to the edge of the road; negative is outside
PROBES = np.linspace(EDGE_FROM, EDGE_FULL, 7)  # [m] distances from the agent's side at which the road is probed
NEAR_ALONG, NEAR_ACROSS = 1.5, 0.4  # [m] gaps between boxes, along and across, below which the penalty begins


@configuration
class PenaltyConfig:
    """Weights of the penalties; in comparison, the critic's reward is at most a few units per step.

    Attributes:
        collision: once, when it happens; the episode ends there.
        off_road: once, when the road is left; the episode ends there.
        edge: per step, with a side 0.1 m beyond the edge.
        proximity: per step, at contact.
        hard_brake: per step, from 4.5 m/s2 on.
        guard: per step, with a command that a guard of the safety layer would have changed.
        share: share of an agent's penalty that is also given to the agent that caused its takeover, so that braking
            harder than necessary in front of others does not pay.
        displacement: per metre by which the distance from the own log, without lag, has grown; negative where it has
            shrunk.
        control: per step.
        jerk: per step, with a jerk of JERK_FULL; in proportion to its square.
    """

    collision: NonNegative[Number] = 20.0
    off_road: NonNegative[Number] = 20.0
    edge: NonNegative[Number] = 2.0
    proximity: NonNegative[Number] = 1.0
    hard_brake: NonNegative[Number] = 0.3
    guard: NonNegative[Number] = 1.0
    share: NonNegative[Number] = 0.0
    displacement: NonNegative[Number] = 0.0
    control: NonNegative[Number] = 0.0
    jerk: NonNegative[Number] = 0.0


@dataclass(frozen=True)
class Penalties:
    """Penalties of m agents in one step, before weights; arrays (m,).

    Attributes:
        collision, off_road: whether it happened in this step.
        edge, proximity, hard_brake: in [0, 1].
        guard: whether a guard would have changed the command.
        displacement: growth of the distance from the own log [m]; 0 where the log is over.
        jerk: in [0, 1].
    """

    collision: BoolArray
    off_road: BoolArray
    edge: FloatArray
    proximity: FloatArray
    hard_brake: FloatArray
    guard: BoolArray
    displacement: FloatArray
    jerk: FloatArray

    def total(self, config: PenaltyConfig) -> FloatArray:
        """Weighted sum (m,), at most 0 but for `displacement`; of those from edge to guard, only the worst counts."""
        lasting = np.maximum.reduce(
            [
                config.edge * self.edge,
                config.proximity * self.proximity,
                config.hard_brake * self.hard_brake,
                config.guard * self.guard,
            ]
        )
        lasting += config.displacement * self.displacement + config.control + config.jerk * self.jerk
        return -(lasting + config.collision * self.collision + config.off_road * self.off_road)


def penalties(
    before: AgentTable,
    after: AgentTable,
    agents: IntArray,
    lane_map: LaneMap,
    guarded: BoolArray,
    displacement: FloatArray,
) -> Penalties:
    """The penalties of `agents` (m,), which are in both tables, for the step between them.

    `guarded` (m,) is the mask of agents whose command a guard would have changed, `displacement` (m,) that of
    :class:`Penalties`.

    A collision is a new contact with an agent that is not behind, since an agent cannot prevent a rear-end collision
    with itself.
    """
    rows, rows_before = after.rows(agents), before.rows(agents)
    change = after.acceleration[rows] - before.acceleration[rows_before]
    clearance = edge_clearance(after, rows, lane_map)
    outside = clearance <= EDGE_FULL
    if outside.any():
        outside &= edge_clearance(before, rows_before, lane_map) > EDGE_FULL
    touching, near = others_near(after, rows)
    if touching.any():
        earlier = before.rows(after.id)
        was_touching, _ = others_near(before, rows_before)
        touching &= (earlier < 0) | ~was_touching[:, earlier]
    return Penalties(
        collision=np.asarray(touching.any(axis=1)),
        off_road=outside,
        edge=ramp(clearance, EDGE_FROM, EDGE_FULL),
        proximity=near,
        hard_brake=ramp(-after.acceleration[rows], BRAKE_FROM, BRAKE_FULL),
        guard=guarded,
        displacement=displacement,
        jerk=np.minimum(np.abs(change) / STEP_S / JERK_FULL, 1.0) ** 2,
    )


def displacement(before: AgentTable, after: AgentTable, agents: IntArray, log: Log) -> FloatArray:
    """Growth (m,) [m] of the distances of `agents` (m,), in both tables, from their logs; 0 once these have ended."""
    rows = log.ids.searchsorted(agents)

    def distance(table: AgentTable) -> FloatArray:
        current, now = table.rows(agents), np.minimum(table.step, log.last_step[rows])
        return np.hypot(table.x[current] - log.x[rows, now], table.y[current] - log.y[rows, now])

    return np.where(after.step <= log.last_step[rows], distance(after) - distance(before), 0.0)


def passed_on(penalty: FloatArray, agents: IntArray, because: IntArray) -> FloatArray:
    """Sums (m,) over the penalties of the agents whose takeover each agent caused.

    Args:
        penalty: (m,) of the agents.
        agents: (m,) ids, ascending.
        because: (m,) id of the agent that caused the takeover of each; ids that are not in `agents` are ignored.
    """
    found, causes = np.zeros(len(agents)), index_of(agents, because)
    np.add.at(found, causes[causes >= 0], penalty[causes >= 0])
    return found


def edge_clearance(table: AgentTable, rows: IntArray, lane_map: LaneMap) -> FloatArray:
    """Distance (m,) [m] from the agents' sides to the edge of the road, rounded to PROBES; negative is outside."""
    x, y = _probes(table.x, table.y, table.yaw, table.width, rows)
    inside = np.asarray(lane_map.inside_road(x.ravel(), y.ravel()).reshape(x.shape).all(axis=1))
    return np.where(inside.any(axis=1), PROBES[np.argmax(inside, axis=1)], EDGE_FULL)


def others_near(table: AgentTable, rows: IntArray) -> tuple[BoolArray, FloatArray]:
    """Contacts (m, n) of the agents in `rows` with all n that are not behind them, and proximity (m,) in [0, 1]."""
    return _contacts(table.scene, table.x, table.y, table.yaw, table.length, table.width, rows)


@kernel
def _probes(x: Floats, y: Floats, yaw: Floats, width: Floats, rows: Ints) -> tuple[Floats3, Floats3]:
    """Points to the left and to the right of m agents at which the road is probed: x and y (m, 2, p) [m]."""
    shape = (len(rows), 2, len(PROBES))
    place_x, place_y = np.empty(shape), np.empty(shape)
    for i in range(len(rows)):
        own = rows[i]
        cos, sin = math.cos(yaw[own]), math.sin(yaw[own])
        for k in range(len(PROBES)):
            out = 0.5 * width[own] + PROBES[k]
            place_x[i, 0, k], place_x[i, 1, k] = x[own] - out * sin, x[own] + out * sin
            place_y[i, 0, k], place_y[i, 1, k] = y[own] + out * cos, y[own] - out * cos
    return place_x, place_y


@kernel
def _contacts(
    scene: Ints, x: Floats, y: Floats, yaw: Floats, length: Floats, width: Floats, rows: Ints
) -> tuple[Bools2, Floats]:
    """See :func:`others_near`; the first six arrays (n,) are columns of the table."""
    touching, near = np.zeros((len(rows), len(x)), np.bool_), np.empty(len(rows))
    begin, end = within_scenes(scene, rows)
    for i in range(len(rows)):
        own, least = rows[i], np.inf
        cos, sin = math.cos(yaw[own]), math.sin(yaw[own])
        for j in range(begin[i], end[i]):
            dx, dy = x[j] - x[own], y[j] - y[own]
            ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
            half_length, half_width = 0.5 * (length[j] + length[own]), 0.5 * (width[j] + width[own])
            if j == own or not ahead > -0.5 * half_length:
                continue
            # boxes farther apart than this, along or across, cannot touch whatever their headings
            if abs(ahead) < half_length + half_width and abs(left) < half_length + half_width:
                touching[i, j] = overlap(dx, dy, yaw[own], yaw[j], length[own], width[own], length[j], width[j])
            least = min(least, max((abs(ahead) - half_length) / NEAR_ALONG, (abs(left) - half_width) / NEAR_ACROSS))
        near[i] = within(1.0 - least, 0.0, 1.0)
    return touching, near


def ramp(value: FloatArray, start: float, full: float) -> FloatArray:
    """0 up to `start`, 1 from `full` on, linear between."""
    return np.clip((value - start) / (full - start), 0.0, 1.0)
