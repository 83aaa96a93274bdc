"""Actions of policy C: longitudinal and lateral acceleration and yaw rate, and how a vehicle executes the three."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import FloatArray

ACTIONS = ("longitudinal acceleration", "lateral acceleration", "yaw rate")
LOW = np.array([-6.0, -4.0, -0.5])  # [m/s2], [m/s2], [rad/s] commands of action -1
HIGH = np.array([3.0, 4.0, 0.5])  # [m/s2], [m/s2], [rad/s] commands of action 1
LATERAL_SPREAD = 1.0  # [m/s2] deviation from the lateral acceleration that weighs as much as YAW_RATE_SPREAD
YAW_RATE_SPREAD = 0.1  # [rad/s] deviation from the yaw rate that weighs as much as LATERAL_SPREAD


def physical(action: FloatArray) -> FloatArray:
    """Commands (..., 3) [m/s2], [m/s2], [rad/s] of actions in [-1, 1]; zero for zero, and linear on either side."""
    return np.where(action < 0.0, -action * LOW, action * HIGH)


def normalised(command: FloatArray) -> FloatArray:
    """Returns the inverse of :func:`physical`, clipped to [-1, 1]."""
    return np.clip(np.where(command < 0.0, -command / LOW, command / HIGH), -1.0, 1.0)


def executed_yaw_rate(command: FloatArray, speed: FloatArray) -> FloatArray:
    """Returns yaw rate (m,) [rad/s] of a vehicle that is given commands (m, 3) at speeds (m,) [m/s].

    A vehicle that does not slip has a lateral acceleration of its speed times its yaw rate, so the two lateral actions
    are redundant. The executed motion is the nearest to both (weighted least squares): at low speed the yaw rate
    counts, at high speed the lateral acceleration.
    """
    by_rate, by_lateral = 1.0 / YAW_RATE_SPREAD**2, speed / LATERAL_SPREAD**2
    return (by_rate * command[:, 2] + by_lateral * command[:, 1]) / (by_rate + by_lateral * speed)


def consistent(acceleration: FloatArray, yaw_rate: FloatArray, speed: FloatArray) -> FloatArray:
    """Returns commands (m, 3) of vehicles that move with `acceleration` [m/s2] and `yaw_rate` [rad/s], without slip."""
    return np.column_stack([acceleration, speed * yaw_rate, yaw_rate])
