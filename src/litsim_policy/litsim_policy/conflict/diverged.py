"""The agents off their logs as a table: why and since when, on which path, in which state, and how far from the log."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import types

from litsim_policy.conflict.detector import Conflict
from litsim_policy.motion.lane_lines import NO_LANE
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.pair_geometry import wrapped
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, ByteArray, FloatArray, IntArray
from litsim_sim.core.takeover import PathSource, Takeover, TakeoverReason, TakeoverState
from litsim_sim.kernels.compiled import BOOLS2, FLOATS, FLOATS2, INTS, OUT_BOOLS, OUT_FLOATS2, kernel
from litsim_sim.scenario.log import Log

ObjectArray = npt.NDArray[Any]
LOGGED = int(PathSource.LOGGED)
HELD, HANDBACK, RELEASED = int(TakeoverState.HELD), int(TakeoverState.HANDBACK), int(TakeoverState.RELEASED)
LAID_OUT = ("paths", "logged_paths")  # fields of a table that are made on first use, and kept
STATES, REASONS, SOURCES = tuple(TakeoverState), tuple(TakeoverReason), tuple(PathSource)  # numbered from 0 on


@dataclass(eq=False)
class DivergedAgents:
    """r agents off their logs, ids ascending; arrays (r,) unless stated otherwise.

    States, counts and paths change from step to step, in place (:meth:`return_to_log`); a change of the set of agents
    makes another table.

    Attributes:
        agent, opponent: ids.
        state: :class:`TakeoverState`.
        reason: :class:`TakeoverReason`.
        detected_step: at which the agent was taken over.
        time_to_conflict: from then on [s].
        overlap_probability: largest within the horizon, then.
        pose: (r, 3) x, y [m], yaw [rad] of the agent at the predicted overlap: its goal.
        in_conflict: whether its log leads into a conflict at this step.
        clear: steps in a row without conflict.
        path: :class:`ReferencePath` that it follows: to its goal and beyond while HELD, later `logged`.
        logged: :class:`ReferencePath` of its log.
        source: :class:`PathSource` of `path`.
        goal_s: arc length of the goal on `path` [m].
        slowed: steps in a row for which it has been slower than its log.
        beside: row in `LaneMap.lanes` of the lane that it has taken to pass; NO_LANE for none.
        changed_step: of its last lane change; -1 for none.
    """

    agent: IntArray
    opponent: IntArray
    state: ByteArray
    reason: ByteArray
    detected_step: IntArray
    time_to_conflict: FloatArray
    overlap_probability: FloatArray
    pose: FloatArray
    in_conflict: BoolArray
    clear: IntArray
    path: ObjectArray
    logged: ObjectArray
    source: ByteArray
    goal_s: FloatArray
    slowed: IntArray
    beside: IntArray
    changed_step: IntArray

    def __len__(self) -> int:
        return len(self.agent)

    @classmethod
    def empty(cls) -> DivergedAgents:
        """Return an empty table."""
        whole, real, byte = np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint8)
        flags, paths = np.empty(0, np.bool_), np.empty(0, object)
        poses, passing = np.empty((0, 3)), (whole, whole, whole)
        return cls(whole, whole, byte, byte, whole, real, real, poses, flags, whole, paths, paths, byte, real, *passing)

    @classmethod
    def opened(
        cls,
        conflict: Conflict,
        step: int,
        reason: TakeoverReason,
        path: ReferencePath,
        source: PathSource,
        logged: ReferencePath,
    ) -> DivergedAgents:
        """Return the table of one agent that is taken over at `step`."""
        goal_s, _ = path.project(conflict.pose[:1], conflict.pose[1:2])
        paths, recorded = np.empty(1, object), np.empty(1, object)
        paths[0], recorded[0] = path, logged
        return cls(
            agent=np.array([conflict.agent]),
            opponent=np.array([conflict.opponent]),
            state=np.array([TakeoverState.HELD], np.uint8),
            reason=np.array([reason], np.uint8),
            detected_step=np.array([step]),
            time_to_conflict=np.array([conflict.time_to_conflict]),
            overlap_probability=np.array([conflict.overlap_probability]),
            pose=conflict.pose[None],
            in_conflict=np.array([True]),
            clear=np.array([0]),
            path=paths,
            logged=recorded,
            source=np.array([source], np.uint8),
            goal_s=goal_s,
            slowed=np.array([0]),
            beside=np.array([NO_LANE]),
            changed_step=np.array([-1]),
        )

    def kept(self, which: BoolArray) -> DivergedAgents:
        """The agents in the mask `which` (r,)."""
        if which.all():
            return self
        at = which.nonzero()[0]
        agents = DivergedAgents(*(getattr(self, field.name)[at] for field in fields(self)))
        agents.__dict__.update({name: self.__dict__[name].take(at) for name in LAID_OUT if name in self.__dict__})
        return agents

    def joined(self, *others: DivergedAgents) -> DivergedAgents:
        """All these tables in one; no agent is in two of them."""
        tables = (self, *others)
        order = np.argsort(np.concatenate([table.agent for table in tables]), kind="stable")
        columns = (np.concatenate([getattr(table, f.name) for table in tables]) for f in fields(self))
        return DivergedAgents(*(column[order] for column in columns))

    @cached_property
    def paths(self) -> PathBatch:
        """The paths that the agents follow."""
        return PathBatch([path.points for path in self.path])

    @cached_property
    def logged_paths(self) -> PathBatch:
        """The paths of the agents in the recording."""
        return PathBatch([path.points for path in self.logged])

    def return_to_log(self, which: BoolArray) -> None:
        """Let the agents in the mask `which` (r,) follow their logged paths from now on."""
        at = (which & (self.source != LOGGED)).nonzero()[0]
        if len(at):
            self.beside[at] = NO_LANE
            self.path[at], self.source[at] = self.logged[at], PathSource.LOGGED
            self.goal_s[at] = self.logged_paths.project(at, self.pose[at, 0], self.pose[at, 1]).s
            self.__dict__.pop("paths", None)

    def pass_along(self, at: int, path: ReferencePath, lane: int, step: int) -> None:
        """Let the agent at position `at` follow `path` into `lane`, a row in `LaneMap.lanes`, from `step` on."""
        self.path[at], self.source[at], self.state[at] = path, PathSource.LANE, TakeoverState.HELD
        self.beside[at], self.changed_step[at], self.slowed[at], self.clear[at] = lane, step, 0, 0
        self.goal_s[at] = path.project(self.pose[at, :1], self.pose[at, 1:2])[0][0]
        self.__dict__.pop("paths", None)

    def give_up(self, at: IntArray, step: int) -> None:
        """Let the agents at positions `at` (k,), which have begun to change lane, follow their logged paths again."""
        if len(at):
            self.path[at], self.source[at], self.changed_step[at] = self.logged[at], PathSource.LOGGED, step
            self.beside[at], self.slowed[at] = NO_LANE, 0
            self.goal_s[at] = self.logged_paths.project(at, self.pose[at, 0], self.pose[at, 1]).s
            self.__dict__.pop("paths", None)

    def report(
        self, x: FloatArray, y: FloatArray, residuals: tuple[FloatArray, FloatArray], lag: IntArray
    ) -> tuple[Takeover, ...]:
        """The takeovers to publish at a step, one per agent.

        Args:
            x, y: (r,) of the agents now, frame map [m]; their reference paths begin a little behind.
            residuals: (r,) of position and speed [m], [m/s]; see :attr:`Residuals.reported`.
            lag: (r,) steps by which the log to which each agent returns lags.
        """
        if not len(self):
            return ()
        begin, end = self.paths.window(self.paths.project(self.paths.each, x, y).s)
        poses = [(px, py, yaw) for px, py, yaw in self.pose.tolist()]
        columns: dict[str, list[Any]] = {
            "agent": self.agent.tolist(),
            "opponent": self.opponent.tolist(),
            "state": [STATES[state] for state in self.state.tolist()],
            "reason": [REASONS[reason] for reason in self.reason.tolist()],
            "detected_step": self.detected_step.tolist(),
            "time_to_conflict": self.time_to_conflict.tolist(),
            "overlap_probability": self.overlap_probability.tolist(),
            "conflict_pose": poses,
            "goal_pose": poses,
            "reference_path": [
                path.points[first:last]
                for path, first, last in zip(self.path, begin.tolist(), end.tolist(), strict=True)
            ],
            "log_collision_predicted": self.in_conflict.tolist(),
            "residual_position": residuals[0].tolist(),
            "residual_speed": residuals[1].tolist(),
            "path_source": [SOURCES[source] for source in self.source.tolist()],
            "time_shift": [steps * STEP_S for steps in lag.tolist()],
        }
        return tuple(Takeover(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True))


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
        recorded, now = (log.valid, log.x, log.y, log.yaw, log.speed), (table.x, table.y, table.yaw, table.speed)
        known, differences = _residuals(recorded, log_rows, table.step - lag, rows, now)
        return cls(known, *differences)

    @property
    def reported(self) -> tuple[FloatArray, FloatArray]:
        """Residuals (r,) of position [m] and speed [m/s] as published; -1 and 0 of agents that are not `known`."""
        return np.where(self.known, self.position, -1.0), np.where(self.known, self.speed, 0.0)

    def kept(self, which: BoolArray) -> Residuals:
        """The residuals of the agents in the mask `which` (r,)."""
        return self if which.all() else Residuals(*(getattr(self, field.name)[which] for field in fields(self)))


@kernel(
    types.Tuple((OUT_BOOLS, OUT_FLOATS2))(
        types.Tuple((BOOLS2, *[FLOATS2] * 4)), INTS, INTS, INTS, types.UniTuple(FLOATS, 4)
    )
)
def _residuals(
    log: tuple[BoolArray, FloatArray, FloatArray, FloatArray, FloatArray],
    log_rows: IntArray,
    now: IntArray,
    rows: IntArray,
    agents: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> tuple[BoolArray, FloatArray]:
    """Return the first field of :class:`Residuals` (r,), and the others (5, r).

    Args:
        log: validity, x, y [m], yaw [rad] and speed [m/s] (N, S).
        log_rows: (r,) of the agents in it.
        now: (r,) present step of each agent's log.
        rows: (r,) of the agents in the table.
        agents: x, y, yaw and speed (n,) of the table.
    """
    log_valid, log_x, log_y, log_yaw, log_speed = log
    x, y, yaw, speed = agents
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
