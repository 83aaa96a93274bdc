"""Tasks of agents under policy C, and the scene of all agents with tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_policy.motion.along_path import Poses
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, IntArray
from litsim_sim.core.takeover import PathSource, Takeover
from litsim_sim.lane_map.lane_map import LaneMap

NOBODY = -1  # in place of an opponent's id


@dataclass(frozen=True)
class DrivingTask:
    """The task of an agent under policy C.

    Attributes:
        agent: id.
        path: reference path.
        goal: (2,) the conflict's crossing point, x and y in frame map [m].
        due_step: step at which the agent, had it followed its log, was expected there.
        opponent: id of the agent with which it is in conflict; NOBODY for none.
    """

    agent: int
    path: ReferencePath
    goal: FloatArray
    due_step: int
    opponent: int = NOBODY


@dataclass
class DrivingScene:
    """The m agents with a task among all agents of a step.

    Attributes:
        id: (m,) of the agents.
        agents: the agents on their paths.
        goal, due_step, opponent: (m, 2), (m,), (m,) as in :class:`DrivingTask`.
    """

    id: IntArray
    agents: PathFollowers
    goal: FloatArray
    due_step: IntArray
    opponent: IntArray

    def __len__(self) -> int:
        return len(self.id)

    @classmethod
    def of(
        cls, lane_map: LaneMap, table: AgentTable, tasks: Sequence[DrivingTask], poses: Poses | None = None
    ) -> DrivingScene:
        """Returns the scene of `tasks`, whose agents are all in `table`; `poses` as in :class:`PathFollowers`."""
        return cls.on_paths(
            lane_map,
            table,
            [task.path.points for task in tasks],
            [task.goal for task in tasks],
            [(task.agent, task.due_step, task.opponent) for task in tasks],
            poses,
        )

    @classmethod
    def of_takeovers(cls, lane_map: LaneMap, table: AgentTable, takeovers: Sequence[Takeover]) -> DrivingScene:
        """Returns the scene of agents that were taken over, all of which are in `table`."""
        return cls.on_paths(
            lane_map,
            table,
            [t.reference_path for t in takeovers],
            [t.goal_pose[:2] for t in takeovers],
            [(t.agent, due_step(t), opponent_of(t)) for t in takeovers],
        )

    @classmethod
    def on_paths(
        cls,
        lane_map: LaneMap,
        table: AgentTable,
        points: Sequence[FloatArray],
        goals: Sequence[FloatArray] | Sequence[tuple[float, float]],
        numbers: Sequence[tuple[int, int, int]],
        poses: Poses | None = None,
    ) -> DrivingScene:
        """Returns the scene of m agents on paths to goals; `numbers` are id, due step and opponent of each."""
        ids, due, opponent = np.array(numbers, np.int64).reshape(-1, 3).T
        agents = PathFollowers(lane_map, table, table.rows(ids), PathBatch.of(points), poses)
        return cls(ids, agents, np.array(goals, np.float64).reshape(-1, 2), due, opponent)


def due_step(takeover: Takeover) -> int:
    """Returns the step at which the agent of `takeover`, had it followed its log, was expected at the conflict."""
    return takeover.detected_step + round(takeover.time_to_conflict / STEP_S)


def opponent_of(takeover: Takeover) -> int:
    """Id of the other agent of the conflict; NOBODY if the agent has entered late and alone, or is passing."""
    if takeover.path_source == PathSource.LANE or takeover.opponent == takeover.agent:
        return NOBODY
    return takeover.opponent


def lag_of(takeover: Takeover) -> int:
    """Returns the lag [steps] of the log that the agent of `takeover` would return to now."""
    return round(takeover.time_shift / STEP_S)
