"""Transitions of agents off their logs between the states of a takeover: HELD, HANDBACK, RELEASED."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numba.types import Tuple

from litsim_policy.conflict.off_log import OffLog
from litsim_policy.motion.along_path import along_paths
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import AgentTable, BoolArray, ByteArray, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.kernels.compiled import (
    BOOLS,
    BOOLS2,
    FLOATS,
    FLOATS2,
    INTS,
    OUT_BOOLS,
    OUT_BYTES,
    OUT_FLOATS2,
    OUT_INTS,
    float64,
    int64,
    kernel,
    void,
)
from litsim_sim.scenario.log import Log

if TYPE_CHECKING:
    from litsim_policy.conflict.takeover import TakeoverConfig

Excuse = Callable[[int, int], bool]
"""Whether the agent in the first row of a table, on the way to its place in the log, overlaps the second there, too."""

HELD, HANDBACK, RELEASED = int(TakeoverState.HELD), int(TakeoverState.HANDBACK), int(TakeoverState.RELEASED)
OBSTACLE_SIGHT = 30.0  # [m] range, beyond the distance to the place in the log, of agents that may block the way


@quickly_made
@dataclass(frozen=True)
class Residuals:
    """Residuals of r agents from their logs, lags included, at a step; arrays (r,).

    Attributes:
        known: whether the log contains the agent at that time; otherwise the other fields are meaningless.
        x, y: of the log [m].
        position: distance [m].
        speed: of the agent less that of the log [m/s].
        yaw: of the agent relative to the log, to the left [rad].
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
            log: of all agents.
            log_rows: (r,) of the agents in the log.
            lag: (r,) steps by which the logs lag.
            table: all agents now.
            rows: (r,) of the agents in `table`.
        """
        logged, now = (log.valid, log.x, log.y, log.yaw, log.speed), (table.x, table.y, table.yaw, table.speed)
        known, differences = _residuals(*logged, log_rows, table.step - lag, rows, *now)
        return cls(known, *differences)

    @property
    def reported(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (r,) of position [m] and speed [m/s] as published; -1 and 0 of agents that are not `known`."""
        return np.where(self.known, self.position, -1.0), np.where(self.known, self.speed, 0.0)

    def take(self, which: BoolArray) -> Residuals:
        """The residuals of the agents in the mask `which` (r,)."""
        return self if which.all() else Residuals(*(getattr(self, field.name)[which] for field in fields(self)))


@kernel(Tuple((OUT_BOOLS, OUT_FLOATS2))(BOOLS2, *[FLOATS2] * 4, INTS, INTS, INTS, *[FLOATS] * 4))
def _residuals(  # noqa: PLR0917 - a kernel takes arrays and numbers
    log_valid: BoolArray,
    log_x: FloatArray,
    log_y: FloatArray,
    log_yaw: FloatArray,
    log_speed: FloatArray,
    log_rows: IntArray,
    now: IntArray,
    rows: IntArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
) -> tuple[BoolArray, FloatArray]:
    """Return the first field of :class:`Residuals` (r,), and the others (5, r).

    Args:
        log_valid, log_x, log_y, log_yaw, log_speed: (N, S) of the log [m], [rad], [m/s].
        log_rows: (r,) of the agents in it.
        now: (r,) present step of each agent's log.
        rows: (r,) of the agents in the table.
        x, y, yaw, speed: (n,) of the table.
    """
    count, last = len(rows), log_x.shape[1] - 1
    known, off = np.empty(count, np.bool_), np.empty((5, count))
    for k in range(count):
        at, me = (log_rows[k], min(max(now[k], 0), last)), rows[k]
        known[k] = 0 <= now[k] <= last and log_valid[at]
        off[0, k], off[1, k] = log_x[at], log_y[at]
        off[2, k] = math.hypot(x[me] - log_x[at], y[me] - log_y[at])
        off[3, k] = speed[me] - log_speed[at]
        off[4, k] = wrapped(yaw[me] - log_yaw[at])
    return known, off


def nobody_is_excused(_: int, __: int) -> bool:
    """The :data:`Excuse` of a log without overlaps."""
    return False


def obstructed(
    off: OffLog,
    at: IntArray,
    table: AgentTable,
    rows: IntArray,
    residuals: Residuals,
    excuse: Excuse = nobody_is_excused,
) -> BoolArray:
    """Whether other agents block the way to the place in the log, except for those that overlap it in the log itself.

    Args:
        off: agents off their logs.
        at: (k,) positions of the agents in `off`.
        table: all agents.
        rows: (r,) of the agents of `off` in `table`.
        residuals: of the agents of `off`.
        excuse: for agents that overlap in the log itself.

    Returns:
        mask (k,).
    """
    if not len(at):
        return np.zeros(0, np.bool_)
    paths, rows = off.logged_paths, rows[at]
    place = paths.project(at, residuals.x[at], residuals.y[at])
    sight = OBSTACLE_SIGHT + 2.0 * residuals.position[at]
    view = along_paths(paths, table, rows, sight=sight, path=at)
    to_place = place.s - view.own_s
    between = view.ahead & view.in_path & (view.gap < to_place[:, None])
    for k, column, row in view.pairs(between):
        between[k, column] = not excuse(int(rows[k]), row)
    return np.asarray(between.any(axis=1))


def review(
    config: TakeoverConfig,
    off: OffLog,
    table: AgentTable,
    rows: IntArray,
    residuals: Residuals,
    in_conflict: BoolArray,
    excuse: Excuse = nobody_is_excused,
    unneeded: BoolArray | None = None,
) -> None:
    """Move agents that were off their logs before this step on to their next states, in place.

    An agent in conflict, obstructed or without a log is HELD. One that has been free for long enough is handed back
    along its logged path, and released as soon as the residuals allow it. An unneeded agent is released.

    Args:
        config: when that is.
        off: r agents.
        table: all agents.
        rows: (r,) of the agents in `table`.
        residuals: of the agents.
        in_conflict: (r,) whether its log leads into a conflict.
        excuse: for agents that overlap in the log itself.
        unneeded: (r,) whether its log is over and no nearby agent needs it; None for none.
    """
    off.in_conflict[:] = in_conflict
    free = residuals.known & ~in_conflict
    at = free.nonzero()[0]
    free[at] = ~obstructed(off, at, table, rows, residuals, excuse)
    s = off.paths.project(off.paths.each, table.x[rows], table.y[rows]).s
    _move_on(
        off.state,
        off.clear,
        free,
        s >= off.goal_s,
        table.step - off.detected_step,
        residuals.position,
        residuals.speed,
        residuals.yaw,
        np.zeros(len(off), np.bool_) if unneeded is None else unneeded,
        config.clear_steps,
        config.held_steps_min,
        config.release_position,
        config.release_speed,
        config.release_yaw,
    )
    off.return_to_log(off.state == HANDBACK)


@kernel(void(OUT_BYTES, OUT_INTS, BOOLS, BOOLS, INTS, *[FLOATS] * 3, BOOLS, int64, int64, *[float64] * 3))
def _move_on(  # noqa: PLR0917 - a kernel takes arrays and numbers
    state: ByteArray,
    clear: IntArray,
    free: BoolArray,
    passed: BoolArray,
    since: IntArray,
    position: FloatArray,
    speed: FloatArray,
    yaw: FloatArray,
    unneeded: BoolArray,
    clear_steps: int,
    held_steps_min: int,
    release_position: float,
    release_speed: float,
    release_yaw: float,
) -> None:
    """Update the state of r agents and their numbers of free steps, in place; see :func:`review`.

    Args:
        state, clear: (r,) of :class:`.off_log.OffLog`.
        free: (r,) whether it is in no conflict, is not obstructed and has a log.
        passed: (r,) whether it is past its goal.
        since: (r,) steps since it was taken over.
        position, speed, yaw: (r,) of :class:`Residuals`.
        unneeded: (r,) whether no agent needs it.
        clear_steps, held_steps_min, release_position, release_speed, release_yaw: as in `TakeoverConfig`.
    """
    for k in range(len(state)):
        clear[k] = clear[k] + 1 if free[k] else 0
        needed = clear_steps if passed[k] else 2 * clear_steps
        stays = state[k] == HELD and not (clear[k] >= needed and since[k] >= held_steps_min)
        near = position[k] <= release_position and abs(speed[k]) <= release_speed and abs(yaw[k]) <= release_yaw
        if not free[k] or stays:
            state[k] = HELD
        elif near and state[k] != HELD:
            state[k] = RELEASED
        else:
            state[k] = HANDBACK
        if unneeded[k] and since[k] >= held_steps_min:
            state[k] = RELEASED
