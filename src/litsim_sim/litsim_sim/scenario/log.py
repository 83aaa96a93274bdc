"""The log: what every agent of a scenario really did, as dense arrays."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numba.types import UniTuple

from litsim_sim.core.compiled import BOOLS2, FLOATS, FLOATS2, INTS, OUT_FLOATS, OUT_INTS, int64, kernel
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import (
    STEP_S,
    AgentTable,
    BoolArray,
    ByteArray,
    Controller,
    FloatArray,
    IntArray,
    is_obstacle,
)
from litsim_sim.core.steps import Steps
from litsim_sim.recordings.recording import Recording

REPLAYS = 4
"""Kept replays of a log: most runs of a scenario end with it, a few before."""
LOG = int(Controller.LOG)
LAG_TOLERANCE = 0.2  # [m] by which one place may be farther than another and yet count as near


@dataclass(frozen=True)
class Log:
    """Recorded motion over the steps of a scenario; n agents, zeros where an agent is not on the road.

    Attributes:
        ids: (n,) ascending.
        kind: (n,) :class:`litsim_sim.core.scene.Kind`.
        length, width: (n,) of the boxes [m].
        first_step, last_step: (n,) between which, both included, an agent is on the road.
        valid: (n, steps) mask of that.
        x, y: (n, steps) box centres in frame map [m].
        yaw: (n, steps) heading, counter-clockwise from +x, in [-pi, pi) [rad].
        speed, acceleration: (n, steps) along the heading, as recorded [m/s], [m/s2].
        yaw_rate: (n, steps) change of heading since the step before (at an agent's first step: to the next) [rad/s].
    """

    table_type: ClassVar[type[AgentTable]] = AgentTable
    """Class of the tables that it makes."""

    ids: IntArray
    kind: ByteArray
    length: FloatArray
    width: FloatArray
    first_step: IntArray
    last_step: IntArray
    valid: BoolArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    yaw_rate: FloatArray

    @classmethod
    def from_recording(cls, recording: Recording, start_frame: int, steps: int) -> Log:
        """The log of `steps` steps from `start_frame`, of the agents that appear in them."""
        step = recording.columns["frame"] - start_frame
        inside = (step >= 0) & (step < steps)
        table, step = recording.take(inside).columns, step[inside]
        ids, first_row, agent = np.unique(table["vehicle_id"], return_index=True, return_inverse=True)
        valid = np.zeros((len(ids), steps), np.bool_)
        valid[agent, step] = True

        def dense(column: str) -> FloatArray:
            values = np.zeros(valid.shape)
            values[agent, step] = table[column]
            return values

        yaw = dense("yaw")
        rate = np.zeros(valid.shape)
        both = valid[:, 1:] & valid[:, :-1]
        rate[:, 1:] = np.where(both, wrap_angle(yaw[:, 1:] - yaw[:, :-1]) / STEP_S, 0.0)
        first_step = np.argmax(valid, axis=1)
        rows = np.arange(len(ids))
        last_step = first_step + valid.sum(axis=1) - 1  # recordings have no holes
        rate[rows, first_step] = np.where(
            last_step > first_step, rate[rows, np.minimum(first_step + 1, steps - 1)], 0.0
        )
        return cls(
            ids=ids,
            kind=table["kind"][first_row],
            length=table["length"][first_row],
            width=table["width"][first_row],
            first_step=first_step,
            last_step=last_step,
            valid=valid,
            x=dense("x"),
            y=dense("y"),
            yaw=np.where(valid, wrap_angle(yaw), 0.0),
            speed=dense("speed"),
            acceleration=dense("acceleration"),
            yaw_rate=rate,
        )

    @property
    def obstacle(self) -> BoolArray:
        """(n,) pedestrians and cyclists, who are never off their log; see :func:`is_obstacle`."""
        return is_obstacle(self.kind)

    @property
    def steps(self) -> int:
        """Number of steps that the log covers, step 0 included."""
        return self.valid.shape[1]

    @cached_property
    def paths(self) -> dict[Hashable, Any]:
        """Paths that others have made of it, kept for all runs of it in this process; by what they were made of."""
        return {}

    def recorded(self, agent: int) -> tuple[Log, int]:
        """The log of the scenario that `agent` is in, and its id there: this one."""
        return self, agent

    def row(self, agent: int) -> int:
        """Row of `agent`, or -1 where the log has no such agent."""
        at = int(np.searchsorted(self.ids, agent))
        return at if at < len(self.ids) and self.ids[at] == agent else -1

    def table(self, step: int, lag: IntArray | None = None) -> AgentTable:
        """All agents on the road at `step`, controller LOG, as arrays of their own; empty outside of the steps.

        Args:
            step: integer step of the scenario.
            lag: (n,) steps by which the replay of each log lags; None is not at all.
        """
        at = np.full(len(self.ids), step) if lag is None else step - lag
        rows = _on_road(self.valid, at)
        x, y, yaw, speed, acceleration, yaw_rate = _logged(
            self.x, self.y, self.yaw, self.speed, self.acceleration, self.yaw_rate, rows, at
        )
        return self.table_type(
            step=step,
            id=self.ids.take(rows),
            kind=self.kind.take(rows),
            controller=np.full(len(rows), LOG, np.uint8),
            x=x,
            y=y,
            yaw=yaw,
            speed=speed,
            acceleration=acceleration,
            yaw_rate=yaw_rate,
            length=self.length.take(rows),
            width=self.width.take(rows),
        )

    def replay(self, last: int) -> Steps:
        """The tables of the steps 0 .. `last`: the same object for all runs that end there, for as long as it is kept.

        Kept are those of the last :data:`REPLAYS` ends that were asked for, and what was made of them.
        """
        kept = self._replays
        found = kept.pop(last, None) or Steps(self.table(step) for step in range(last + 1))
        kept[last] = found
        if len(kept) > REPLAYS:
            del kept[next(iter(kept))]
        return found

    @cached_property
    def _replays(self) -> dict[int, Steps]:
        """By their last steps, those that were asked for last at the end."""
        return {}

    def lag(self, row: int, step: int, x: float, y: float) -> int:
        """Steps ago at which the agent in `row` was logged nearest to (x, y) [m]; of places as near, the latest.

        0 where that is now, or where the agent has no logged pose up to `step`. A log that stands and waits is near
        for long: the time that it waited is not waited again.
        """
        return int(self.lags(np.array([row]), step, np.array([x]), np.array([y]))[0])

    def lags(self, rows: IntArray, step: int, x: FloatArray, y: FloatArray) -> IntArray:
        """(r,) lags as :meth:`lag` defines them, of the agents in `rows` (r,) that are at `x`, `y` (r,) [m]."""
        return _lags(self.x, self.y, self.valid, rows, step, x, y)


@kernel(OUT_INTS(FLOATS2, FLOATS2, BOOLS2, INTS, int64, FLOATS, FLOATS))
def _lags(
    log_x: FloatArray, log_y: FloatArray, valid: BoolArray, rows: IntArray, step: int, x: FloatArray, y: FloatArray
) -> IntArray:
    """Return what :meth:`Log.lags` does, of the poses and the mask (n, steps) of the log."""
    found = np.zeros(len(rows), np.int64)
    for k, row in enumerate(rows):
        until, least = min(step + 1, log_x.shape[1]), np.inf
        for t in range(until):
            if valid[row, t]:
                least = min(least, (log_x[row, t] - x[k]) ** 2 + (log_y[row, t] - y[k]) ** 2)
        near = (math.sqrt(least) + LAG_TOLERANCE) ** 2
        for t in range(until - 1, -1, -1):
            if valid[row, t] and (log_x[row, t] - x[k]) ** 2 + (log_y[row, t] - y[k]) ** 2 <= near:
                found[k] = step - t
                break
    return found


@kernel(OUT_INTS(BOOLS2, INTS))
def _on_road(valid: BoolArray, at: IntArray) -> IntArray:
    """Rows of the agents whose log, `valid` (n, steps), has them on the road at their steps `at` (n,)."""
    rows, count = np.empty(len(at), np.int64), 0
    for i in range(len(at)):
        if 0 <= at[i] < valid.shape[1] and valid[i, at[i]]:
            rows[count] = i
            count += 1
    return rows[:count].copy()


@kernel(UniTuple(OUT_FLOATS, 6)(*[FLOATS2] * 6, INTS, INTS))
def _logged(
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    yaw_rate: FloatArray,
    rows: IntArray,
    at: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The six logs (n, steps), in the same order, of the agents in `rows` (m,) at their steps, of `at` (n,)."""
    m = len(rows)
    found = (np.empty(m), np.empty(m), np.empty(m), np.empty(m), np.empty(m), np.empty(m))
    for k in range(m):
        i = rows[k]
        now = at[i]
        found[0][k], found[1][k], found[2][k] = x[i, now], y[i, now], yaw[i, now]
        found[3][k], found[4][k], found[5][k] = speed[i, now], acceleration[i, now], yaw_rate[i, now]
    return found
