"""How agents that are off their logs go through the states of a takeover: HELD, HANDBACK, RELEASED."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from litsim_policy.conflict.off_log import OffLog
from litsim_policy.motion.car_following import along_paths
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.scenario.log import Log

if TYPE_CHECKING:
    from litsim_policy.conflict.takeover import TakeoverConfig

OBSTACLE_SIGHT = 30.0  # [m] beyond the place in the log within which whoever stands before it has his centre


@dataclass(frozen=True)
class Residuals:
    """How far r agents are from where their logs, lags included, have them at a step; arrays (r,).

    Attributes:
        known: whether the log has the agent at that time; the other fields mean nothing where it has not.
        x, y: of the log [m].
        position: distance [m].
        speed: faster than the log by this [m/s].
        yaw: to the left of the log's heading [rad].
    """

    known: BoolArray
    x: FloatArray
    y: FloatArray
    position: FloatArray
    speed: FloatArray
    yaw: FloatArray

    @classmethod
    def of(cls, log: Log, log_rows: IntArray, lag: IntArray, table: AgentTable, rows: IntArray) -> Residuals:
        """Return the residuals of agents.

        Args:
            log: of everybody.
            log_rows: (r,) of the agents in the log.
            lag: (r,) steps by which the logs lag.
            table: everybody now.
            rows: (r,) of the agents in `table`.
        """
        now = table.step - lag
        at = log_rows, np.clip(now, 0, log.steps - 1)
        known = (now >= 0) & (now < log.steps) & log.valid[at]
        x, y = log.x[at], log.y[at]
        position = np.hypot(table.x[rows] - x, table.y[rows] - y)
        yaw = wrap_angle(table.yaw[rows] - log.yaw[at])
        return cls(known, x, y, position, table.speed[rows] - log.speed[at], yaw)


def obstructed(off: OffLog, at: IntArray, table: AgentTable, rows: IntArray, residuals: Residuals) -> BoolArray:
    """Whether somebody stands between agents and their places in the log.

    Args:
        off: agents off their logs.
        at: (k,) positions of the agents in `off`.
        table: everybody.
        rows: (r,) of the agents of `off` in `table`.
        residuals: of the agents of `off`.

    Returns:
        mask (k,).
    """
    if not len(at):
        return np.zeros(0, np.bool_)
    paths, rows = off.logged_paths.take(at), rows[at]
    place = paths.project(np.arange(len(at)), residuals.x[at], residuals.y[at])
    sight = OBSTACLE_SIGHT + 2.0 * residuals.position[at]
    view = along_paths(paths, table, rows, sight=sight)
    to_place = place.s - view.s[np.arange(len(at)), rows]
    return np.asarray((view.ahead & view.in_path & (view.gap < to_place[:, None])).any(axis=1))


def review(
    config: TakeoverConfig, off: OffLog, table: AgentTable, rows: IntArray, residuals: Residuals, in_conflict: BoolArray
) -> None:
    """Move agents that were off their logs before this step on to their next states, in place.

    Who is in conflict, obstructed or without a log is HELD. Who has been free for long enough is handed back along
    its logged path; on the way there it is released where the residuals allow it.

    Args:
        config: when that is.
        off: r agents.
        table: everybody.
        rows: (r,) of the agents in `table`.
        residuals: of the agents.
        in_conflict: (r,) whose log leads into a conflict.
    """
    off.in_conflict[:] = in_conflict
    free = residuals.known & ~in_conflict
    at = np.flatnonzero(free)
    free[at] = ~obstructed(off, at, table, rows, residuals)
    off.clear[:] = np.where(free, off.clear + 1, 0)
    passed = off.paths.project(np.arange(len(off)), table.x[rows], table.y[rows]).s >= off.goal_s
    needed = np.where(passed, config.clear_steps, 2 * config.clear_steps)
    long_enough = (off.clear >= needed) & (table.step - off.detected_step >= config.held_steps_min)
    within = (residuals.position <= config.release_position) & (np.abs(residuals.speed) <= config.release_speed)
    within &= np.abs(residuals.yaw) <= config.release_yaw
    held = off.state == TakeoverState.HELD
    follows = np.where(within & ~held, TakeoverState.RELEASED, TakeoverState.HANDBACK)
    off.state[:] = np.where(free & (~held | long_enough), follows, TakeoverState.HELD)
    off.return_to_log(off.state == TakeoverState.HANDBACK)
