"""The node between the ego port and Autoware: publishes what Autoware reads of a step, and answers what it commands."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from math import cos, inf, sin
from typing import Any

import numpy as np
import yaml
from autoware_adapi_v1_msgs.msg import LocalizationInitializationState, MrmState, OperationModeState
from autoware_adapi_v1_msgs.srv import ChangeOperationMode, ClearRoute, InitializeLocalization, SetRoutePoints
from autoware_control_msgs.msg import Control
from autoware_perception_msgs.msg import DetectedObjects, PredictedObjects, TrackedObjects, TrafficLightGroupArray
from autoware_planning_msgs.msg import Trajectory
from autoware_vehicle_msgs.msg import (
    ControlModeReport,
    GearCommand,
    GearReport,
    HazardLightsCommand,
    HazardLightsReport,
    SteeringReport,
    TurnIndicatorsCommand,
    TurnIndicatorsReport,
    VelocityReport,
)
from autoware_vehicle_msgs.srv import ControlModeCommand
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelWithCovarianceStamped, Pose, PoseStamped, PoseWithCovarianceStamped
from litsim_msgs.msg import AgentStates, JointForecast, RunInfo, SignalStates, StageStatus
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

from litsim_autoware.messages import objects, vehicle
from litsim_autoware.messages.cdr import ENCAPSULATION, TIME, Message, stamped
from litsim_autoware.messages.objects import Forecast
from litsim_autoware.messages.output import Output
from litsim_autoware.messages.vehicle import RearAxle
from litsim_autoware.stack.profile import TRAJECTORY, Profile
from litsim_autoware.stack.start_up import Call, StartUp
from litsim_autoware.stack.timeline import BEGIN_NS, Timeline
from litsim_sim.core.scene import STEP_NS, AgentTable, EgoCommand, FloatArray
from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.core.vehicle_geometry import VehicleGeometry
from litsim_sim.nodes.step_clock import TICK_NS, StepClock
from litsim_sim.ros import messages
from litsim_sim.ros.cdr import stamp_ns
from litsim_sim.ros.endpoints import publisher_on, subscribe
from litsim_sim.ros.frames import fixed_frames
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    DIAGNOSTICS,
    EGO_CONTROL,
    EGO_TRAJECTORY,
    FORECASTS,
    FRAMES,
    RUN_INFO,
    SIGNALS,
    STATUS,
    TF,
    TF_STATIC,
)
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.scenario import Scenario

NODE = "litsim_autoware"
QOS = QoSProfile(depth=1)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATE_S = 0.02  # [s] period of the ego's state between steps, in real time and before the run
OBJECTS_EVERY = 5  # of these periods, that of the objects before the run
NOTE_S = 5.0  # [s] period of lines that say what is waited for
HORIZON_S = 8.0  # [s] of a trajectory that is passed on

STATUS_TOPICS = {
    "velocity": ("/vehicle/status/velocity_status", VelocityReport),
    "steering": ("/vehicle/status/steering_status", SteeringReport),
    "gear": ("/vehicle/status/gear_status", GearReport),
    "control_mode": ("/vehicle/status/control_mode", ControlModeReport),
    "turn_indicators": ("/vehicle/status/turn_indicators_status", TurnIndicatorsReport),
    "hazard_lights": ("/vehicle/status/hazard_lights_status", HazardLightsReport),
    "acceleration": ("/localization/acceleration", AccelWithCovarianceStamped),
    "odometry": ("/localization/kinematic_state", Odometry),
}
"""Topics about the ego, in the order in which they are published: its pose is the last message of a step."""
COMMANDS = {
    "gear": ("/control/command/gear_cmd", GearCommand),
    "turn_indicators": ("/control/command/turn_indicators_cmd", TurnIndicatorsCommand),
    "hazard_lights": ("/control/command/hazard_lights_cmd", HazardLightsCommand),
}
"""Topics of the stack whose commands are reported back."""
CONTROL_MODE_REQUEST = "/control/control_mode_request"
OBJECT_LISTS: dict[str, tuple[Any, Callable[[AgentTable, int], bytes]]] = {
    "tracked_objects": (TrackedObjects, objects.tracked_objects),
    "detected_objects": (DetectedObjects, objects.detected_objects),
}
CLOCK_MESSAGE = Message(*TIME)


class AutowareNode(Node):
    """Answers every step of a run with what Autoware commands.

    Attributes:
        finished: whether the run is over.
    """

    def __init__(self, profile: Profile, goal: tuple[float, float, float] | None = None) -> None:
        """Make it; `goal` is a pose of the box centre [m, m, rad], by default that of the ego's log at its end."""
        super().__init__(NODE)
        self._profile, self._goal = profile, goal
        self.finished = False
        self._begin = time.perf_counter()
        self._info: RunInfo | None = None
        self._table: AgentTable | None = None
        self._signals: SignalStates | None = None
        self._forecasts: deque[Forecast] = deque(maxlen=2)
        self._shown = -1  # newest step that was published
        self._motion: RearAxle | None = None
        self._timeline = Timeline()
        self._ticks = 0  # published before the run
        self._states = 0  # published since the step began
        self._answered = -1  # newest step that was answered
        self._answer: tuple[Any, Any]  # its publisher and message
        self._planned: int | None = None  # newest step that has a trajectory of the stack; -1 before the run
        self._since_plan = 0  # commands since
        self._early: EgoCommand | None = None  # answer by a command that may follow an older trajectory
        self._is_heard = False  # whether the stack has answered since it is ready
        self._start_up: StartUp | None = None
        self._steering = 0.0
        self._reports = {
            "gear": GearReport.DRIVE,
            "control_mode": getattr(ControlModeReport, profile.starts_in.upper()),
            "turn_indicators": TurnIndicatorsReport.DISABLE,
            "hazard_lights": HazardLightsReport.DISABLE,
        }
        self._mrm_state, self._reported, self._noted = MrmState.UNKNOWN, "", time.monotonic()
        self._compute_s: list[float] = []  # of each step, from its agents to the ego's pose
        self._cpu_s: list[float] = []  # of which this thread has used
        self._make_publishers()
        self._make_subscriptions()

    def _make_publishers(self) -> None:
        profile = self._profile
        self._clock_to = Output(self, CLOCK.type, CLOCK.name, CLOCK.qos)
        self._frames = Output(self, TF.type, TF.name, TF.qos) if FRAMES else None
        self._fixed_frames = publisher_on(self, TF_STATIC) if FRAMES else None
        self._diagnostics = publisher_on(self, DIAGNOSTICS)
        self._control_to, self._path_to = publisher_on(self, EGO_CONTROL), publisher_on(self, EGO_TRAJECTORY)
        self._status = {name: Output(self, kind, topic, QOS) for name, (topic, kind) in STATUS_TOPICS.items()}
        self._predicted = self._optional(PredictedObjects, profile.objects)
        self._lists = [
            (Output(self, kind, topic, QOS), write)
            for name, (kind, write) in OBJECT_LISTS.items()
            if (topic := getattr(profile, name))
        ]
        self._lights = self._optional(TrafficLightGroupArray, profile.traffic_signals)
        self._cloud = self._optional(PointCloud2, profile.obstacle_cloud)
        empty = PointCloud2(height=1, is_dense=True, point_step=16)
        empty.header.frame_id = "base_link"
        self._empty_cloud = serialize_message(empty)
        self._latched = [
            (self.create_publisher(type(message), topic, LATCHED), message)
            for topic, message in (
                (profile.initialization_state, LocalizationInitializationState(state=3)),
                (profile.operation_mode, _autonomous()),
            )
            if topic
        ]

    def _make_subscriptions(self) -> None:
        subscribe(self, RUN_INFO, self._on_run_info)
        subscribe(self, AGENTS, self._on_agents)
        subscribe(self, SIGNALS, self._on_signals)
        subscribe(self, FORECASTS, self._on_forecast)
        subscribe(self, STATUS, self._on_status)
        if self._profile.answers == TRAJECTORY:
            self.create_subscription(Trajectory, self._profile.trajectory, self._on_trajectory, QOS)
        else:
            self.create_subscription(Control, self._profile.control, self._on_control, QOS)
            self.create_subscription(Trajectory, self._profile.trajectory, self._on_plan, QOS, raw=True)
        for name, (topic, kind) in COMMANDS.items():
            self.create_subscription(kind, topic, self._taker(name), QOS)
        if self._profile.mrm_state:
            self.create_subscription(MrmState, self._profile.mrm_state, self._on_mrm_state, QOS)
        self.create_service(ControlModeCommand, CONTROL_MODE_REQUEST, self._on_control_mode)

    def _optional(self, kind: Any, topic: str | None) -> Output | None:
        return Output(self, kind, topic, QOS) if topic else None

    def tick(self, now: float) -> float:
        """Publish what is due at `now` of the performance counter [s]; return the time until the next call is due."""
        if self._start_up is None or self._table is None:
            return inf
        if self._timeline.start_ns is None:
            return self._before_the_run(now)
        wait = self._clock.tick(now)
        if wait == inf and self._time_is_heard():  # no time is left for timers of the stack
            self._respond_early()
        if self._realtime and self._motion is not None:
            due = self._step_began + (self._states + 1) * STATE_S
            if now >= due and self._states < STEP_NS * 1e-9 / STATE_S - 1:
                self._states += 1
                after = self._states * STATE_S
                self._show_ego(self._motion.after(after), self._timeline.stamp(self._table.step) + round(after * 1e9))
            wait = min(wait, max(0.0, due - now))
        return wait

    def _before_the_run(self, now: float) -> float:
        """Let time pass at a scene that stands still, until the stack is ready."""
        assert self._start_up is not None and self._table is not None
        table = self._table
        due = int((now - self._begin) * 1e9 / TICK_NS)
        if due > self._ticks:
            self._ticks = due
            self._show_time(now_ns := BEGIN_NS + due * TICK_NS)
            every = round(STATE_S * 1e9 / TICK_NS)
            motion = RearAxle.of(table, self._ego_id, self._geometry.rear_axle_to_centre)
            if due % every == 0 and motion is not None:
                if due // every % OBJECTS_EVERY == 0:
                    still = table.take(table.id != self._ego_id)
                    nothing = np.zeros(len(still))
                    still.speed, still.acceleration, still.yaw_rate = nothing, nothing, nothing
                    self._show_others(still, now_ns)
                self._show_ego(motion.at_rest(), now_ns)
            was_ready = self._start_up.done
            self._start_up.poll(now)
            self._is_heard &= was_ready
            if self._start_up.done and self._is_heard:
                self._release(now_ns)
            else:
                self._note()
        return self._begin + (self._ticks + 1) * TICK_NS * 1e-9 - now

    def _release(self, now_ns: int) -> None:
        """Begin the run: the stack is ready."""
        assert self._table is not None
        self._timeline.release(now_ns)
        for time_ns in range(now_ns + TICK_NS, self._timeline.stamp(0), TICK_NS):
            self._show_time(time_ns)
        self.get_logger().info(f"the stack drives; step 0 is at {self._timeline.stamp(0) * 1e-9:.1f} s of its time")
        self._show_step(self._table)

    def _on_run_info(self, info: RunInfo) -> None:
        if self._info is not None:
            return
        self._info = info
        scenario = Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}")
        self._ego_id, self._realtime = int(info.ego_id), info.mode == "realtime"
        self._perception = Perception(scenario)
        self._geometry = VehicleGeometry.of(scenario.log.table(0), self._ego_id, scenario.vehicle)
        self._light_ids, self._light_groups = objects.lights_of(scenario.signals)
        self._with_signals = SIGNALS.name in info.topics
        self._with_forecasts = FORECASTS.name in info.topics and self._predicted is not None
        bridge = (yaml.safe_load(info.configuration) or {}).get(BRIDGE, {})
        factor = float(bridge.get("real_time_factor", 1.0))
        self._clock = StepClock(
            lambda time_ns: self._show_time(self._timeline.stamp(0) + time_ns),
            self._time_is_heard,
            factor,
        )
        goal = self._goal or log_end(scenario, self._ego_id)
        self._start_up = StartUp(self._calls(*goal))
        for publisher, message in self._latched:
            message.stamp = Clock().clock
            publisher.publish(message)
        if self._fixed_frames is not None:
            self._fixed_frames.publish(fixed_frames(self._geometry.rear_axle_to_centre))

    def _calls(self, x: float, y: float, yaw: float) -> dict[str, Call]:
        """The services that are to be called before the stack drives, to a goal of the box centre."""
        lever = self._geometry.rear_axle_to_centre
        goal = Pose()
        goal.position.x, goal.position.y = x - lever * cos(yaw), y - lever * sin(yaw)
        goal.orientation.z, goal.orientation.w = sin(0.5 * yaw), cos(0.5 * yaw)

        def initialize() -> InitializeLocalization.Request:
            pose = PoseWithCovarianceStamped(header=self._header())
            motion = RearAxle.of(self._table, self._ego_id, lever) if self._table else None
            if motion is not None:
                place, turn = pose.pose.pose.position, pose.pose.pose.orientation
                place.x, place.y = motion.x, motion.y
                turn.z, turn.w = sin(0.5 * motion.yaw), cos(0.5 * motion.yaw)
            return InitializeLocalization.Request(pose=[pose])

        kinds: dict[str, tuple[Any, Callable[[], Any]]] = {
            "initialize": (InitializeLocalization, initialize),
            "clear_route": (ClearRoute, ClearRoute.Request),
            "set_route": (SetRoutePoints, lambda: SetRoutePoints.Request(header=self._header(), goal=goal)),
            "engage": (ChangeOperationMode, ChangeOperationMode.Request),
        }
        calls = {}
        for name, (kind, request) in kinds.items():
            if service := getattr(self._profile, name):
                client = self.create_client(kind, service)
                calls[name] = Call(service, client.service_is_ready, _caller(client, request))
        return calls

    def _header(self) -> Any:
        """Header at the present time of the stack, in frame map."""
        header = messages.header(0)
        header.stamp.sec, header.stamp.nanosec = divmod(BEGIN_NS + self._ticks * TICK_NS, 10**9)
        return header

    def _on_agents(self, message: AgentStates) -> None:
        if self._info is None or message.run_id != self._info.run_id:
            return
        begin = time.perf_counter()
        again = self._table is not None and message.step == self._table.step
        if again and message.step == self._answered:
            publisher, answer = self._answer
            publisher.publish(answer)  # the bridge asks again
            return
        if again:
            self._respond_early()
        self._table = AgentTable.of_message(message)
        self._show_if_complete(begin, patient=not again)

    def _on_signals(self, message: SignalStates) -> None:
        if self._info is not None and message.run_id == self._info.run_id:
            self._signals = message
            self._show_if_complete(time.perf_counter())

    def _on_forecast(self, message: JointForecast) -> None:
        if self._info is not None and message.run_id == self._info.run_id and self._with_forecasts:
            self._forecasts.append(forecast_of(message))
            self._show_if_complete(time.perf_counter())

    def _show_if_complete(self, begin: float, *, patient: bool = True) -> None:
        """Publish the newest step once all of it is here; unless `patient`, without what is missing of forecasts.

        The paths of objects are of the forecast of the step before: that of a step comes while the stack answers it.
        """
        table = self._table
        if table is None or self._timeline.start_ns is None or table.step == self._answered:
            return
        if patient and table.step == self._shown:
            return
        if self._with_signals and (self._signals is None or self._signals.step != table.step):
            return
        newest = self._forecasts[-1].step if self._forecasts else -1
        if self._with_forecasts and newest < table.step - 1 and patient and not self._realtime:
            return
        cpu = time.thread_time()
        self._show_step(table)
        self._compute_s.append(time.perf_counter() - begin)
        self._cpu_s.append(time.thread_time() - cpu)

    def _show_step(self, table: AgentTable) -> None:
        """Publish a step; the ego's pose last, so that whoever answers it has the rest."""
        stamp_ns = self._timeline.stamp(table.step)
        self._step_began, self._states, self._shown = time.perf_counter(), 0, table.step
        self._clock.step(table.step, self._step_began)
        self._motion = RearAxle.of(table, self._ego_id, self._geometry.rear_axle_to_centre)
        told = self._perception.of(table)
        self._show_others(told.take(told.id != self._ego_id), stamp_ns)
        if self._motion is None:  # it has left, and this is the last step
            self._respond(table.step, EgoCommand(table.step))
            return
        angle = self._motion.steering(self._geometry.wheelbase)
        self._steering = self._steering if angle is None else angle
        self._show_ego(self._motion, stamp_ns)
        self._report(table.step)

    def _time_is_heard(self) -> bool:
        """Returns whether anybody listens to the stack's time but the recorder, which has no use of it."""
        return self._clock_to.listeners > 1

    def _show_time(self, time_ns: int) -> None:
        if self._time_is_heard():
            self._clock_to.publish(CLOCK_MESSAGE.data(stamped(time_ns)))

    def _show_others(self, others: AgentTable, stamp_ns: int) -> None:
        """Publish all agents but the ego, what signals show, and that there is nothing else."""
        if self._predicted is not None and self._predicted.listeners:
            self._predicted.publish(objects.predicted_objects(others, stamp_ns, self._forecast_for(others.step)))
        for output, write in self._lists:
            if output.listeners:
                output.publish(write(others, stamp_ns))
        if self._lights is not None and self._lights.listeners and self._signals is not None:
            states = np.frombuffer(self._signals.state, np.uint8)
            self._lights.publish(objects.traffic_lights(self._light_ids, states[self._light_groups], stamp_ns))
        if self._cloud is not None and self._cloud.listeners:
            begin = len(ENCAPSULATION)
            stamp = CLOCK_MESSAGE.data(stamped(stamp_ns))
            self._cloud.publish(stamp + self._empty_cloud[begin + 8 :])

    def _forecast_for(self, step: int) -> Forecast | None:
        """The forecast whose paths the objects of a step have: that of the step before, or an earlier one."""
        return next((forecast for forecast in reversed(self._forecasts) if forecast.step < step), None)

    def _show_ego(self, motion: RearAxle, stamp_ns: int) -> None:
        """Publish the ego: its frame, the status of the vehicle, its pose."""
        if self._frames is not None:
            self._frames.publish(motion.transform(stamp_ns))
        write: dict[str, Callable[[int], bytes]] = {
            "velocity": motion.velocity,
            "steering": partial(vehicle.steering_report, self._steering),
            "acceleration": motion.accel,
            "odometry": motion.odometry,
        }
        write |= {name: partial(vehicle.report, value) for name, value in self._reports.items()}
        for name, output in self._status.items():
            if output.listeners:
                output.publish(write[name](stamp_ns))

    def _on_control(self, message: Control) -> None:
        self._since_plan += 1
        step = self._step_answered(message.stamp)
        if step is None or self._motion is None:
            return
        acceleration, angle = float(message.longitudinal.acceleration), float(message.lateral.steering_tire_angle)
        answer = vehicle.command(step, acceleration, angle, self._motion.speed, self._geometry.wheelbase)
        if self._realtime or self._planned is None or (self._planned >= step and self._since_plan > 1):
            self._respond(step, answer)
        else:
            self._early = answer

    def _on_plan(self, data: bytes) -> None:
        """Note that a step has a trajectory: in lock-step, the next command but one has been computed from it.

        Planner and controller are processes of their own; without this, which trajectory a command follows would depend
        on the load of the machine.
        """
        if self._table is not None:
            step = min(self._timeline.step_of(stamp_ns(data)), self._table.step)
            if self._planned is None or step > self._planned:
                self._planned, self._since_plan = step, 0

    def _respond_early(self) -> None:
        """Answer without the trajectory of the step where it has not come in time, if there is a command."""
        if self._early is not None and self._early.step > self._answered:
            self._respond(self._early.step, self._early)

    def _on_trajectory(self, message: Trajectory) -> None:
        step = self._step_answered(message.header.stamp)
        if step is None or self._motion is None:
            return
        path = Path(header=messages.header(step))
        if len(message.points) > 1:
            points = np.array([(p.pose.position.x, p.pose.position.y) for p in message.points])
            speeds = np.array([p.longitudinal_velocity_mps for p in message.points])
            lever = self._geometry.rear_axle_to_centre
            path.poses = poses(vehicle.future_of(points, speeds, self._motion, lever, HORIZON_S), step)
        self._publish_answer(step, self._path_to, path)

    def _step_answered(self, stamp: Any) -> int | None:
        """The step that a message of the stack answers; None for one that has an answer, or before the run."""
        self._is_heard = True
        if self._timeline.start_ns is None or self._table is None:
            return None
        step = min(self._timeline.step_of(stamp.sec * 10**9 + stamp.nanosec), self._table.step)
        return step if step > self._answered else None

    def _respond(self, step: int, answer: EgoCommand) -> None:
        assert self._info is not None
        self._publish_answer(step, self._control_to, messages.ego_to_message(answer, self._info.run_id))

    def _publish_answer(self, step: int, publisher: Publisher, message: Any) -> None:
        """Answer a step; in lock-step its time then passes while the bridge makes the next one."""
        publisher.publish(message)
        self._answered, self._answer = step, (publisher, message)
        if not self._realtime and step == self._clock.current:
            self._clock.finish()

    def _taker(self, name: str) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            if message.command:  # zero is no command
                self._reports[name] = message.command

        return take

    def _on_mrm_state(self, message: MrmState) -> None:
        self._mrm_state = message.state

    def _on_control_mode(
        self, request: ControlModeCommand.Request, response: ControlModeCommand.Response
    ) -> ControlModeCommand.Response:
        if request.mode:  # zero is no command
            self._reports["control_mode"] = request.mode
        response.success = True
        return response

    def _on_status(self, status: StageStatus) -> None:
        ended = status.stage == BRIDGE and status.state in (StageState.FINISHED, StageState.FAILED)
        if ended and self._info is not None and status.run_id == self._info.run_id:
            self.finished = True
            if self._compute_s:
                wall, cpu = (1e3 * float(np.median(times)) for times in (self._compute_s, self._cpu_s))
                self.get_logger().info(
                    f"{len(self._compute_s) + 1} steps, each published in {wall:.2f} ms (median), {cpu:.2f} ms of CPU"
                )

    def _report(self, step: int) -> None:
        """Tell lights, gear and minimum-risk state on /diagnostics, which is recorded, where they have changed."""
        values = {**self._reports, "mrm_state": self._mrm_state, "profile": self._profile.description}
        if (text := str(values)) != self._reported:
            self._reported = text
            pairs = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
            status = DiagnosticStatus(name="litsim: autoware", values=pairs)
            self._diagnostics.publish(DiagnosticArray(header=messages.header(step), status=[status]))

    def _note(self) -> None:
        """Say now and then what is waited for."""
        assert self._start_up is not None
        if time.monotonic() > self._noted + NOTE_S:
            self._noted = time.monotonic()
            what = self._profile.trajectory if self._profile.answers == TRAJECTORY else self._profile.control
            self.get_logger().info(f"waiting for {self._start_up.waiting or f'a message on {what}'}")


def forecast_of(message: JointForecast) -> Forecast:
    """The forecast of a message, of the most probable manoeuvre of each agent."""
    agents = len(message.id)
    probability = np.asarray(message.maneuver_probability, np.float64).reshape(agents, -1 if agents else 0)
    return Forecast(
        step=message.step,
        dt=message.dt,
        id=np.asarray(message.id, np.int64),
        mean=np.asarray(message.mean).reshape(agents, -1 if agents else 0, 2),
        yaw=np.asarray(message.yaw).reshape(agents, -1 if agents else 0),
        probability=probability.max(axis=1, initial=0.0) if probability.shape[1] else np.ones(agents),
        valid=np.array(message.valid, np.bool_),
    )


def poses(future: FloatArray, step: int) -> list[PoseStamped]:
    """Poses of a path for the ego port: (k, 3) time after the step [s], x, y [m]."""
    stamped_poses = []
    for after, x, y in future.tolist():
        pose = PoseStamped(header=messages.header(step))
        time_ns = step * STEP_NS + round(after * 1e9)
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(time_ns, 10**9)
        pose.pose.position.x, pose.pose.position.y = x, y
        stamped_poses.append(pose)
    return stamped_poses


def log_end(scenario: Scenario, ego_id: int) -> tuple[float, float, float]:
    """Pose of the ego's box centre where its log ends [m, m, rad]."""
    log = scenario.log
    table = log.table(min(int(log.last_step[log.ids == ego_id][0]), scenario.total_steps))
    row = table.row(ego_id)
    return float(table.x[row]), float(table.y[row]), float(table.yaw[row])


def _caller(client: Any, request: Callable[[], Any]) -> Callable[[], Any]:
    """A function that calls a service with a new request."""
    return lambda: client.call_async(request())


def _autonomous() -> OperationModeState:
    return OperationModeState(
        mode=OperationModeState.AUTONOMOUS,
        is_autoware_control_enabled=True,
        is_stop_mode_available=True,
        is_autonomous_mode_available=True,
    )
