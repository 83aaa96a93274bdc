"""Comfort: how often an agent stays within nuPlan's bounds, and how often it brakes hard."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_sim.core.scene import AgentTable, BoolArray, Controller, FloatArray
from litsim_sim.core.steps import Steps

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
BRAKE_OVER = -1.0  # [m/s2] above which a hard brake is over; braking hard again before that continues it
ROUNDING = 1e-6  # [m/s2] tolerance on HARD_BRAKE: a command of exactly that deceleration is not a hard brake


@dataclass(frozen=True)
class Comfort:
    """Comfort of one agent's motion.

    Attributes:
        agent: its id.
        within: share of steps within each of :data:`BOUNDS`.
        hard_brakes: number of manoeuvres that brake harder than 3 m/s2.
        hard_brakes_driven: how many of them begin to do so off the log, driven by a policy or a stack.
    """

    agent: int
    within: dict[str, float]
    hard_brakes: int
    hard_brakes_driven: int

    @property
    def comfortable(self) -> bool:
        """Whether every step keeps every bound."""
        return all(share == 1.0 for share in self.within.values())


def comfort(tables: Sequence[AgentTable], agent: int, dt: float) -> Comfort | None:
    """Returns the comfort of `agent` over `tables`, steps of `dt` [s].

    None where it is on the road for fewer than three steps, or for no two in a row.
    """
    steps = Steps.of(tables)
    rows, table = steps.track(agent), steps.stacked
    follows = np.diff(steps.step[table.number[rows]]) == 1
    if len(rows) < 3 or not follows.any():
        return None
    speed, acceleration, yaw_rate, controller = (
        getattr(table, field)[rows] for field in ("speed", "acceleration", "yaw_rate", "controller")
    )
    values = motion_values(speed, acceleration, yaw_rate, dt)
    within = {}
    for name, (low, high) in BOUNDS.items():
        known = values[name] if len(values[name]) == len(rows) else values[name][follows]
        within[name] = float(np.mean((known >= low) & (known <= high)))
    begins = hard_brakes_begin(acceleration)
    return Comfort(agent, within, int(begins.sum()), int((begins & (controller != Controller.LOG)).sum()))


def hard_brakes_begin(acceleration: FloatArray) -> BoolArray:
    """Returns (n,) whether a brake beyond 3 m/s2 begins at each of consecutive steps with `acceleration` (n,) [m/s2].

    It is over once the deceleration is below 1 m/s2, so that a deceleration around 3 m/s2 counts once.
    """
    hard, over = acceleration < HARD_BRAKE - ROUNDING, acceleration > BRAKE_OVER
    begins, braking = np.zeros(len(acceleration), np.bool_), False
    for k in np.flatnonzero(hard | over).tolist():
        begins[k] = hard[k] and not braking
        braking = bool(hard[k])
    return begins


def hard_brakes_in_log(tables: Sequence[AgentTable], log: Sequence[AgentTable], agent: int) -> int:
    """Returns the number of hard brakes in the log of `agent` that begin while the run has it off its log."""
    steps, logged = Steps.of(tables), Steps.of(log)
    rows = steps.track(agent)
    driven = steps.stacked.number[rows[steps.stacked.controller[rows] != Controller.LOG]]
    then = logged.track(agent)
    begins = logged.stacked.number[then[hard_brakes_begin(logged.stacked.acceleration[then])]]
    return int(np.isin(logged.step[begins], steps.step[driven]).sum())


def motion_values(
    speed: FloatArray, acceleration: FloatArray, yaw_rate: FloatArray, dt: float
) -> dict[str, FloatArray]:
    """Returns the quantities of BOUNDS from speed [m/s], acceleration [m/s2] and yaw rate [rad/s], each (n,).

    Derivatives are differences over a step, so they have n - 1 values.
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
