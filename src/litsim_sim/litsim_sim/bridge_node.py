"""The bridge: steps the world, publishes every step, and waits for the answers to it."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import rclpy
import yaml
from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from litsim_sim.errors import InputError
from litsim_sim.lockstep import Gate
from litsim_sim.recording import STEP_S
from litsim_sim.ros import messages
from litsim_sim.ros.topics import (
    AGENTS,
    CLOCK,
    CONTROLS,
    EGO_CONTROL,
    EGO_ROUTE,
    EGO_STATE,
    FORECASTS,
    HELLO,
    RECORDED,
    RECORDER_WINDOW,
    RUN_INFO,
    STATUS,
    TAKEOVERS,
    TIMING,
)
from litsim_sim.run_info import EGOS, POLICIES, RunPlan, versions
from litsim_sim.scenario import Scenario
from litsim_sim.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.sumo import SumoMirror
from litsim_sim.world import World, WorldConfig

STAGE = "bridge"
ROUTE_LENGTH = 1000.0  # [m] of the route that the ego is given
HELLO_PERIOD = 0.1  # [s] between the greetings of the handshake
RESEND_FIRST, RESEND = 0.25, 1.0  # [s] without all answers after which step 0, or any other, is published again


SIGNAL_PERIOD = 0.2  # [s] for which Ctrl-C may go unnoticed: waiting for DDS does not wake up for signals


class RunFailed(Exception):
    """The run cannot go on; the message says what was waited for, and where."""


class BridgeNode(Node):
    """One run of one scenario: `run` returns when it is over and recorded."""

    def __init__(self) -> None:
        super().__init__(STAGE)
        declare = self.declare_parameter
        self._mode = str(declare("mode", "lockstep").value)
        self._on_missing = str(declare("on_missing", "stop").value)
        self._answer_timeout = float(declare("answer_timeout_s", 5.0).value)
        self._handshake_timeout = float(declare("handshake_timeout_s", 20.0).value)
        self._external_timeout = float(declare("external_timeout_s", 60.0).value)
        self._progress = str(declare("progress", "bar").value)
        self.plan = _plan(self)
        for name, value, allowed in (
            ("mode", self._mode, ("lockstep", "realtime")),
            ("on_missing", self._on_missing, ("stop", "hold")),
            ("progress", self._progress, ("bar", "lines", "none")),
        ):
            if value not in allowed:
                raise InputError(f"bridge: parameter {name} is {value!r}, expected one of {allowed}")
        scenario = self.plan.scenario
        config = WorldConfig(guard_entries=self.plan.policy != "replay")
        self.world = World(scenario, config, SumoMirror(scenario.net_path, scenario.seed))
        self._run_id = self.plan.run_id
        self._ready: set[str] = set()
        self._failures: list[str] = []
        self._recorded = -1
        self._recorder_done = False
        self._missed: dict[str, int] = {}
        answers = {CONTROLS.name: CONTROLS} if self.plan.policy != "replay" else {}
        answers[EGO_CONTROL.name] = EGO_CONTROL
        self._gate = Gate(self._run_id, tuple(answers))
        self._publishers = {
            t: self.create_publisher(t.type, t.name, t.qos)
            for t in (RUN_INFO, HELLO, STATUS, TIMING, CLOCK, AGENTS, EGO_STATE, EGO_ROUTE)
        }
        for topic in answers.values():
            self.create_subscription(topic.type, topic.name, self._answer_to(topic.name), topic.qos)
        self.create_subscription(STATUS.type, STATUS.name, self._on_status, STATUS.qos)
        self.create_subscription(RECORDED.type, RECORDED.name, self._on_recorded, RECORDED.qos)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def run(self) -> None:
        """Handshake, every step, farewell.

        Raises:
            RunFailed: a stage failed or did not answer; everybody has been told.
        """
        try:
            self._handshake()
            self._loop()
        except (RunFailed, InputError, ValueError) as error:
            self._say(StageStatus.FAILED, self.world_step, text=str(error))
            self._farewell()
            raise RunFailed(str(error)) from error
        except (KeyboardInterrupt, ExternalShutdownException):
            self._say(StageStatus.FAILED, self.world_step, text="interrupted")
            self._farewell()
            raise
        finally:
            self.world.close()

    @property
    def world_step(self) -> int:
        """Step that was published last."""
        return self._gate.step

    def _handshake(self) -> None:
        info = self._run_info()
        self._publishers[RUN_INFO].publish(info)
        route = self._route()
        self._publishers[EGO_ROUTE].publish(route)
        deadline = time.monotonic() + self._handshake_timeout
        while waiting := sorted(set(self.plan.stages) - self._ready):
            if time.monotonic() > deadline:
                raise RunFailed(
                    f"{', '.join(waiting)}: no READY for run {self._run_id} on {STATUS.name} within "
                    f"{self._handshake_timeout:g} s; is the node running in ROS_DOMAIN_ID of the bridge?"
                )
            self._publishers[HELLO].publish(Hello(header=messages.header(0), run_id=self._run_id))
            self._spin_until(lambda: set(self.plan.stages) <= self._ready, time.monotonic() + HELLO_PERIOD)

    def _loop(self) -> None:
        total, start = self.plan.scenario.total_steps, time.perf_counter()
        controls, ego = ControlTable.empty(0), EgoCommand(0)
        bar = tqdm(total=total, unit="step", disable=self._progress != "bar")
        table, compute = self.world.reset(), 0.0
        for step in range(total + 1):
            deadline = start + step * STEP_S
            self._round(table, deadline)
            if step == 0:
                start = time.perf_counter()  # meeting everybody at step 0 is no part of the run's pace
            controls, ego = self._take(step, controls, ego)
            self._publishers[TIMING].publish(
                messages.status(self._run_id, STAGE, StageStatus.RUNNING, step, compute)
            )
            if self._mode == "realtime" and step > 0:
                self._spin_until(lambda: False, deadline, time.perf_counter)
            if step < total:
                before = time.perf_counter()
                table = self.world.step(controls, ego)
                compute = time.perf_counter() - before
            bar.update(step > 0)
            if self._progress == "lines" and (step % 10 == 0 or step == total):
                print(f"step {step} of {total}", flush=True)
        bar.close()
        wall = time.perf_counter() - start
        self._await_recorder(total)
        self._say(StageStatus.FINISHED, total, wall, yaml.safe_dump(self._summary(), sort_keys=False))
        self._farewell()

    def _round(self, table: AgentTable, deadline: float) -> None:
        """Publish a step and wait for the answers to it."""
        step = table.step
        self._gate.open(step)
        publications = [
            (CLOCK, Clock(clock=messages.stamp(step))),
            (
                AGENTS,
                messages.agents_to_message(
                    table, self._run_id, self.plan.scenario.total_steps, self.plan.scenario.ego_id
                ),
            ),
            (EGO_STATE, messages.ego_odometry(table, self.plan.scenario.ego_id)),
        ]
        resend = RESEND_FIRST if step == 0 else RESEND
        first_timeout = self._external_timeout if self.plan.ego == "external" else self._handshake_timeout
        give_up = time.perf_counter() + (first_timeout if step == 0 else self._answer_timeout)
        if self._mode == "realtime" and step > 0:
            give_up = deadline
        while True:
            for topic, message in publications:
                self._publishers[topic].publish(message)
            until = min(give_up, time.perf_counter() + resend)
            if self._spin_until(lambda: self._answered(step), until, time.perf_counter):
                return
            if time.perf_counter() >= give_up:
                return

    def _answered(self, step: int) -> bool:
        """Whether all answers to `step` are in, and the recorder is not too far behind (at step 0: not at all)."""
        return not self._gate.missing and self._recorded >= max(0, step - RECORDER_WINDOW)

    def _take(self, step: int, controls: ControlTable, ego: EgoCommand) -> tuple[ControlTable, EgoCommand]:
        """The answers to `step`; what is missing is held from the step before and counted, or ends the run."""
        missing = self._gate.missing
        if not missing and not self._answered(step):
            raise RunFailed(f"recorder: has confirmed only step {self._recorded} on {RECORDED.name} at step {step}")
        if missing and self._mode == "lockstep" and (self._on_missing == "stop" or step == 0):
            raise RunFailed(f"no answer to step {step} on {', '.join(missing)} within {self._answer_timeout:g} s")
        for name in missing:
            self._missed[name] = self._missed.get(name, 0) + 1
        answers = self._gate.answers
        if CONTROLS.name in answers:
            controls = messages.controls_from_message(answers[CONTROLS.name])
        if EGO_CONTROL.name in answers:
            ego = messages.ego_from_message(answers[EGO_CONTROL.name])
        return replace(controls, step=step), replace(ego, step=step)

    def _await_recorder(self, last: int) -> None:
        if "recorder" in self.plan.stages:
            until = time.monotonic() + self._answer_timeout
            if not self._spin_until(lambda: self._recorded >= last, until):
                raise RunFailed(f"recorder: has confirmed only step {self._recorded} of {last} on {RECORDED.name}")

    def _farewell(self) -> None:
        """Let the recorder close its file."""
        if "recorder" in self._ready:
            self._failures.clear()
            self._spin_until(lambda: self._recorder_done, time.monotonic() + self._answer_timeout)

    def _spin_until(
        self, done: Callable[[], bool], until: float, clock: Callable[[], float] = time.monotonic
    ) -> bool:
        """Serve callbacks until `done`, or until `clock` passes `until`; returns `done()`."""
        while not done():
            left = until - clock()
            if left <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(left, SIGNAL_PERIOD))
            if self._failures:
                raise RunFailed("; ".join(self._failures))
        return True

    def _answer_to(self, name: str) -> Callable[[Any], None]:
        return lambda message: self._gate.offer(name, message.run_id, message.step, message)

    def _on_status(self, status: StageStatus) -> None:
        if status.run_id != self._run_id or status.stage == STAGE:
            return
        if status.state == StageStatus.READY:
            self._ready.add(status.stage)
        elif status.stage == "recorder" and status.state == StageStatus.FINISHED:
            self._recorder_done = True
        elif status.state == StageStatus.FAILED:
            self._failures.append(f"{status.stage}: {status.text}")

    def _on_recorded(self, status: StageStatus) -> None:
        if status.run_id == self._run_id:
            self._recorded = max(self._recorded, status.step)

    def _say(self, state: int, step: int, compute_time: float = 0.0, text: str = "") -> None:
        status = messages.status(self._run_id, STAGE, state, max(0, step), compute_time, text)
        self._publishers[STATUS].publish(status)

    def _summary(self) -> dict[str, Any]:
        """What only the bridge knows, for the record."""
        return {"missed": self._missed, "stale": self._gate.stale} | self.world.summary()

    def _route(self) -> Any:
        scenario = self.plan.scenario
        table = scenario.log.table(0)
        row = np.array([table.row(scenario.ego_id)])
        at = scenario.lane_map.nearest(table.x[row], table.y[row], table.yaw[row])
        return messages.route_path(scenario.lane_map.path_from(int(at.lane[0]), float(at.s[0]), ROUTE_LENGTH), 0)

    def _run_info(self) -> RunInfo:
        scenario = self.plan.scenario
        per_step = (
            (CLOCK, AGENTS, EGO_STATE)
            + (() if self.plan.policy == "replay" else (FORECASTS, TAKEOVERS, CONTROLS))
            + (EGO_CONTROL,)
        )
        parameters = {name: p.value for name, p in sorted(self._parameters.items()) if name != "use_sim_time"}
        return RunInfo(
            header=messages.header(0),
            run_id=self._run_id,
            scenario=scenario.name,
            scenario_yaml=scenario.to_yaml(),
            ego=self.plan.ego,
            policy=self.plan.policy,
            ego_id=scenario.ego_id,
            seed=scenario.seed,
            total_steps=scenario.total_steps,
            history_steps=scenario.history_steps,
            dt=STEP_S,
            mode=self._mode,
            stages=list(self.plan.stages),
            topics=[topic.name for topic in per_step],
            configuration=yaml.safe_dump({STAGE: parameters}),
            versions=yaml.safe_dump(versions()),
        )


def _plan(node: Node) -> RunPlan:
    """The run that the parameters ask for."""
    name = str(node.declare_parameter("scenario", "demo").value)
    ego = str(node.declare_parameter("ego", "idm").value)
    policy = str(node.declare_parameter("policy", "litsim").value)
    ego_id = int(node.declare_parameter("ego_id", -1).value)
    seed = int(node.declare_parameter("seed", -1).value)
    for parameter, value, allowed in (("ego", ego, EGOS), ("policy", policy, POLICIES)):
        if value not in allowed:
            raise InputError(f"bridge: parameter {parameter} is {value!r}, expected one of {', '.join(allowed)}")
    overrides = {key: value for key, value in (("ego", ego_id), ("seed", seed)) if value >= 0}
    return RunPlan(Scenario.load(name, **overrides), ego, policy)


def main() -> None:
    """Entry point of ``ros2 run litsim_sim bridge``."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, lambda *_: _interrupt())
    try:
        BridgeNode().run()
    except RunFailed as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        rclpy.try_shutdown()


def _interrupt() -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
