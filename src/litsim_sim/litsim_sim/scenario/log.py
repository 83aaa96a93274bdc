"""The log: recorded motion of the agents of a scenario, as dense arrays."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, fields
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
from litsim_sim.core.steps import StackedTable, Steps, StepsBuilder
from litsim_sim.kernels.compiled import Bools2, Floats, Floats2, Ints, kernel
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
        table = recording.take(inside).columns
        return cls._of_columns(table, table["vehicle_id"], step[inside], steps)

    @classmethod
    def from_rows(cls, table: StackedTable, steps: int) -> Log:
        """Returns the motion in the rows of `table`, also of a run, over `steps` tables; tracks may have holes."""
        columns = {name: getattr(table, name) for name in ARRAY_FIELDS}
        return cls._of_columns(columns, table.id, table.number, steps)

    @classmethod
    def _of_columns(cls, columns: Mapping[str, np.ndarray], agents: IntArray, step: IntArray, steps: int) -> Log:
        """Returns the log of `steps` steps whose states are in `columns`, of `agents` (m,) at each `step` (m,)."""
        ids, first_row, agent = np.unique(agents, return_index=True, return_inverse=True)
        valid = np.zeros((len(ids), steps), np.bool_)
        valid[agent, step] = True

        def dense(column: FloatArray) -> FloatArray:
            values = np.zeros(valid.shape)
            values[agent, step] = column
            return values

        return cls(
            ids=ids,
            kind=columns["kind"][first_row],
            length=columns["length"][first_row],
            width=columns["width"][first_row],
            first_step=np.argmax(valid, axis=1),
            last_step=steps - 1 - np.argmax(valid[:, ::-1], axis=1),
            valid=valid,
            x=dense(columns["x"]),
            y=dense(columns["y"]),
            yaw=dense(wrap_angle(columns["yaw"])),
            speed=dense(columns["speed"]),
            acceleration=dense(columns["acceleration"]),
            yaw_rate=dense(_yaw_rates(agent, step, columns["yaw"])),
        )

    @property
    def obstacle(self) -> BoolArray:
        """(n,) mask of pedestrians and cyclists; see :func:`is_obstacle`."""
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
        place = int(np.searchsorted(self.ids, agent))
        return place if place < len(self.ids) and self.ids[place] == agent else -1

    def take(self, rows: BoolArray) -> Log:
        """Returns the log of the agents in the mask `rows` (n,)."""
        return Log(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def table(self, step: int, lag: IntArray | None = None) -> AgentTable:
        """Returns all agents on the road at `step`, controller LOG, as arrays of their own; empty outside of the steps.

        `lag` (n,) is that of the replay of each agent [steps]; None for no lag.
        """
        own = np.full(len(self.ids), step) if lag is None else step - lag
        rows = _on_road(self.valid, own)
        now = rows * self.steps + own[rows]  # in the flat columns: an index in two dimensions takes ten times as long
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


def logged_steps(parts: Iterable[Mapping[str, np.ndarray]], start_frame: int, wanted: IntArray) -> Steps:
    """Returns the tables of :meth:`Log.table` for the steps `wanted` (S,), ascending; long ones are in a file.

    `parts` are columns of a recording, one part after the other; sorted by frame and vehicle.
    """
    builder, last = StepsBuilder(), int(wanted[-1]) if len(wanted) else -1
    first: dict[int, tuple[Any, ...]] = {}  # kind, length and width in the first row of each agent
    rows: dict[str, np.ndarray] = {}
    done = -1  # step up to which the tables are built

    def build(until: int) -> None:
        """Builds the tables up to step `until`, for which the rows up to the next step are known."""
        nonlocal done
        agents, agent = np.unique(rows["vehicle_id"], return_inverse=True)
        sizes = np.array([first[number] for number in agents.tolist()]).reshape(-1, 3)[agent]
        columns = {name: rows[name] for name in ("x", "y", "speed", "acceleration")}
        columns |= dict(zip(("kind", "length", "width"), sizes.T, strict=True))
        columns |= {"id": rows["vehicle_id"], "controller": np.full(len(agent), LOG)}
        columns |= {"yaw": wrap_angle(rows["yaw"]), "yaw_rate": _yaw_rates(agent, rows["step"], rows["yaw"])}
        for step in wanted[(wanted > done) & (wanted <= until)].tolist():
            own = slice(*rows["step"].searchsorted([step, step + 1]))
            builder.add(AgentTable(step, *(np.asarray(columns[name][own], DTYPES[name]) for name in ARRAY_FIELDS)))
        done = until

    for part in parts:
        step = part["frame"] - start_frame
        inside = (step >= 0) & (step <= last)
        new = {name: values[inside] for name, values in (dict(part) | {"step": step}).items()}
        agents, earliest = np.unique(new["vehicle_id"], return_index=True)
        sizes = zip(*(new[name][earliest].tolist() for name in ("kind", "length", "width")), strict=True)
        first = dict(zip(agents.tolist(), sizes, strict=True)) | first
        recent = rows["step"] >= done if rows else None  # a step before those to build tells yaw rates
        rows = {name: np.concatenate([rows[name][recent], new[name]]) if rows else new[name] for name in new}
        if len(rows["step"]):
            build(max(done, int(rows["step"][-1]) - 2))  # the last step may go on in the next part
    if rows:
        build(last)
    return builder.steps()


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


@kernel
def _lags(log_x: Floats2, log_y: Floats2, valid: Bools2, rows: Ints, step: int, x: Floats, y: Floats) -> Ints:
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


@kernel
def _on_road(valid: Bools2, steps: Ints) -> Ints:
    """Returns the rows of the agents that are on the road, by `valid` (n, steps), at their steps `at` (n,)."""
    rows, count = np.empty(len(steps), np.int64), 0
    for i in range(len(steps)):
        if 0 <= steps[i] < valid.shape[1] and valid[i, steps[i]]:
            rows[count] = i
            count += 1
    return rows[:count].copy()
