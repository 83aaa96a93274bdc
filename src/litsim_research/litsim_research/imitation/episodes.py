"""Episodes of PS-GAIL: traffic in which a policy drives some agents and all others follow their logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from litsim_policy.driving.features.traffic_observation import TrafficObserver
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, route_path
from litsim_research.baselines.imitation_policy import BOUNDS, Turning, commanded, largest
from litsim_research.policies.draw import STAYS
from litsim_research.policies.reward import EDGE_FROM, EDGE_FULL, edge_clearance, others_near, ramp
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import Simulation

BRAKE = 2.0, 3.0  # [m/s2] braking at which RAIL's penalty begins and is full


@dataclass(frozen=True)
class TrafficStep:
    """Result of a step for the m agents driven in it; arrays (m, ...), ids ascending; no faults of who left the net.

    Attributes:
        agents: ids in the batched scenario.
        executed: (m, 2) executed motion, as actions in [-1, 1].
        contact: (m,) whether the agent touches one that is not behind it.
        off_road: (m,) in [0, 1], rises towards the edge of the road; 1 beyond it.
        hard_brake: (m,) in [0, 1], rises with hard braking.
        error: (m,) distance to the logged position [m]; NaN after the end of the log.
    """

    agents: IntArray
    executed: FloatArray
    contact: BoolArray
    off_road: FloatArray
    hard_brake: FloatArray
    error: FloatArray

    @property
    def worst(self) -> FloatArray:
        """RAIL's penalty (m,), positive: the greatest of the faults, with hard braking halved."""
        return np.maximum.reduce([self.contact.astype(np.float64), self.off_road, 0.5 * self.hard_brake])


class TrafficEpisodes:
    """S scenes of one kind, from the end of their histories on; agents in contact drive on, as in PS-GAIL.

    The agents nearest to the ego are driven; so are agents that enter late because others are in the way. The ego
    follows its log.

    Attributes:
        batch: the scenes.
        agents: (m,) ids of the driven agents, ascending.
        seen: (m, SIZE) their observations.
    """

    def __init__(self, scenes: Sequence[Scenario], count: int, radius: float, turning: Turning = "published") -> None:
        """Choose up to `count` agents of each of `scenes`, within `radius` [m] of its ego.

        `turning` says what yaw rate action 1 is.
        """
        self._turning = turning
        self._simulation = Simulation(scenes, "log", policy=None, full_length=True)
        assert self._simulation.batch is not None
        self.batch = self._simulation.batch
        self._observer = TrafficObserver(self.batch.lane_map)
        self._paths: dict[int, ReferencePath] = {}
        while self.step_number < self.batch.history_steps:
            self._simulation.step()
        table = self._simulation.table
        for agent in self._near(table, count, radius):
            self._take_over(table, table.row(agent))
        self._see(table)

    @property
    def step_number(self) -> int:
        """The current step."""
        return self._simulation.table.step

    @property
    def last_step(self) -> int:
        """The last step of the scene that ends first."""
        return min(scenario.total_steps for scenario in self.batch.scenarios)

    def step(self, action: FloatArray) -> TrafficStep:
        """Drive :attr:`agents` by `action` (m, 2), in [-1, 1] after clipping."""
        agents = self.agents
        most = np.broadcast_to(largest(self._followers.speed, self._turning), (len(agents), len(BOUNDS)))
        after = self._simulation.step(controls=commanded(self._followers, action, self._turning))
        self._see(after)
        rows = after.rows(agents)
        here = rows >= 0
        executed, error = np.zeros((len(agents), len(BOUNDS))), np.full(len(agents), np.nan)
        contact, off, brake = np.zeros(len(agents), np.bool_), np.zeros(len(agents)), np.zeros(len(agents))
        on = rows[here]
        executed[here] = np.column_stack([after.acceleration[on], after.yaw_rate[on]]) / most[here]
        touching, _ = others_near(after, on)
        contact[here] = touching.any(axis=1)
        off[here] = ramp(edge_clearance(after, on, self.batch.lane_map), EDGE_FROM, EDGE_FULL)
        brake[here] = ramp(-after.acceleration[on], *BRAKE)
        log, log_rows = self.batch.log, np.searchsorted(self.batch.log.ids, agents)
        recorded = here & (log.last_step[log_rows] >= after.step)
        x, y = log.x[log_rows[recorded], after.step], log.y[log_rows[recorded], after.step]
        error[recorded] = np.hypot(after.x[rows[recorded]] - x, after.y[rows[recorded]] - y)
        return TrafficStep(agents, np.clip(executed, -1.0, 1.0), contact, off, brake, error)

    def _near(self, table: AgentTable, count: int, radius: float) -> list[int]:
        """Returns ids of up to `count` agents within `radius` [m] of each scene's ego, the nearest first."""
        log = self.batch.log
        stays = log.last_step[np.searchsorted(log.ids, table.id)] > table.step + STAYS
        chosen: list[int] = []
        for scene, ego in enumerate(table.rows(self.batch.ego_ids).tolist()):
            apart = np.hypot(table.x - table.x[ego], table.y - table.y[ego])
            fits = (table.scene == scene) & stays & ~table.obstacle & (apart <= radius)
            fits[ego] = False
            nearest = np.argsort(np.where(fits, apart, np.inf), kind="stable")[: min(count, int(fits.sum()))]
            chosen += table.id[nearest].tolist()
        return chosen

    def _take_over(self, table: AgentTable, row: int) -> None:
        """Drive the agent in `row` from now on."""
        agent, pose = int(table.id[row]), np.array([table.x[row], table.y[row], table.yaw[row]])
        self._paths[agent] = route_path(self.batch.log, self.batch.lane_map, agent, pose)

    def _see(self, table: AgentTable) -> None:
        """Observe the agents at the step of `table`, those too that have entered late."""
        for row in np.flatnonzero(table.of_policy).tolist():
            if int(table.id[row]) not in self._paths:
                self._take_over(table, row)
        agents = np.array(sorted(self._paths), np.int64)
        rows = table.rows(agents)
        self.agents = agents[rows >= 0]
        paths = PathBatch.of([self._paths[agent].points for agent in self.agents.tolist()])
        self._followers = PathFollowers(self.batch.lane_map, table, rows[rows >= 0], paths)
        self.seen = self._observer.observe(self._followers)
