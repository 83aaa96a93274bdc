"""The Intelligent Driver Model (Treiber 2000) along a reference path, behind whatever is on it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Positive, Speed, configuration
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray

SIGHT = 120.0  # [m] beyond which nobody is looked at
MARGIN = 0.2  # [m] kept to the side of others, unless said otherwise
MERGE = 15.0  # [m] over which a vehicle beside its path is taken to come onto it
GAP_MIN = 0.1  # [m] below which the model is not evaluated: it has a pole at zero

Poses = tuple[FloatArray, FloatArray, FloatArray]
"""x, y [m] and yaw [rad] of m agents; arrays (m,)."""


@configuration
class IdmConfig:
    """Parameters of the model; the defaults are those of sisl/ngsim_env, calibrated on NGSIM.

    Attributes:
        desired_speed: v0.
        headway: T.
        standstill_gap: s0.
        acceleration: a_max.
        deceleration: comfortable braking b.
        braking_max: no harder than this, whatever the model says.
    """

    desired_speed: NonNegative[Speed] = 20.0
    headway: NonNegative[Duration] = 0.5
    standstill_gap: NonNegative[Length] = 2.0
    acceleration: Positive[Acceleration] = 3.0
    deceleration: Positive[Acceleration] = 2.5
    braking_max: Positive[Acceleration] = 8.0


def idm_acceleration(
    config: IdmConfig,
    speed: float | FloatArray,
    desired_speed: float | FloatArray,
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray | None = None,
) -> FloatArray:
    """Acceleration (...) [m/s2] of vehicles, each for the most demanding of its leaders.

    Args:
        config: parameters.
        speed, desired_speed: (...) of the vehicles [m/s].
        gap: (..., n) to each leader, bumper to bumper [m].
        leader_speed: (..., n) [m/s].
        leads: (..., n) which of the n are leaders; None is all of them.
    """
    speed, desired_speed = np.asarray(speed, np.float64), np.asarray(desired_speed, np.float64)
    free = config.acceleration * (1.0 - np.float_power(speed / np.maximum(desired_speed, 0.1), 4))
    own = speed[..., None]
    closing = own * (own - leader_speed) / (2.0 * np.sqrt(config.acceleration * config.deceleration))
    wanted = config.standstill_gap + np.maximum(0.0, own * config.headway + closing)
    interaction = config.acceleration * (wanted / np.maximum(gap, GAP_MIN)) ** 2
    if leads is not None:
        interaction = np.where(leads, interaction, 0.0)
    return np.clip(free - interaction.max(axis=-1, initial=0.0), -config.braking_max, config.acceleration)


@dataclass(frozen=True)
class AlongPath:
    """Agents as a vehicle on a path sees them, or as m vehicles do: arrays (n,) or (m, n), columns as in their table.

    Attributes:
        s: arc length of the agent's place on the path [m]; -inf out of sight.
        d: offset of the agent from the path, to the left [m]; inf out of sight.
        gap: from the vehicle's front bumper to the agent's rear, along the path [m]; negative alongside.
        speed: of the agent along the path [m/s].
        ahead: whether the agent's centre is ahead of the vehicle's.
        aside: [m] between the agent's side and the vehicle's where they pass; negative in the strip that it sweeps.
        in_path: whether the agent's box reaches into that strip, widened by the margin.
    """

    s: FloatArray
    d: FloatArray
    gap: FloatArray
    speed: FloatArray
    ahead: BoolArray
    aside: FloatArray
    in_path: BoolArray


def along_path(path: ReferencePath, agents: AgentTable, row: int, margin: float = MARGIN) -> AlongPath:
    """Agents relative to the one in `row`, which follows `path`; see :func:`along_paths`. Arrays (n,)."""
    view = along_paths(path.batch, agents, np.array([row]), margin)
    return AlongPath(*(getattr(view, field.name)[0] for field in fields(AlongPath)))


def along_paths(
    paths: PathBatch,
    agents: AgentTable,
    rows: IntArray,
    margin: float = MARGIN,
    sight: float | FloatArray = SIGHT,
    poses: Poses | None = None,
) -> AlongPath:
    """Agents relative to those in `rows`, each of which follows a path of its own; itself it sees nowhere ahead.

    Args:
        paths: m paths.
        agents: everybody, n agents.
        rows: (m,) of the agents that look.
        margin: [m] kept to the side of the agents' boxes.
        sight: (m,) or one for all: how far away each still sees somebody [m]; no farther than SIGHT.
        poses: at which each of those that look takes itself to be; None for where it is.

    Returns:
        arrays (m, n).
    """
    own_x, own_y, own_yaw = poses or (agents.x[rows], agents.y[rows], agents.yaw[rows])
    dx, dy = agents.x - own_x[:, None], agents.y - own_y[:, None]
    reach = np.broadcast_to(np.minimum(sight, SIGHT), rows.shape)
    viewer, agent = near = np.nonzero(dx * dx + dy * dy < (reach * reach)[:, None])
    x, y, yaw = agents.x[agent], agents.y[agent], agents.yaw[agent]
    if poses is not None:
        itself = agent == rows[viewer]
        x[itself], y[itself], yaw[itself] = (own[viewer[itself]] for own in (own_x, own_y, own_yaw))
    at = paths.project(viewer, x, y)
    segment = at.segment + (at.s >= paths.s[viewer, at.segment + 1])
    segment = np.minimum(segment, paths.count[viewer] - 2)
    turn = yaw - paths.heading(viewer, segment)
    cos = np.cos(turn)
    along, across, length, width = np.abs(cos), np.abs(np.sin(turn)), agents.length[agent], agents.width[agent]
    half_along = 0.5 * (length * along + width * across)
    half_across = 0.5 * (length * across + width * along)

    def spread(values: FloatArray | BoolArray, elsewhere: float) -> Any:
        dense = np.full(dx.shape, elsewhere, values.dtype)
        dense[near] = values
        return dense

    s, d = spread(at.s, -np.inf), spread(at.d, np.inf)
    each = np.arange(len(rows))
    own_s, own_d = s[each, rows], d[each, rows]
    # the strip is swept from where the vehicle is to the path: over the first metres it includes the vehicle's offset
    offset = own_d[viewer] * np.clip(1.0 - (at.s - own_s[viewer]) / MERGE, 0.0, 1.0)
    own = rows[viewer]
    passing, half_width = np.abs(at.d - offset), 0.5 * agents.width[own]
    ahead = s > own_s[:, None]
    ahead[each, rows] = False
    return AlongPath(
        s=s,
        d=d,
        gap=spread(at.s - half_along - own_s[viewer] - 0.5 * agents.length[own], -np.inf),
        speed=spread(agents.speed[agent] * cos, 0.0),
        ahead=ahead,
        aside=spread(passing - (half_across + half_width), np.inf),
        in_path=spread(passing < half_across + (half_width + margin), 0),
    )
