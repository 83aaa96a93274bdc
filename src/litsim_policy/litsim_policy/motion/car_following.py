"""The Intelligent Driver Model (Treiber 2000) along a reference path, behind whatever is on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.scene import AgentTable, FloatArray

SIGHT = 120.0  # [m] beyond which nobody is looked at
GAP_MIN = 0.1  # [m] below which the model is not evaluated: it has a pole at zero


@dataclass(frozen=True)
class IdmConfig:
    """Parameters of the model; the defaults are those of sisl/ngsim_env, calibrated on NGSIM.

    Attributes:
        desired_speed: v0 [m/s].
        headway: T [s].
        standstill_gap: s0 [m].
        acceleration: a_max [m/s2].
        deceleration: comfortable braking b [m/s2].
        braking_max: no harder than this, whatever the model says [m/s2].
    """

    desired_speed: float = 20.0
    headway: float = 0.5
    standstill_gap: float = 2.0
    acceleration: float = 3.0
    deceleration: float = 2.5
    braking_max: float = 8.0


def idm_acceleration(
    config: IdmConfig, speed: float, desired_speed: float, gap: FloatArray, leader_speed: FloatArray
) -> float:
    """Acceleration [m/s2] for the most demanding of the leaders (m,): gaps [m] bumper to bumper, speeds [m/s]."""
    free = config.acceleration * (1.0 - (speed / max(desired_speed, 0.1)) ** 4)
    if not len(gap):
        return float(np.clip(free, -config.braking_max, config.acceleration))
    closing = speed * (speed - leader_speed) / (2.0 * np.sqrt(config.acceleration * config.deceleration))
    wanted = config.standstill_gap + np.maximum(0.0, speed * config.headway + closing)
    interaction = config.acceleration * (wanted / np.maximum(gap, GAP_MIN)) ** 2
    return float(np.clip(free - interaction.max(), -config.braking_max, config.acceleration))


@dataclass(frozen=True)
class AlongPath:
    """Agents as a vehicle on a path sees them; arrays (n,), rows as in the table they come from.

    Attributes:
        gap: from the vehicle's front bumper to the agent's rear, along the path [m]; negative alongside.
        speed: of the agent along the path [m/s].
        ahead: whether the agent's centre is ahead of the vehicle's.
        in_path: whether the agent's box reaches into the strip that the vehicle sweeps.
    """

    gap: FloatArray
    speed: FloatArray
    ahead: np.ndarray
    in_path: np.ndarray


def along_path(path: ReferencePath, agents: AgentTable, row: int, margin: float = 0.2) -> AlongPath:
    """Agents relative to the one in `row`, which follows `path`; itself it sees nowhere ahead.

    Args:
        path: of the agent in `row`.
        agents: everybody, n agents.
        row: of the agent that looks.
        margin: [m] kept to the side of the agent's box.
    """
    near = np.hypot(agents.x - agents.x[row], agents.y - agents.y[row]) < SIGHT
    s, d = np.full(len(agents), -np.inf), np.full(len(agents), np.inf)
    s[near], d[near] = path.project(agents.x[near], agents.y[near])
    turn = agents.yaw - path.heading(s)
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    half_along = 0.5 * (agents.length * cos + agents.width * sin)
    half_across = 0.5 * (agents.length * sin + agents.width * cos)
    own_half_width = 0.5 * agents.width[row] + margin
    # the strip is swept from where the vehicle is to the path: over the first metres it includes the vehicle's offset
    offset = d[row] * np.clip(1.0 - (s - s[row]) / 15.0, 0.0, 1.0)
    in_path = np.abs(d - offset) < half_across + own_half_width
    ahead = s > s[row]
    ahead[row] = False
    gap = s - half_along - s[row] - 0.5 * agents.length[row]
    return AlongPath(gap, agents.speed * np.cos(turn), ahead, in_path)
