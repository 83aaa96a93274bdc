"""Lets CommonRoad's reactive planner drive LitSim's ego: standard messages in, a trajectory (nav_msgs/Path) out."""

from __future__ import annotations

import json
import sys
from dataclasses import fields
from pathlib import Path as File
from typing import Any

import numpy as np
import rclpy
from conversions import STEP_NS, ego_of, lanes_of, limit_of, line_of, objects_of, path_message
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry, Path
from planner import Body, Plan, Planner
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)


class Adapter(Node):
    """Answers every step once the stamps of ego and objects agree.

    Parameters: `wanted` speed [m/s], within the route's limits; `every`, steps between two plans; `figures`, a JSON
    file that tells at the end how the planner did.
    """

    def __init__(self) -> None:
        super().__init__("commonroad_planner")
        self._wanted = self.declare_parameter("wanted", 14.0).value
        self._every = self.declare_parameter("every", 1).value
        self._body: Body | None = None
        self._figures = self.declare_parameter("figures", "").value
        self._seen: dict[type, Any] = {}
        self._limit: float | None = None
        self._plans: dict[int, Plan] = {}  # by the stamp they were made for [ns]
        self._planner: Planner | None = None
        self._answer: Path | None = None
        self._publisher = self.create_publisher(Path, "/litsim/ego/trajectory", 10)
        self.create_subscription(Path, "/litsim/ego/route", self._on_input, LATCHED)
        self.create_subscription(DiagnosticArray, "/litsim/ego/vehicle", self._on_vehicle, LATCHED)
        self.create_subscription(MarkerArray, "/litsim/lanes", self._on_input, LATCHED)
        self.create_subscription(PointCloud2, "/litsim/lanes/table", self._on_table, LATCHED)
        self.create_subscription(Odometry, "/litsim/ego/state", self._on_input, 100)
        self.create_subscription(PointCloud2, "/litsim/objects", self._on_input, 100)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_input(self, message: Any) -> None:
        self._seen[type(message)] = message
        route, lanes, ego, objects = (self._seen.get(kind) for kind in (Path, MarkerArray, Odometry, PointCloud2))
        limit = self._limit
        if (
            not (self._body and limit and route and lanes and ego and objects)
            or ego.header.stamp != objects.header.stamp
        ):
            return
        del self._seen[Odometry], self._seen[PointCloud2]  # a step that is published again is answered again
        wanted = min(self._wanted, limit)
        self._planner = self._planner or Planner(line_of(route), lanes_of(lanes), self._body, wanted)
        if self._answer is None or self._answer.header.stamp != ego.header.stamp:
            self._answer = self._respond(Time.from_msg(ego.header.stamp).nanoseconds, ego, objects)
        self._publisher.publish(self._answer)

    def _on_vehicle(self, array: DiagnosticArray) -> None:
        values = {value.key: float(value.value) for status in array.status for value in status.values}
        self._body = Body(**{field.name: values[field.name] for field in fields(Body)})

    def _on_table(self, lanes: PointCloud2) -> None:
        self._limit = limit_of(lanes)

    def _respond(self, stamp: int, ego: Odometry, objects: PointCloud2) -> Path:
        assert self._planner is not None
        last, self._answer = self._answer, None
        if last is not None and len(self._plans) % self._every:  # the rest of the last plan
            last.header.stamp = ego.header.stamp
            last.poses = [pose for pose in last.poses if Time.from_msg(pose.header.stamp).nanoseconds >= stamp]
            self._plans[stamp] = Plan(line_of(last), 0.0)
            return last
        plan = self._planner.plan(stamp // STEP_NS, ego_of(ego), objects_of(objects))
        if plan.fault:
            self.get_logger().warning(f"{stamp * 1e-9:.1f} s: braking, for {plan.fault}")
        self._plans[stamp] = plan
        return path_message(stamp, plan.points)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        said = [value.value for status in array.status if status.name == "litsim: bridge" for value in status.values]
        if {"FINISHED", "FAILED"} & set(said):
            self._report()
            self._planner = None  # its collision objects complain of what outlives them
            sys.exit(0)

    def _report(self) -> None:
        took = 1e3 * np.array([plan.seconds for plan in self._plans.values() if plan.seconds > 0.0])
        failed = {f"{stamp * 1e-9:.1f}": plan.fault for stamp, plan in self._plans.items() if plan.fault}
        figures = {
            "steps": len(self._plans),
            "plans": len(took),
            "without_distance": sum(plan.close for plan in self._plans.values()),
            "without_solution": len(failed),
            "planning_ms": {
                "median": round(float(np.median(took)), 1) if len(took) else None,
                "p95": round(float(np.percentile(took, 95)), 1) if len(took) else None,
                "max": round(float(took.max()), 1) if len(took) else None,
            },
            "faults": failed,
        }
        self.get_logger().info(json.dumps({key: value for key, value in figures.items() if key != "faults"}))
        if self._figures:
            File(self._figures).write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Adapter())
