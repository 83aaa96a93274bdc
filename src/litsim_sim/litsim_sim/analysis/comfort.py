"""Comfort: which of nuPlan's bounds an agent keeps, and how often it brakes hard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import AgentTable, FloatArray

BOUNDS: dict[str, tuple[float, float]] = {
    "longitudinal_acceleration": (-4.05, 2.40),  # [m/s2]
    "lateral_acceleration": (-4.89, 4.89),  # [m/s2]
    "yaw_rate": (-0.95, 0.95),  # [rad/s]
    "yaw_acceleration": (-1.93, 1.93),  # [rad/s2]
    "longitudinal_jerk": (-4.13, 4.13),  # [m/s3]
    "jerk": (0.0, 8.37),  # [m/s3], magnitude
}
"""nuPlan's bounds of a comfortable ride (Caesar et al. 2021)."""

HARD_BRAKE = -3.0  # [m/s2]


@dataclass(frozen=True)
class Comfort:
    """How an agent's motion felt.

    Attributes:
        agent: whose.
        within: share of steps within each of :data:`BOUNDS`.
        hard_brakes: times that it began to brake harder than 3 m/s2.
    """

    agent: int
    within: dict[str, float]
    hard_brakes: int

    @property
    def comfortable(self) -> bool:
        """Whether every step keeps every bound."""
        return all(share == 1.0 for share in self.within.values())


def comfort(tables: Sequence[AgentTable], agent: int, dt: float) -> Comfort | None:
    """Comfort of `agent` over `tables`, `dt` seconds apart; None where it is on the road for fewer than three."""
    rows = [(table, table.row(agent)) for table in tables]
    there = [(table, row) for table, row in rows if row >= 0]
    if len(there) < 3:
        return None
    speed, acceleration, yaw_rate = (
        np.array([getattr(table, field)[row] for table, row in there])
        for field in ("speed", "acceleration", "yaw_rate")
    )
    values = motion_values(speed, acceleration, yaw_rate, dt)
    within = {
        name: float(np.mean((values[name] >= low) & (values[name] <= high))) for name, (low, high) in BOUNDS.items()
    }
    hard = acceleration < HARD_BRAKE
    return Comfort(agent, within, int(hard[0]) + int(np.sum(hard[1:] & ~hard[:-1])))


def motion_values(
    speed: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, dt: float
) -> dict[str, FloatArray]:
    """The bounded quantities from speed [m/s], acceleration [m/s2] and yaw rate [rad/s] (n,); units of BOUNDS.

    Differences over a step stand for derivatives, so these have n - 1 values.
    """
    lateral = speed * yaw_rate
    jerk_along, jerk_across = np.diff(acceleration) / dt, np.diff(lateral) / dt
    return {
        "longitudinal_acceleration": acceleration,
        "lateral_acceleration": lateral,
        "yaw_rate": yaw_rate,
        "yaw_acceleration": np.diff(yaw_rate) / dt,
        "longitudinal_jerk": jerk_along,
        "jerk": np.hypot(jerk_along, jerk_across),
    }
