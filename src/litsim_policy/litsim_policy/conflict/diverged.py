"""The agents off their logs: why and since when, on which path and in which state; and how far from them at a step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from litsim_policy.motion.lane_lines import NO_LANE
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, ByteArray, FloatArray, IntArray
from litsim_sim.core.takeover import PathSource, Takeover, TakeoverReason, TakeoverState
from litsim_sim.kernels.compiled import Bools, Bools2, Floats2, Ints, kernel
from litsim_sim.scenario.log import Log

ObjectArray = npt.NDArray[Any]
LOGGED, LANE = int(PathSource.LOGGED), int(PathSource.LANE)
HELD, HANDBACK, RELEASED, OWN_INTENT = map(
    int, (TakeoverState.HELD, TakeoverState.HANDBACK, TakeoverState.RELEASED, TakeoverState.OWN_INTENT)
)
COLUMNS = tuple(column.name for column in fields(Takeover))
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
        steady: steps in a row of driving on steadily; negative: of driving into a conflict; see :mod:`.own_intent`.
        path: :class:`ReferencePath` that it follows: to its goal and beyond while HELD, later `logged`.
        logged: :class:`ReferencePath` of its log.
        source: :class:`PathSource` of `path`.
        goal_s: arc length of the goal on `path` [m].
        slowed: steps in a row for which it has been slower than its log.
        beside: row in `LaneMap.lanes` of the lane that it has taken to pass; NO_LANE for none.
        changed_step: of its last lane change; -1 for none.
        log_ratio: of its log at this step; see :mod:`.likelihood`.

    Args:
        laid_out: `paths` and `logged_paths` where they exist already; else None: they are made on first use.
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
    steady: IntArray
    path: ObjectArray
    logged: ObjectArray
    source: ByteArray
    goal_s: FloatArray
    slowed: IntArray
    beside: IntArray
    changed_step: IntArray
    log_ratio: FloatArray
    laid_out: InitVar[Sequence[PathBatch | None]] = field(default=(None, None), kw_only=True)

    def __post_init__(self, laid_out: Sequence[PathBatch | None]) -> None:
        self._paths, self._logged_paths = laid_out

    def __len__(self) -> int:
        return len(self.agent)

    @classmethod
    def empty(cls) -> DivergedAgents:
        """Return an empty table."""
        whole, real, byte = np.empty(0, np.int64), np.empty(0), np.empty(0, np.uint8)
        flags, paths = np.empty(0, np.bool_), np.empty(0, object)
        poses, passing = np.empty((0, 3)), (whole, whole, whole)
        state, rest = (
            (whole, whole, byte, byte, whole, real, real, poses),
            (flags, whole, whole, paths, paths, byte, real),
        )
        return cls(*state, *rest, *passing, real)

    @classmethod
    def opened(
        cls,
        agent: int,
        opponent: int,
        step: int,
        reason: TakeoverReason,
        goal: FloatArray,
        paths: tuple[ReferencePath, PathSource, ReferencePath],
        *,
        time_to_conflict: float = 0.0,
        overlap_probability: float = 0.0,
        in_conflict: bool = True,
    ) -> DivergedAgents:
        """Return the table of one agent that is taken over at `step`.

        It drives to `goal` (3,), x, y [m], yaw [rad]; `paths` are its path, the source of it, and the path of its log.
        """
        path, logged = np.empty(1, object), np.empty(1, object)
        path[0], source, logged[0] = paths
        return cls(
            agent=np.array([agent]),
            opponent=np.array([opponent]),
            state=np.array([TakeoverState.HELD], np.uint8),
            reason=np.array([reason], np.uint8),
            detected_step=np.array([step]),
            time_to_conflict=np.array([time_to_conflict]),
            overlap_probability=np.array([overlap_probability]),
            pose=goal[None],
            in_conflict=np.array([in_conflict]),
            clear=np.array([0]),
            steady=np.array([0]),
            path=path,
            logged=logged,
            source=np.array([source], np.uint8),
            goal_s=path[0].project(goal[:1], goal[1:2])[0],
            slowed=np.array([0]),
            beside=np.array([NO_LANE]),
            changed_step=np.array([-1]),
            log_ratio=np.array([0.0]),
        )

    def kept(self, which: BoolArray) -> DivergedAgents:
        """Returns the agents in the mask `which` (r,)."""
        if which.all():
            return self
        index = which.nonzero()[0]
        columns = (getattr(self, column.name)[index] for column in fields(self))
        laid_out = [batch and batch.take(index) for batch in (self._paths, self._logged_paths)]
        return DivergedAgents(*columns, laid_out=laid_out)

    def joined(self, *others: DivergedAgents) -> DivergedAgents:
        """Returns all these tables in one; no agent is in two of them."""
        tables = (self, *others)
        order = np.argsort(np.concatenate([table.agent for table in tables]), kind="stable")
        columns = (np.concatenate([getattr(table, f.name) for table in tables]) for f in fields(self))
        return DivergedAgents(*(column[order] for column in columns))

    @property
    def paths(self) -> PathBatch:
        """The paths that the agents follow."""
        if self._paths is None:
            self._paths = PathBatch.of([path.points for path in self.path])
        return self._paths

    def paths_of(self, index: IntArray) -> PathBatch:
        """Returns the paths of the agents at positions `index` (k,), ascending, without laying out those of others."""
        if len(index) == len(self):
            return self.paths
        if self._paths is not None:
            return self._paths.take(index)
        return PathBatch.of([path.points for path in self.path[index]])

    @property
    def logged_paths(self) -> PathBatch:
        """The paths of the agents in the recording."""
        if self._logged_paths is None:
            self._logged_paths = PathBatch.of([path.points for path in self.logged])
        return self._logged_paths

    def return_to_log(self, index: IntArray) -> None:
        """Let the agents at positions `index` (k,) follow their logged paths from now on."""
        index = index[self.source[index] != LOGGED]
        if len(index):
            self.beside[index] = NO_LANE
            self.path[index], self.source[index] = self.logged[index], PathSource.LOGGED
            self.goal_s[index] = self.logged_paths.project(index, self.pose[index, 0], self.pose[index, 1]).s
            self._paths = None

    def pass_along(self, index: int, path: ReferencePath, lane: int, step: int) -> None:
        """Let the agent at position `index` follow `path` into `lane`, a row in `LaneMap.lanes`, from `step` on."""
        self.path[index], self.source[index] = path, PathSource.LANE
        if self.state[index] == HANDBACK:
            self.state[index] = HELD
        self.beside[index], self.changed_step[index], self.slowed[index], self.clear[index] = lane, step, 0, 0
        self.goal_s[index] = path.project(self.pose[index, :1], self.pose[index, 1:2])[0][0]
        self._paths = None


@dataclass(frozen=True, eq=False)
class DivergedNow:
    """The agents off their logs at a step, and the places in their logs to which they would return; arrays (r,).

    Attributes:
        agents: the table of these r agents.
        table: all agents of the step.
        rows: of these agents in `table`.
        log: of all agents.
        log_rows: of these agents in `log`.
        lag: steps by which the log to which each agent returns lags.
        recorded: whether the log contains the agent at that time; otherwise it has no place there, and what follows is
            meaningless.
        log_x, log_y, log_yaw, log_speed: pose [m], [rad] and speed [m/s] of the log, lag included.
        x, y, yaw, speed: of the agents [m], [rad], [m/s].
    """

    agents: DivergedAgents
    table: AgentTable
    rows: IntArray
    log: Log
    log_rows: IntArray
    lag: IntArray
    recorded: BoolArray
    log_x: FloatArray
    log_y: FloatArray
    log_yaw: FloatArray
    log_speed: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    speed: FloatArray

    @classmethod
    def at(cls, log: Log, agents: DivergedAgents, table: AgentTable, lag: IntArray) -> DivergedNow:
        """Returns the `agents`, all of which are in `table`, at its step; logs lag by `lag` (n,) steps."""
        rows, log_rows = table.rows(agents.agent), log.ids.searchsorted(agents.agent)
        lags, of_log = lag[rows], (log.x, log.y, log.yaw, log.speed, log.valid)
        recorded, places = _places(of_log, log_rows, table.step - lags, table.arrays, rows)
        return cls(agents, table, rows, log, log_rows, lags, recorded, *places)

    @cached_property
    def residual_position(self) -> FloatArray:
        """Distance from the place in the log [m]."""
        return np.hypot(self.x - self.log_x, self.y - self.log_y)

    @cached_property
    def residual_speed(self) -> FloatArray:
        """Speed of the agent less that of the log [m/s]."""
        return self.speed - self.log_speed

    def report(self) -> tuple[Takeover, ...]:
        """Returns the takeovers to publish, one per agent.

        The residuals of agents that are not `recorded` are -1 and 0. Reference paths begin a little behind the agents.
        """
        agents = self.agents
        if not len(agents):
            return ()
        begin, end = agents.paths.window(agents.paths.project(agents.paths.each, self.x, self.y).s)
        poses = [(px, py, yaw) for px, py, yaw in agents.pose.tolist()]
        columns: dict[str, list[Any]] = {
            "agent": agents.agent.tolist(),
            "opponent": agents.opponent.tolist(),
            "state": [STATES[state] for state in agents.state.tolist()],
            "reason": [REASONS[reason] for reason in agents.reason.tolist()],
            "detected_step": agents.detected_step.tolist(),
            "time_to_conflict": agents.time_to_conflict.tolist(),
            "overlap_probability": agents.overlap_probability.tolist(),
            "conflict_pose": poses,
            "goal_pose": poses,
            "reference_path": [
                path.points[first:last]
                for path, first, last in zip(agents.path, begin.tolist(), end.tolist(), strict=True)
            ],
            "log_collision_predicted": agents.in_conflict.tolist(),
            "residual_position": np.where(self.recorded, self.residual_position, -1.0).tolist(),
            "residual_speed": np.where(self.recorded, self.residual_speed, 0.0).tolist(),
            "path_source": [SOURCES[source] for source in agents.source.tolist()],
            "time_shift": [steps * STEP_S for steps in self.lag.tolist()],
            "log_ratio": agents.log_ratio.tolist(),
        }
        return tuple(map(Takeover, *map(columns.__getitem__, COLUMNS)))


@kernel
def _places(
    log: tuple[Floats2, Floats2, Floats2, Floats2, Bools2], log_rows: Ints, steps: Ints, agents: AgentArrays, rows: Ints
) -> tuple[Bools, Floats2]:
    """Return whether the log contains r agents at `steps` (r,), and (8, r) where they are there, and where they are.

    These are x, y, yaw and speed of the log, at its nearest step, and then of the agents. They are in `log_rows` (r,)
    of the `log`, x, y, yaw, speed and validity (N, S), and in `rows` (r,) of `agents`.
    """
    (x, y, yaw, speed, valid), recorded, places = log, np.empty(len(rows), np.bool_), np.empty((8, len(rows)))
    for k in range(len(rows)):
        row, own, step = log_rows[k], rows[k], min(max(steps[k], 0), x.shape[1] - 1)
        recorded[k] = step == steps[k] and valid[row, step]
        places[0, k], places[1, k], places[2, k] = x[row, step], y[row, step], yaw[row, step]
        places[3, k] = speed[row, step]
        places[4, k], places[5, k], places[6, k] = agents.x[own], agents.y[own], agents.yaw[own]
        places[7, k] = agents.speed[own]
    return recorded, places
