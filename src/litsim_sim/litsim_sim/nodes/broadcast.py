"""Publishing of a run by the bridge: its description, the scene of every step, the ego's route and the lanes."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml
from litsim_msgs.msg import RunInfo
from nav_msgs.msg import Path
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from litsim_sim.core.scene import AgentTable
from litsim_sim.ros import messages, standard
from litsim_sim.ros.endpoints import publisher_on
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    CONTROLS,
    EGO_APPLIED,
    EGO_CONTROL,
    EGO_ROUTE,
    EGO_STATE,
    FORECASTS,
    LANES,
    OBJECTS,
    RUN_INFO,
    SIGNAL_MAP,
    SIGNALS,
    TAKEOVERS,
    Topic,
)
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan, versions
from litsim_sim.scenario.scenario import Scenario

PUBLISHED = (RUN_INFO, CLOCK, AGENTS, EGO_STATE, OBJECTS, EGO_ROUTE, LANES)
PUBLISHED_OF_SIGNALS = (SIGNAL_MAP, SIGNALS)
"""Published in addition if the scenario has signals."""
ROUTE_LENGTH = 1000.0  # [m] length of the ego's route


class Broadcast:
    """Publishes a run step by step."""

    def __init__(self, node: Node, plan: RunPlan) -> None:
        self._plan = plan
        topics = PUBLISHED if plan.scenario.signals is None else (*PUBLISHED, *PUBLISHED_OF_SIGNALS)
        self._publishers = {topic: publisher_on(node, topic) for topic in topics}
        self._scene: list[tuple[Topic, Any]] = []
        self._without_objects: AgentTable | None = None  # the last step shown, if its objects have not been published

    def begin(self, info: RunInfo) -> None:
        """Publish the messages for the whole run."""
        self._publishers[RUN_INFO].publish(info)
        self._publishers[EGO_ROUTE].publish(route(self._plan.scenario))
        self._publishers[LANES].publish(standard.lanes(self._plan.scenario.lane_map))
        if (signals := self._plan.scenario.signals) is not None:
            self._publishers[SIGNAL_MAP].publish(messages.signal_map_to_message(signals, self._plan.run_id))

    def show(self, table: AgentTable) -> None:
        """Publish the agents of a step, which the stages wait for."""
        plan = self._plan
        message = messages.agents_to_message(table, plan.run_id, plan.scenario.total_steps, plan.scenario.ego_id)
        self._scene = [self._publish(AGENTS, message)]

    def accompany(self, table: AgentTable) -> None:
        """Publish the other messages of the last step shown; after step 0, objects only if there are subscribers."""
        ego_id = self._plan.scenario.ego_id
        self._scene += [
            self._publish(EGO_STATE, messages.ego_odometry(table, ego_id)),
            self._publish(CLOCK, Clock(clock=messages.stamp(table.step))),
        ]
        if (signals := self._plan.scenario.signals) is not None:
            shown = messages.signals_to_message(signals.table(table.step), self._plan.run_id)
            self._scene.append(self._publish(SIGNALS, shown))
        self._without_objects = table
        if table.step == 0 or self._are_objects_heard:
            self._show_objects(table)

    def repeat(self) -> None:
        """Publish the last step shown again; its objects, too, if a subscriber has come since, such as a new stack."""
        for topic, message in self._scene:
            self._publish(topic, message)
        if self._without_objects is not None and self._are_objects_heard:
            self._show_objects(self._without_objects)

    @property
    def _are_objects_heard(self) -> bool:
        return bool(self._publishers[OBJECTS].get_subscription_count())

    def _show_objects(self, table: AgentTable) -> None:
        self._scene.append(self._publish(OBJECTS, standard.objects(table, self._plan.scenario.ego_id)))
        self._without_objects = None

    def _publish(self, topic: Topic, message: Any) -> tuple[Topic, Any]:
        self._publishers[topic].publish(message)
        return topic, message


def route(scenario: Scenario) -> Path:
    """Returns the centre line of the ego's first lane and its continuation."""
    table = scenario.log.table(0)
    row = np.array([table.row(scenario.ego_id)])
    at = scenario.lane_map.nearest(table.x[row], table.y[row], table.yaw[row])
    return messages.route_path(scenario.lane_map.path_from(int(at.lane[0]), float(at.s[0]), ROUTE_LENGTH), 0)


def run_info(plan: RunPlan, mode: str, configuration: dict[str, dict[str, Any]]) -> RunInfo:
    """Returns ``RunInfo`` of a run; `configuration` has the parameters of its stages, by stage and name."""
    per_step = (
        (CLOCK, AGENTS, EGO_STATE)
        + (() if plan.scenario.signals is None else (SIGNALS,))
        + (() if plan.policy == "replay" else (FORECASTS, TAKEOVERS, CONTROLS))
        + ((EGO_APPLIED,) if plan.ego == EXTERNAL else (EGO_CONTROL,))
    )
    return RunInfo(
        **plan.facts(),
        header=messages.header(0),
        mode=mode,
        topics=[topic.name for topic in per_step],
        configuration=yaml.safe_dump(configuration),
        versions=yaml.safe_dump(versions()),
    )
