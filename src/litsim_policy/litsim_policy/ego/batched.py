"""The egos of several scenes that are stepped together, with one computation for all that drive along paths."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from litsim_policy.ego.ego import Ego
from litsim_policy.ego.following import Following, FollowingEgo, commands
from litsim_policy.ego.log import LogEgo
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_policy.motion.stop_lines import StopLines
from litsim_sim.core.scene import AgentTable, EgoCommand
from litsim_sim.scenario.batched import BatchedScenario


class BatchedEgos:
    """The egos of batched scenes; each gives the same commands as on its own."""

    def __init__(self, batch: BatchedScenario, egos: Sequence[Ego]) -> None:
        """`egos` are those of the scenes of `batch`, in order."""
        self._batch, self._egos = batch, tuple(egos)
        self._stop_lines = StopLines(batch.signals)
        self._followed: list[ReferencePath] = []
        self._paths = PathBatch.of([])

    def plan(self, table: AgentTable, scenes: Iterable[int]) -> list[EgoCommand]:
        """Returns commands of all egos for the step of `table`; empty ones for scenes that are not in `scenes`."""
        answers = [EgoCommand(table.step)] * len(self._egos)
        rows = table.rows(self._batch.ego_ids)
        driving: dict[int, Following] = {}
        for scene in scenes:
            ego = self._egos[scene]
            if isinstance(ego, FollowingEgo):
                plan = ego.following(table, int(rows[scene]))
            elif isinstance(ego, LogEgo):  # which looks at nothing
                plan = ego.plan(table)
            else:
                plan = ego.plan(self._batch.table(scene, table))
            if isinstance(plan, Following):
                driving[scene] = plan
            else:
                answers[scene] = plan
        if driving:
            of, drivers = list(driving), list(driving.values())
            paths = self._along([driver.path for driver in drivers])
            planned = commands(paths, table, rows[of], drivers, self._stop_lines)
            for scene, command in zip(of, planned, strict=True):
                answers[scene] = command
        return answers

    def _along(self, followed: list[ReferencePath]) -> PathBatch:
        """Returns the batch of the paths `followed`, rebuilt only when they change."""
        if [*map(id, followed)] != [*map(id, self._followed)]:
            self._followed, self._paths = followed, PathBatch.of([path.points for path in followed])
        return self._paths
