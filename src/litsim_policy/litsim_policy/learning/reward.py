"""What policy C is punished for in training: collision, proximity, leaving the road, hard braking, need of a guard.

Smooth ramps after RAIL (Bhattacharyya 2019): a cliff tells a gradient nothing. A guard that would intervene tells at
once what a collision tells seconds later. All vectorised over the agents that were driven.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.quantities import NonNegative, Number, configuration
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.maps.lane_map import LaneMap

BRAKE_FROM, BRAKE_FULL = 3.0, 4.5  # [m/s2] of braking between which the penalty rises
EDGE_FROM, EDGE_FULL = 0.5, -0.1  # [m] from the agent's side to the edge of the road, likewise; negative is outside
EDGE_PROBES = 7  # places between those two
NEAR_ALONG, NEAR_ACROSS = 1.5, 0.4  # [m] between boxes, along and across, below which somebody is near


@configuration
class PenaltyConfig:
    """Weights of the penalties; beside them, the critic's reward is at most a few units a step.

    Attributes:
        collision: once, when it happens; the episode ends there.
        off_road: once, when the road is left; the episode ends there.
        edge: a step, with a side 0.1 m beyond the edge.
        proximity: a step, at contact.
        hard_brake: a step, from 4.5 m/s2 on.
        guard: a step, with a command that a guard of the safety layer would have changed.
    """

    collision: NonNegative[Number] = 20.0
    off_road: NonNegative[Number] = 20.0
    edge: NonNegative[Number] = 2.0
    proximity: NonNegative[Number] = 1.0
    hard_brake: NonNegative[Number] = 0.3
    guard: NonNegative[Number] = 1.0


@dataclass(frozen=True)
class Penalties:
    """What each of m agents is punished for in one step, before weights; arrays (m,).

    Attributes:
        collision, off_road: whether it happened in this step.
        edge, proximity, hard_brake: how bad it is, from 0 to 1.
        guard: whether a guard would have changed the command.
    """

    collision: BoolArray
    off_road: BoolArray
    edge: FloatArray
    proximity: FloatArray
    hard_brake: FloatArray
    guard: BoolArray

    def total(self, config: PenaltyConfig) -> FloatArray:
        """Weighted sum of the penalties (m,), at most 0; of the terms that last, only the worst counts, as in RAIL."""
        lasting = np.maximum.reduce(
            [
                config.edge * self.edge,
                config.proximity * self.proximity,
                config.hard_brake * self.hard_brake,
                config.guard * self.guard,
            ]
        )
        return -(lasting + config.collision * self.collision + config.off_road * self.off_road)


def penalties(
    before: AgentTable, after: AgentTable, agents: IntArray, lane_map: LaneMap, guarded: BoolArray
) -> Penalties:
    """The penalties of `agents` (m,), who are on the road in both tables, for the step between them.

    `guarded` (m,) tells whose command a guard would have changed.

    A collision is a new contact with somebody who is not behind: whoever is run into from behind could not help it.
    """
    rows = after.rows(agents)
    clearance = edge_clearance(after, rows, lane_map)
    outside = (clearance <= EDGE_FULL) & (edge_clearance(before, before.rows(agents), lane_map) > EDGE_FULL)
    touching, near = _others(after, rows)
    known = before.rows(after.id)
    touched = np.zeros_like(touching)
    was_touching, _ = _others(before, before.rows(agents))
    both = known >= 0
    touched[:, both] = was_touching[:, known[both]]
    return Penalties(
        collision=np.asarray((touching & ~touched).any(axis=1)),
        off_road=outside,
        edge=_ramp(clearance, EDGE_FROM, EDGE_FULL),
        proximity=near,
        hard_brake=_ramp(-after.acceleration[rows], BRAKE_FROM, BRAKE_FULL),
        guard=guarded,
    )


def edge_clearance(table: AgentTable, rows: IntArray, lane_map: LaneMap) -> FloatArray:
    """(m,) distance [m] from the agents' sides to the edge of the road, in [EDGE_FULL, EDGE_FROM] to the next probe."""
    probes = np.linspace(EDGE_FROM, EDGE_FULL, EDGE_PROBES)
    out = 0.5 * table.width[rows, None] + probes
    sides = np.stack([out, -out], axis=1)
    x = table.x[rows, None, None] - sides * np.sin(table.yaw[rows, None, None])
    y = table.y[rows, None, None] + sides * np.cos(table.yaw[rows, None, None])
    inside = np.asarray(lane_map.inside_road(x.ravel(), y.ravel()).reshape(x.shape).all(axis=1))
    return np.where(inside.any(axis=1), probes[np.argmax(inside, axis=1)], EDGE_FULL)


def _others(table: AgentTable, rows: IntArray) -> tuple[BoolArray, FloatArray]:
    """Whom the agents touch that is not behind them (m, n), and how near the nearest of those is, in [0, 1] (m,)."""
    dx, dy = table.x[None] - table.x[rows, None], table.y[None] - table.y[rows, None]
    ahead, left = to_body(dx, dy, table.yaw[rows, None])
    half_length = 0.5 * (table.length[None] + table.length[rows, None])
    counts = ahead > -0.5 * half_length
    counts[np.arange(len(rows)), rows] = False
    size = (table.length, table.width)
    mine = (table.length[rows, None], table.width[rows, None])
    touching: BoolArray = boxes_overlap(dx, dy, table.yaw[rows, None], table.yaw, mine, size) & counts
    along = np.abs(ahead) - half_length
    across = np.abs(left) - 0.5 * (table.width[None] + table.width[rows, None])
    apart = np.maximum(along / NEAR_ALONG, across / NEAR_ACROSS)
    return touching, np.clip(1.0 - np.where(counts, apart, np.inf).min(axis=1, initial=np.inf), 0.0, 1.0)


def _ramp(value: FloatArray, start: float, full: float) -> FloatArray:
    """0 up to `start`, 1 from `full` on, linear between."""
    return np.clip((value - start) / (full - start), 0.0, 1.0)
