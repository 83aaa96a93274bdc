"""A stand-in for Autoware that knows only Autoware's topics and services: a planner, pure pursuit, and its AD API.

The planner keeps to a line and behind what is ahead in it; the line stands for the map that Autoware would load, and is
read from a topic. The controller runs on a timer of 30 ms and stamps its commands with the time of the odometry, as
autoware_simple_pure_pursuit does. Services refuse until what they need is there.
"""

import argparse
import os
import sys
import time
from typing import Any

import numpy as np
import rclpy
from autoware_adapi_v1_msgs.msg import MrmState, ResponseStatus
from autoware_adapi_v1_msgs.srv import ChangeOperationMode, ClearRoute, InitializeLocalization, SetRoutePoints
from autoware_control_msgs.msg import Control
from autoware_perception_msgs.msg import PredictedObjects
from autoware_planning_msgs.msg import Trajectory, TrajectoryPoint
from autoware_vehicle_msgs.msg import GearCommand, TurnIndicatorsCommand
from autoware_vehicle_msgs.srv import ControlModeCommand
from geometry_msgs.msg import AccelWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

WANTED, HEADWAY_S, GAP = 15.0, 1.5, 4.0  # [m/s], [s], [m]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
p = argparse.ArgumentParser()
p.add_argument("--universe", action="store_true", help="localization and operation mode are asked for as well")
p.add_argument("--only", choices=("plan", "control"), help="another process does the rest")
p.add_argument("--apart", action="store_true", help="planner and controller are two processes")
p.add_argument("--sim-time", action="store_true", help="timers run on /clock")
p.add_argument("--wheelbase", type=float, default=2.6)
p.add_argument("--overhang", type=float, default=3.5)
p.add_argument("--late", type=float, default=0.0, help="seconds until it starts")
p.add_argument("--slow", type=float, default=0.0, help="seconds that a plan takes")
p.add_argument("--restart-after", type=int, default=-1, help="commands after which it starts anew, knowing nothing")
options = p.parse_args()


class StandIn(Node):
    def __init__(self) -> None:
        super().__init__(
            f"stand_in_{options.only}", parameter_overrides=[Parameter("use_sim_time", value=options.sim_time)]
        )
        self.line = np.empty(0, complex)
        self.objects = PredictedObjects()
        self.odometry: Odometry | None = None
        self.trajectory: Trajectory | None = None
        self.initialized, self.route, self.engaged = not options.universe, False, not options.universe
        self.refusals = 2
        name = "/planning/scenario_planning/trajectory" if options.universe else "/planning/trajectory"
        if options.only == "control":
            self.plans = self.create_subscription(Trajectory, name, self.on_trajectory, 1)
        else:
            self.create_subscription(Path, "/litsim/ego/route", self.on_line, LATCHED)
            self.create_subscription(PredictedObjects, "/perception/object_recognition/objects", self.on_objects, 1)
            self.create_subscription(AccelWithCovarianceStamped, "/localization/acceleration", lambda message: None, 1)
            self.plan_to = self.create_publisher(Trajectory, name, 1)
            self.serve()
        self.create_subscription(Odometry, "/localization/kinematic_state", self.on_odometry, 1)
        self.gear_to = self.create_publisher(GearCommand, "/control/command/gear_cmd", 1)
        self.turn_to = self.create_publisher(TurnIndicatorsCommand, "/control/command/turn_indicators_cmd", 1)
        mrm = "/api/fail_safe/mrm_state" if options.universe else "/system/fail_safe/mrm_state"
        self.mrm_to = self.create_publisher(MrmState, mrm, 1)
        if options.only != "plan":
            self.to = self.create_publisher(Control, "/control/command/control_cmd", 1)
            self.create_timer(0.03, self.control)

    def serve(self) -> None:
        self.mode = self.create_client(ControlModeCommand, "/control/control_mode_request")
        if options.universe:
            self.create_service(InitializeLocalization, "/api/localization/initialize", self.initialize)
            self.create_service(ChangeOperationMode, "/api/operation_mode/change_to_autonomous", self.engage)
        self.create_service(SetRoutePoints, "/api/routing/set_route_points", self.set_route)
        self.create_service(ClearRoute, "/api/routing/clear_route", self.clear_route)

    def on_trajectory(self, message: Trajectory) -> None:
        self.trajectory = message

    def initialize(self, request: Any, response: Any) -> Any:
        at_rest = self.odometry is not None and self.odometry.twist.twist.linear.x == 0.0
        self.initialized = at_rest and len(request.pose) == 1
        return answered(response, 1, "the vehicle moves, or there is no pose", success=self.initialized)

    def set_route(self, request: Any, response: Any) -> Any:
        self.refusals -= 1
        self.route = self.initialized and self.refusals < 0 and request.goal.position.x != 0.0
        return answered(response, 2, "the planner is not ready", success=self.route)

    def clear_route(self, _: Any, response: Any) -> Any:
        self.route = False
        return answered(response, success=True)

    def engage(self, _: Any, response: Any) -> Any:
        self.engaged = self.route
        if self.engaged:
            self.mode.call_async(ControlModeCommand.Request(mode=ControlModeCommand.Request.AUTONOMOUS))
        return answered(response, 1, "there is no route", success=self.engaged)

    def on_line(self, message: Path) -> None:
        corners = np.array([complex(pose.pose.position.x, pose.pose.position.y) for pose in message.poses])
        s = np.append(0.0, np.cumsum(abs(np.diff(corners))))
        self.line = np.interp(np.arange(s[-1]), s, corners)

    def on_objects(self, message: PredictedObjects) -> None:
        self.objects = message

    def on_odometry(self, message: Odometry) -> None:
        self.odometry = message
        if self.route and len(self.line):
            time.sleep(options.slow)
            self.trajectory = self.plan(message)
            self.plan_to.publish(self.trajectory)

    def plan(self, odometry: Odometry) -> Trajectory:
        at, yaw, _ = state_of(odometry)
        begin = int(np.argmin(abs(self.line - at)))
        ahead = self.line[begin : begin + 80]
        gap = 100.0
        for each in self.objects.objects:
            pose = each.kinematics.initial_pose_with_covariance.pose.position
            away = (complex(pose.x, pose.y) - at) * np.exp(-1j * yaw)
            beside = np.min(abs(ahead - complex(pose.x, pose.y)))
            if away.real > 0.0 and beside < 1.5:
                gap = min(gap, away.real - 0.5 * each.shape.dimensions.x - options.overhang)
        wanted = float(np.clip((gap - GAP) / HEADWAY_S, 0.0, WANTED))
        message = Trajectory(header=odometry.header)
        heading = np.angle(np.gradient(ahead))
        for place, turn in zip(ahead, heading, strict=True):
            point = TrajectoryPoint(longitudinal_velocity_mps=wanted)
            point.pose.position.x, point.pose.position.y = place.real, place.imag
            point.pose.orientation.z, point.pose.orientation.w = np.sin(0.5 * turn), np.cos(0.5 * turn)
            message.points.append(point)
        return message

    def control(self) -> None:
        if options.only == "control":  # polls, as nodes of Autoware do: rclpy serves timers before subscriptions
            with self.plans.handle:
                newest = self.plans.handle.take_message(Trajectory, self.plans.raw)
            self.trajectory = newest[0] if newest else self.trajectory
        if not (self.engaged and self.odometry and self.trajectory):
            return
        odometry, points = self.odometry, self.trajectory.points
        at, yaw, speed = state_of(odometry)
        line = np.array([complex(point.pose.position.x, point.pose.position.y) for point in points])
        look = max(6.0, 0.8 * speed)
        target = line[min(int(np.argmin(abs(line - at)) + look), len(line) - 1)]
        alpha = np.angle(target - at) - yaw
        message = Control(stamp=odometry.header.stamp)
        message.lateral.steering_tire_angle = float(np.arctan2(2.0 * options.wheelbase * np.sin(alpha), look))
        message.longitudinal.velocity = points[0].longitudinal_velocity_mps
        message.longitudinal.acceleration = float(np.clip(points[0].longitudinal_velocity_mps - speed, -4.0, 1.5))
        self.to.publish(message)
        options.restart_after -= 1
        if options.restart_after == 0:
            words = sys.argv[: sys.argv.index("--restart-after")]
            os.execv(sys.executable, [sys.executable, *words])
        self.gear_to.publish(GearCommand(stamp=message.stamp, command=GearCommand.DRIVE))
        side = TurnIndicatorsCommand.ENABLE_LEFT if speed < 14.0 else TurnIndicatorsCommand.DISABLE
        self.turn_to.publish(TurnIndicatorsCommand(stamp=message.stamp, command=side))
        self.mrm_to.publish(MrmState(stamp=message.stamp, state=MrmState.NORMAL, behavior=MrmState.NONE))


def answered(response: Any, code: int = 0, text: str = "", *, success: bool) -> Any:
    response.status = ResponseStatus(success=success, code=0 if success else code, message="" if success else text)
    return response


def state_of(odometry: Odometry) -> tuple[complex, float, float]:
    pose = odometry.pose.pose
    yaw = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
    return complex(pose.position.x, pose.position.y), float(yaw), float(odometry.twist.twist.linear.x)


if options.apart:
    options.only = "plan" if os.fork() else "control"
time.sleep(options.late)
rclpy.init()
executor = SingleThreadedExecutor()
executor.add_node(StandIn())
try:
    executor.spin()
except (KeyboardInterrupt, ExternalShutdownException):
    sys.exit(0)
