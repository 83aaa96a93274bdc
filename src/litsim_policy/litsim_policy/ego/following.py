"""Egos that drive along a path behind other agents on it, for one scene or for several scenes at once."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_policy.ego.ego import Ego
from litsim_policy.motion.along_path import ahead_in_path
from litsim_policy.motion.car_following import IdmConfig, idm_acceleration
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, pursuit_reach, towards
from litsim_policy.motion.stop_lines import FREE, StopLines
from litsim_sim.core.scene import AgentTable, EgoCommand, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class Following:
    """How an ego drives at a step.

    Attributes:
        path: to pursue.
        acceleration: the most [m/s2], or exactly this without a model.
        model: for following the agent ahead on the path; None to ignore other agents.
        desired_speed: of the model [m/s].
        stops: whether the model also stops at red lights.
    """

    path: ReferencePath
    acceleration: float = np.inf
    model: IdmConfig | None = None
    desired_speed: float = 0.0
    stops: bool = False


class FollowingEgo(Ego):
    """An ego that is on its log, or drives along a path; see :class:`litsim_policy.ego.ego.Ego`."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._stop_lines = StopLines(scenario.signals)

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        row = table.row(self._scenario.ego_id)
        driving = self.following(table, row)
        if isinstance(driving, EgoCommand):
            return driving
        return commands(driving.path.batch, table, np.array([row]), [driving], self._stop_lines)[0]

    @abstractmethod
    def following(self, table: AgentTable, row: int) -> Following | EgoCommand:
        """How the ego drives, or its command if it follows no path; called once per step, in order.

        It is in `row` of `table`, -1 if it is not on the road, which may be of several scenes with ids other
        than the recording's.
        """


def commands(
    paths: PathBatch, table: AgentTable, rows: IntArray, drivers: Sequence[Following], stop_lines: StopLines
) -> list[EgoCommand]:
    """Returns commands of m egos that drive along `paths`, those of `drivers`, independent of each other."""
    x, y, yaw, speed = (getattr(table, name)[rows] for name in ("x", "y", "yaw", "speed"))
    target = paths.point(paths.project(paths.each, x, y).s + pursuit_reach(speed))
    yaw_rate = towards(target, x, y, yaw, speed)
    acceleration = np.array([driver.acceleration for driver in drivers])
    minding = [k for k, driver in enumerate(drivers) if driver.model is not None]
    if minding:
        behind = _behind(paths, table, rows, drivers, minding, stop_lines)
        acceleration[minding] = np.where(behind < acceleration[minding], behind, acceleration[minding])
    return [EgoCommand(table.step, *both) for both in zip(acceleration.tolist(), yaw_rate.tolist(), strict=True)]


def _behind(
    paths: PathBatch,
    table: AgentTable,
    rows: IntArray,
    drivers: Sequence[Following],
    minding: list[int],
    stop_lines: StopLines,
) -> FloatArray:
    """Returns accelerations [m/s2] behind leaders and at red lights, of the egos at positions `minding`."""
    own, paths = rows[minding], paths.take(np.array(minding))
    poses = table.x[own], table.y[own], table.yaw[own]
    (gap, along, leads, _, _), own_s, _ = ahead_in_path(paths, table, own, poses)
    if stop_lines.any:
        line = stop_lines.gaps(table, own, paths, own_s)
        line[[not drivers[k].stops for k in minding]] = FREE
        # a red light counts as a standing leader
        gap, along = np.column_stack([gap, line]), np.column_stack([along, np.zeros(len(line))])
        leads = np.column_stack([leads, line < FREE])
    models = [model for k in minding if (model := drivers[k].model) is not None]
    desired = np.array([drivers[k].desired_speed for k in minding])
    return idm_acceleration(models, table.speed[own], desired, gap, along, leads)
