"""Publishing of a run by the bridge: its description, the scene of every step, the ego's route and the lanes."""

from __future__ import annotations

import math
import time
from typing import Any

import yaml
from builtin_interfaces.msg import Time
from litsim_msgs.msg import RunInfo
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from litsim_sim.core.scene import AgentTable
from litsim_sim.core.stages import RECORDER
from litsim_sim.core.vehicle import VehicleGeometry
from litsim_sim.nodes.step_clock import StepClock
from litsim_sim.ros import frames, lane_clouds, messages, standard
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.frames import FrameBroadcaster
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    CONTROLS,
    EGO_APPLIED,
    EGO_CONTROL,
    EGO_FOOTPRINT,
    EGO_GOAL,
    EGO_ROUTE,
    EGO_STATE,
    EGO_VEHICLE,
    FORECASTS,
    LANE_LINKS,
    LANE_TABLE,
    LANES,
    LIGHT_MARKERS,
    LIGHTS,
    OBJECTS,
    RUN_INFO,
    SIGNAL_MAP,
    SIGNALS,
    TAKEOVERS,
    Topic,
)
from litsim_sim.scenario.mission import ego_mission
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan, versions

IF_HEARD = (OBJECTS, LIGHTS, LIGHT_MARKERS)
"""Published after step 0 only while somebody listens."""
OF_EGO = (EGO_STATE, EGO_ROUTE, EGO_GOAL, EGO_VEHICLE, EGO_FOOTPRINT)
PUBLISHED = (RUN_INFO, CLOCK, AGENTS, *OF_EGO, *IF_HEARD, LANES, LANE_TABLE, LANE_LINKS)
PUBLISHED_OF_SIGNALS = (SIGNAL_MAP, SIGNALS)
"""Published in addition if the scenario has signals."""


class Broadcast:
    """Publishes a run step by step."""

    def __init__(self, node: Node, plan: RunPlan, *, clock: bool = True, factor: float = 1.0) -> None:
        """Make the publishers of the bridge's `node`.

        Without `clock`, an adapter of the ego's stack publishes /clock and /tf. While a step waits, its time
        passes by `factor`.
        """
        self._plan = plan
        topics = PUBLISHED if plan.scenario.signals is None else (*PUBLISHED, *PUBLISHED_OF_SIGNALS)
        self._publishers = {topic: publisher_on(node, topic) for topic in topics if clock or topic != CLOCK}
        scenario = plan.scenario
        self._geometry = VehicleGeometry.of(scenario.log.table(0), scenario.ego_id, scenario.vehicle)
        self._clock = StepClock(self._show_time, self._are_ticks_heard, factor) if clock else None
        self._frames = FrameBroadcaster(node, self._geometry) if clock else None
        self._with_ticks = clock and plan.ego == EXTERNAL
        self._perception, self._lights = Perception(scenario), standard.Lights(scenario.signals, scenario.lane_map)
        self._scene: list[tuple[Topic, Any]] = []
        self._table: AgentTable | None = None  # the last step shown
        self._unheard: set[Topic] = set()  # of IF_HEARD, those on which it has not been published

    def begin(self, info: RunInfo) -> None:
        """Publish the messages for the whole run."""
        self._publishers[RUN_INFO].publish(info)
        scenario = self._plan.scenario
        mission, lane_map, signals = ego_mission(scenario), scenario.lane_map, scenario.signals
        self._publishers[EGO_ROUTE].publish(messages.route_path(mission.route, 0))
        self._publishers[EGO_GOAL].publish(lane_clouds.goal_pose(mission))
        self._publishers[EGO_VEHICLE].publish(frames.vehicle_table(self._geometry, scenario.vehicle))
        self._publishers[EGO_FOOTPRINT].publish(frames.footprint(self._geometry))
        if self._frames:
            self._frames.begin()
        self._publishers[LANES].publish(standard.lanes(lane_map))
        self._publishers[LANE_TABLE].publish(lane_clouds.lane_table(lane_map, mission))
        self._publishers[LANE_LINKS].publish(lane_clouds.lane_links(lane_map, signals.links if signals else ()))
        if signals is not None:
            self._publishers[SIGNAL_MAP].publish(messages.signal_map_to_message(signals, self._plan.run_id))

    def show(self, table: AgentTable) -> None:
        """Publish the agents of a step, which the stages wait for."""
        plan = self._plan
        message = messages.agents_to_message(table, plan.run_id, plan.scenario.total_steps, plan.scenario.ego_id)
        self._scene = [self._publish(AGENTS, message)]

    def accompany(self, table: AgentTable) -> None:
        """Publish the other messages of the last step shown; after step 0, those of IF_HEARD only to subscribers."""
        ego_id = self._plan.scenario.ego_id
        state = messages.ego_odometry(table, ego_id, self._plan.scenario.vehicle.rear_axle)
        if self._frames and table.row(ego_id) >= 0:
            self._frames.show(state)
        self._scene.append(self._publish(EGO_STATE, state))
        if self._clock:
            self._clock.step(table.step, time.perf_counter())
        if (signals := self._plan.scenario.signals) is not None:
            shown = messages.signals_to_message(signals.table(table.step), self._plan.run_id)
            self._scene.append(self._publish(SIGNALS, shown))
        self._table, self._unheard = table, set(IF_HEARD)
        self._show_heard(table)

    def repeat(self) -> None:
        """Publish the last step shown again, and what of it a subscriber that has come since, as a new stack, wants."""
        for topic, message in self._scene:
            self._publish(topic, message)
        if self._clock:
            self._clock.repeat()
        if self._table is not None:
            self._show_heard(self._table)

    def creep(self) -> None:
        """Advance the clock a little, while step 0 waits for a stack whose timers may need that."""
        if self._clock and self._with_ticks:
            self._clock.creep()

    def tick(self, now: float) -> float:
        """Publish the time at `now` of the performance counter [s]; returns the time until the next call is due."""
        if self._clock is None or not self._with_ticks or self._clock.current == 0:
            return math.inf
        return self._clock.tick(now)

    def _are_ticks_heard(self) -> bool:
        """Returns whether others than the recorder, which needs the steps' times only, listen to the clock."""
        own = int(RECORDER in self._plan.stages)
        return self._with_ticks and self._publishers[CLOCK].get_subscription_count() > own

    def _show_time(self, time_ns: int) -> None:
        seconds, nanoseconds = divmod(time_ns, 10**9)
        self._publishers[CLOCK].publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def _show_heard(self, table: AgentTable) -> None:
        """Publish what of IF_HEARD has not been published of the last step, and is heard; of step 0 everything."""
        told = self._perception.of(table)
        for topic in IF_HEARD:
            if topic in self._unheard and (table.step == 0 or self._publishers[topic].get_subscription_count()):
                self._unheard.remove(topic)
                self._scene.append(self._publish(topic, self._standard(topic, told)))

    def _standard(self, topic: Topic, table: AgentTable) -> Any:
        """Returns the message of a topic of IF_HEARD on a step."""
        if topic == OBJECTS:
            return standard.objects(table, self._plan.scenario.ego_id)
        if topic == LIGHTS:
            return self._lights.cloud(table.step)
        return standard.light_markers(table.step, self._plan.scenario.signals)

    def _publish(self, topic: Topic, message: Any) -> tuple[Topic, Any]:
        self._publishers[topic].publish(message)
        return topic, message


def run_info(plan: RunPlan, mode: str, configuration: dict[str, dict[str, Any]], *, clock: bool = True) -> RunInfo:
    """Returns ``RunInfo`` of a run; `configuration` are parameters by stage and name."""
    per_step = (
        (*((CLOCK,) if clock else ()), AGENTS, EGO_STATE)
        + (() if plan.scenario.signals is None else (SIGNALS,))
        + (() if plan.policy == "replay" else (FORECASTS, TAKEOVERS, CONTROLS))
        + (() if plan.ego == EXTERNAL else (EGO_CONTROL,))
        + ((EGO_APPLIED,) if plan.applied else ())
    )
    return RunInfo(
        **plan.facts(),
        header=messages.header(0),
        mode=mode,
        topics=[topic.name for topic in per_step],
        configuration=yaml.safe_dump(configuration),
        versions=yaml.safe_dump(versions()),
    )
