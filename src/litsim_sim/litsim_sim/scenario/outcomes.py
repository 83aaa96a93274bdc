"""Motion in an earlier run of the same case, for oracles: stages of experiments that know the future.

The future is that of the earlier run: once an agent moves differently in the current run, others may, too.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.io.files import replacing
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.setting import Setting

UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, zlib.error)
"""Exceptions that numpy raises for files that are damaged or not archives of arrays."""


@dataclass(frozen=True, eq=False)
class RecordedOutcomes:
    """The motion of the N agents of a log, in its order, over S steps.

    Attributes:
        pose: (N, S, 3) box centre x, y [m] and heading [rad], frame map.
        there: (N, S) whether the agent was on the road.
        meetings: (m, 3) row of an agent whose logged box met that of an agent off its log, step, row of the latter.
    """

    pose: FloatArray
    there: BoolArray
    meetings: IntArray

    @classmethod
    def of_run(
        cls, ids: IntArray, tables: Sequence[AgentTable], log: Sequence[AgentTable], ego_id: int
    ) -> RecordedOutcomes:
        """Extract the motion of a run.

        Args:
            ids: (N,) of the agents of the log, ascending.
            tables, log: agents of all steps from 0 on, in the run and in the log.
            ego_id: id of the ego, which counts as off its log at all steps.
        """
        pose, there = np.zeros((len(ids), len(tables), 3)), np.zeros((len(ids), len(tables)), np.bool_)
        meetings = []
        for table, logged in zip(tables, log, strict=True):
            rows = np.searchsorted(ids, table.id)
            pose[rows, table.step] = np.column_stack([table.x, table.y, table.yaw])
            there[rows, table.step] = True
            meetings += _meetings(ids, table.take(table.off_log | (table.id == ego_id)), logged)
        return cls(pose, there, np.array(meetings, np.int64).reshape(-1, 3))

    @classmethod
    def read(cls, folder: Path, scenario: Setting) -> RecordedOutcomes:
        """Read the motion of the runs of all scenes of `scenario`; rows are those of its log.

        Raises:
            InputError: the file of a scene in `folder` is missing or cannot be read, or is of another log.
        """
        scenarios = scenario.scenarios if isinstance(scenario, BatchedScenario) else (scenario,)
        parts = [_read(file_of(folder, each), len(each.log.ids)) for each in scenarios]
        steps = max(part.there.shape[1] for part in parts)
        first = np.cumsum([0, *(len(part.there) for part in parts)])
        shifts = [part.meetings + np.array([at, 0, at]) for part, at in zip(parts, first[:-1], strict=True)]
        padded = [steps - part.there.shape[1] for part in parts]
        return cls(
            np.concatenate([np.pad(p.pose, ((0, 0), (0, n), (0, 0))) for p, n in zip(parts, padded, strict=True)]),
            np.concatenate([np.pad(p.there, ((0, 0), (0, n))) for p, n in zip(parts, padded, strict=True)]),
            np.concatenate(shifts),
        )

    def write(self, path: Path) -> None:
        """Write the file of a scene atomically.

        Raises:
            Unwritable: it cannot be written.
        """
        with replacing(path) as new:
            np.savez_compressed(new, pose=self.pose, there=self.there, meetings=self.meetings)


def file_of(folder: Path, scenario: Scenario) -> Path:
    """Returns the file with the motion of a run of `scenario`."""
    return folder / f"{scenario.name}_{scenario.ego_id}_{scenario.seed}.npz"


def _read(path: Path, agents: int) -> RecordedOutcomes:
    try:
        with np.load(path) as values:
            outcomes = RecordedOutcomes(values["pose"], values["there"], values["meetings"])
    except UNREADABLE as error:
        raise InputError(f"{path}: cannot be read as what happened in a run: {error}") from error
    if len(outcomes.there) != agents:
        raise InputError(f"{path}: {len(outcomes.there)} agents, expected the {agents} of the log")
    return outcomes


def _meetings(ids: IntArray, movers: AgentTable, logged: AgentTable) -> list[tuple[int, int, int]]:
    """Finds overlaps of boxes of `logged` with those of other agents in `movers`, which are the agents off their logs.

    Returns:
        For each, the row in `ids` of the logged agent, the step, and the row in `ids` of the mover.
    """
    dx, dy = movers.x[None] - logged.x[:, None], movers.y[None] - logged.y[:, None]
    size = (logged.length[:, None], logged.width[:, None])
    hit = boxes_overlap(dx, dy, logged.yaw[:, None], movers.yaw[None], size, (movers.length, movers.width))
    hit &= logged.id[:, None] != movers.id[None]
    rows, others = np.searchsorted(ids, logged.id), np.searchsorted(ids, movers.id)
    return [(int(rows[i]), movers.step, int(others[j])) for i, j in np.argwhere(hit)]
