"""A run as the bridge announces it to the adapter."""

from __future__ import annotations

from dataclasses import dataclass

import yaml
from litsim_msgs.msg import RunInfo

from litsim_autoware.messages.vehicle import RearAxle
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.vehicle import VehicleGeometry
from litsim_sim.ros.topics import RUN_INFO
from litsim_sim.scenario.mission import Mission, ego_mission
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class AnnouncedRun:
    """A run, and what the ego of its scenario is and perceives.

    Attributes:
        run_id: its name.
        ego_id: the agent that Autoware drives.
        is_realtime: whether steps pass also unanswered.
        time_factor: simulation time per wall time.
        topics: names of the topics of its graph.
        scenario: what is simulated.
        mission: where the ego is to drive.
        perception: what the ego is told of other agents.
        geometry: sizes of the ego.
    """

    run_id: str
    ego_id: int
    is_realtime: bool
    time_factor: float
    topics: frozenset[str]
    scenario: Scenario
    mission: Mission
    perception: Perception
    geometry: VehicleGeometry

    @classmethod
    def of(cls, info: RunInfo) -> AnnouncedRun:
        """Returns the run of an announcement."""
        scenario = Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}")
        bridge = (yaml.safe_load(info.configuration) or {}).get(BRIDGE, {})
        return cls(
            run_id=info.run_id,
            ego_id=int(info.ego_id),
            is_realtime=info.mode == "realtime",
            time_factor=float(bridge.get("real_time_factor", 1.0)),
            topics=frozenset(info.topics),
            scenario=scenario,
            mission=ego_mission(scenario),
            perception=Perception(scenario),
            geometry=VehicleGeometry.of(scenario.log.table(0), int(info.ego_id), scenario.vehicle),
        )

    def rear_axle(self, table: AgentTable) -> RearAxle | None:
        """Returns the ego's motion in `table`; None if it is not on the road."""
        return RearAxle.of(table, self.ego_id, self.geometry.rear_axle_to_centre)

    def others(self, table: AgentTable) -> AgentTable:
        """Returns the agents of `table` but the ego, as the ego perceives them."""
        perceived = self.perception.of(table)
        return perceived.take(perceived.id != self.ego_id)
