"""The log: recorded motion of the agents of a scenario, as dense arrays."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import (
    ARRAY_FIELDS,
    DTYPES,
    STEP_S,
    AgentTable,
    BoolArray,
    ByteArray,
    Controller,
    FloatArray,
    IntArray,
    is_obstacle,
)
from litsim_sim.core.steps import StackedTable, Steps
from litsim_sim.kernels.compiled import BOOLS2, FLOATS, FLOATS2, INTS, OUT_INTS, int64, kernel
from litsim_sim.scenario.recording import Recording

REPLAYS = 4
"""Number of cached replays of a log: most runs of a scenario end with it, a few earlier."""
LOG = int(Controller.LOG)
LAG_TOLERANCE = 0.2  # [m] difference in distance up to which two places count as equally near


@dataclass(frozen=True)
class Log:
    """Recorded motion over the steps of a scenario; n agents, zeros where an agent is not on the road.

    Attributes:
        ids: (n,) ascending.
        kind: (n,) :class:`litsim_sim.core.scene.Kind`.
        length, width: (n,) of the boxes [m].
        first_step, last_step: (n,) first and last step at which an agent is on the road.
        valid: (n, steps) mask of agents on the road.
        x, y: (n, steps) box centres in frame map [m].
        yaw: (n, steps) heading, counter-clockwise from +x, in [-pi, pi) [rad].
        speed, acceleration: (n, steps) along the heading, as recorded [m/s], [m/s2].
        yaw_rate: (n, steps) change of heading since the step before (at an agent's first step: to the next) [rad/s].
    """

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
        """Returns the log of `steps` steps from `start_frame`, with the agents that appear in them."""
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
        """(n,) mask of pedestrians and cyclists, which are never off their log; see :func:`is_obstacle`."""
        return is_obstacle(self.kind)

    @property
    def steps(self) -> int:
        """Number of steps that the log covers, step 0 included."""
        return self.valid.shape[1]

    @cached_property
    def paths(self) -> dict[Hashable, Any]:
        """Cache of paths derived from the log, shared by all runs in this process; keyed by what defines them."""
        return {}

    def recorded(self, agent: int) -> tuple[Log, int]:
        """Returns the log of the scene of `agent`, which is this log, and its id there."""
        return self, agent

    def row(self, agent: int) -> int:
        """Returns the row of `agent`; -1 if the log lacks it."""
        at = int(np.searchsorted(self.ids, agent))
        return at if at < len(self.ids) and self.ids[at] == agent else -1

    def table(self, step: int, lag: IntArray | None = None) -> AgentTable:
        """Returns all agents on the road at `step`, controller LOG, as arrays of their own; empty outside of the steps.

        Args:
            step: integer step of the scenario.
            lag: (n,) lag of the replay of each agent [steps]; None for no lag.
        """
        at = np.full(len(self.ids), step) if lag is None else step - lag
        rows = _on_road(self.valid, at)
        now = rows * self.steps + at[rows]  # in the flat columns: an index in two dimensions takes ten times as long
        return AgentTable(
            step=step,
            id=self.ids.take(rows),
            kind=self.kind.take(rows),
            controller=np.full(len(rows), LOG, np.uint8),
            x=self.x.take(now),
            y=self.y.take(now),
            yaw=self.yaw.take(now),
            speed=self.speed.take(now),
            acceleration=self.acceleration.take(now),
            yaw_rate=self.yaw_rate.take(now),
            length=self.length.take(rows),
            width=self.width.take(rows),
        )

    def replay(self, last: int) -> Steps:
        """Returns the tables of the steps 0 to `last`; the same object for every call as long as it is cached.

        The last :data:`REPLAYS` distinct values of `last` are cached, with all results computed from their tables.
        """
        cache = self._replays
        steps = cache.pop(last, None) or Steps(self.table(step) for step in range(last + 1))
        cache[last] = steps
        if len(cache) > REPLAYS:
            del cache[next(iter(cache))]
        return steps

    @cached_property
    def _replays(self) -> dict[int, Steps]:
        """Cached replays by last step, the most recently used at the end."""
        return {}

    def lags(self, rows: IntArray, step: int, x: FloatArray, y: FloatArray) -> IntArray:
        """Returns lags (r,) [steps] at which the logs of the agents in `rows` (r,) are nearest to `x`, `y` (r,) [m].

        A lag is 0 if the agent has no logged pose up to `step`. Of ties it is the smallest: a log that stands is near
        for a long time, and the agent does not wait again.
        """
        return _lags(self.x, self.y, self.valid, rows, step, x, y)


def logged_steps(recording: Recording, start_frame: int, wanted: IntArray) -> Steps:
    """Returns the tables of :meth:`Log.table` for the steps `wanted` (S,), ascending, in memory of their rows alone.

    A column of the recording is let go of once it is used, if the caller does not hold it.
    """
    table = dict(recording.columns)
    del recording
    step = table.pop("frame") - start_frame
    if not (inside := (step >= 0) & (step <= max(wanted.tolist(), default=-1))).all():
        table, step = {name: values[inside] for name, values in table.items()}, step[inside]
    id_ = table.pop("vehicle_id")
    _, first, agent = np.unique(id_, return_index=True, return_inverse=True)
    number = np.searchsorted(wanted, step)
    rows = np.flatnonzero(wanted[np.minimum(number, len(wanted) - 1)] == step) if len(wanted) else np.empty(0, np.int64)
    rows = rows[np.lexsort((id_[rows], number[rows]))]
    number = number[rows]
    own = {"id": id_[rows], "yaw_rate": _yaw_rates(agent, step, table["yaw"])[rows]}
    del id_, step
    own |= {name: table.pop(name)[first][agent[rows]] for name in ("kind", "length", "width")}
    del agent
    own["yaw"] = wrap_angle(table.pop("yaw")[rows])
    own |= {name: table.pop(name)[rows] for name in ("x", "y", "speed", "acceleration")}
    own["controller"] = np.full(len(rows), LOG)
    own = {name: np.asarray(own.pop(name), DTYPES[name]) for name in ARRAY_FIELDS}
    begin = number.searchsorted(np.arange(len(wanted) + 1))
    return Steps.split(wanted, begin, StackedTable(int(wanted[0]) if len(wanted) else 0, **own, scene=number))


def _yaw_rates(agent: IntArray, step: IntArray, yaw: FloatArray) -> FloatArray:
    """Returns yaw rates (m,) [rad/s] at each row of the tracks of agents: since the step before; at first, to the next.

    It is 0 where a track has no such step.
    """
    order = np.lexsort((step, agent))
    follows = (np.diff(agent[order]) == 0) & (np.diff(step[order]) == 1)
    rate = np.zeros(len(order))
    rate[1:] = np.where(follows, wrap_angle(np.diff(yaw[order])) / STEP_S, 0.0)
    begins = np.flatnonzero(np.diff(agent[order], prepend=-1))
    continued = begins[begins + 1 < len(order)]
    continued = continued[follows[continued]]
    rate[continued] = rate[continued + 1]
    yaw_rate = np.empty(len(order))
    yaw_rate[order] = rate
    return yaw_rate


@kernel(OUT_INTS(FLOATS2, FLOATS2, BOOLS2, INTS, int64, FLOATS, FLOATS))
def _lags(
    log_x: FloatArray, log_y: FloatArray, valid: BoolArray, rows: IntArray, step: int, x: FloatArray, y: FloatArray
) -> IntArray:
    """See :meth:`Log.lags`; `x`, `y` and `valid` of the log are (n, steps)."""
    lags = np.zeros(len(rows), np.int64)
    for k, row in enumerate(rows):
        until, least = min(step + 1, log_x.shape[1]), np.inf
        for t in range(until):
            if valid[row, t]:
                least = min(least, (log_x[row, t] - x[k]) ** 2 + (log_y[row, t] - y[k]) ** 2)
        near = (math.sqrt(least) + LAG_TOLERANCE) ** 2
        for t in range(until - 1, -1, -1):
            if valid[row, t] and (log_x[row, t] - x[k]) ** 2 + (log_y[row, t] - y[k]) ** 2 <= near:
                lags[k] = step - t
                break
    return lags


@kernel(OUT_INTS(BOOLS2, INTS))
def _on_road(valid: BoolArray, at: IntArray) -> IntArray:
    """Returns the rows of the agents that are on the road, by `valid` (n, steps), at their steps `at` (n,)."""
    rows, count = np.empty(len(at), np.int64), 0
    for i in range(len(at)):
        if 0 <= at[i] < valid.shape[1] and valid[i, at[i]]:
            rows[count] = i
            count += 1
    return rows[:count].copy()
