"""The bridge: steps the world, publishes every step, and waits for the answers to it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import yaml
from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from tqdm import tqdm

from litsim_sim.errors import InputError
from litsim_sim.lockstep import Gate
from litsim_sim.recording import STEP_S
from litsim_sim.ros import messages
from litsim_sim.ros.stage import check_parameters, process, reason, serve
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
FAREWELL_S = 5.0  # [s] that the recorder gets to close its file
NOTE_PERIOD = 5.0  # [s] between two lines in the log that say the same


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
        scenario_name, ego, policy = (
            str(declare(name, value).value)
            for name, value in (("scenario", "demo"), ("ego", "idm"), ("policy", "litsim"))
        )
        overrides = {
            name: int(declare(parameter, -1).value) for parameter, name in (("ego_id", "ego"), ("seed", "seed"))
        }
        check_parameters(self)
        self._check("mode", self._mode, ("lockstep", "realtime"))
        self._check("on_missing", self._on_missing, ("stop", "hold"))
        self._check("progress", self._progress, ("bar", "lines", "none"))
        self._check("ego", ego, EGOS)
        self._check("policy", policy, POLICIES)
        for name in ("answer_timeout_s", "handshake_timeout_s", "external_timeout_s"):
            if not 0.0 < self.get_parameter(name).value < np.inf:
                raise InputError(f"{STAGE}: parameter {name} is {self.get_parameter(name).value}, expected seconds > 0")
        scenario = Scenario.load(scenario_name, **{name: value for name, value in overrides.items() if value >= 0})
        self.plan = RunPlan(scenario, ego, policy)
        config = WorldConfig(guard_entries=self.plan.policy != "replay")
        self.world = World(scenario, config, SumoMirror(scenario.net_path, scenario.seed))
        self._run_id = self.plan.run_id
        self._ready: set[str] = set()
        self._failures: list[str] = []
        self._heard: dict[str, int] = {}  # last step that each stage is known to have answered
        self._noted = ("", 0.0)
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
        except BaseException as error:
            self._say(
                StageStatus.FAILED, self._gate.step, text=str(error) if isinstance(error, RunFailed) else reason(error)
            )
            self._farewell()
            raise
        finally:
            self.world.close()

    def _check(self, parameter: str, value: str, allowed: tuple[str, ...]) -> None:
        if value not in allowed:
            raise InputError(f"{STAGE}: parameter {parameter} is {value!r}, expected one of {', '.join(allowed)}")

    def _handshake(self) -> None:
        self._publishers[RUN_INFO].publish(self._run_info())
        self._publishers[EGO_ROUTE].publish(self._route())
        begin = time.monotonic()
        while waiting := sorted(set(self.plan.stages) - self._ready):
            since = time.monotonic() - begin
            if since > self._handshake_timeout:
                raise RunFailed(
                    f"{', '.join(waiting)}: no READY for run {self._run_id} on {STATUS.name} within "
                    f"{self._handshake_timeout:g} s; is the node running in {self._domain}?"
                )
            if since > RESEND:
                self._note(f"waiting for READY from {', '.join(waiting)} on {STATUS.name}")
            self._publishers[HELLO].publish(Hello(header=messages.header(0), run_id=self._run_id))
            self._spin_until(lambda: set(self.plan.stages) <= self._ready, time.perf_counter() + HELLO_PERIOD)

    def _loop(self) -> None:
        total, start = self.plan.scenario.total_steps, time.perf_counter()
        controls, ego = ControlTable.empty(0), EgoCommand(0)
        table, compute, due = self.world.reset(), 0.0, 0.0
        with tqdm(total=total, unit="step", disable=self._progress != "bar") as bar:
            for step in range(total + 1):
                # A pace that was lost by more than half a step is not made up for.
                due = max(due + STEP_S, time.perf_counter() + 0.5 * STEP_S)
                self._round(table, due)
                if step == 0:
                    start = due = time.perf_counter()  # meeting everybody at step 0 is no part of the run's pace
                controls, ego = self._take(step, controls, ego)
                self._publishers[TIMING].publish(
                    messages.status(self._run_id, STAGE, StageStatus.RUNNING, step, compute)
                )
                if self._mode == "realtime":
                    self._spin_until(lambda: False, due)
                if step < total:
                    before = time.perf_counter()
                    table = self._step(controls, ego)
                    compute = time.perf_counter() - before
                bar.update(step > 0)
                if self._progress == "lines" and (step % 10 == 0 or step == total):
                    print(f"step {step} of {total}", flush=True)
        wall = time.perf_counter() - start
        self._await_recorder(total)
        self._say(StageStatus.FINISHED, total, wall, yaml.safe_dump(self._summary(), sort_keys=False))
        self._farewell()
        if "recorder" in self._ready and not self._recorder_done:
            raise RunFailed(f"recorder: no FINISHED on {STATUS.name} within {FAREWELL_S:g} s of the end of the run")
        self._raise_failures()

    def _round(self, table: AgentTable, due: float) -> None:
        """Publish a step and wait for the answers to it, in real time until `due`."""
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
        give_up = time.perf_counter() + self._timeout(step)
        if self._mode == "realtime" and step > 0:
            give_up = due
        while True:
            for topic, message in publications:
                self._publishers[topic].publish(message)
            until = min(give_up, time.perf_counter() + resend)
            if self._spin_until(lambda: self._answered(step), until) or time.perf_counter() >= give_up:
                return
            self._ask_around(step)

    def _timeout(self, step: int) -> float:
        """How long the answers to a step are waited for [s]; an external ego is met at step 0."""
        if step > 0:
            return self._answer_timeout
        return self._external_timeout if self.plan.ego == "external" else self._handshake_timeout

    def _answered(self, step: int) -> bool:
        """Whether all answers to `step` are in, and the recorder is not too far behind (at step 0: not at all)."""
        return not self._gate.missing and self._recorded >= max(0, step - RECORDER_WINDOW)

    def _ask_around(self, step: int) -> None:
        """Something is missing: say so, and learn from the timing of the stages, who repeat it, which one is silent."""
        if STAGE not in self._heard:
            self._heard[STAGE] = step
            self.create_subscription(TIMING.type, TIMING.name, self._on_timing, TIMING.qos)
        waiting = self._gate.missing or [f"{RECORDED.name} of the recorder"]
        if step > 0 or self.plan.ego == "external":
            self._note(f"step {step}: waiting for {', '.join(waiting)}")

    def _take(self, step: int, controls: ControlTable, ego: EgoCommand) -> tuple[ControlTable, EgoCommand]:
        """The answers to `step`; where one is missing, the newest that there is counts on, or the run ends."""
        missing = self._gate.missing
        if not missing and not self._answered(step):
            raise RunFailed(
                f"recorder: has confirmed {self._confirmed()} on {RECORDED.name} at step {step}, expected at most "
                f"{RECORDER_WINDOW} steps behind"
            )
        if missing and (step == 0 or (self._mode == "lockstep" and self._on_missing == "stop")):
            raise RunFailed(
                f"no answer to step {step} on {', '.join(missing)} within {self._timeout(step):g} s{self._silent(step)}"
            )
        for name in missing:
            self._missed[name] = self._missed.get(name, 0) + 1
        if missing:  # the recorder need not wait for them
            self._say(StageStatus.RUNNING, step, text=f"missed {', '.join(missing)}")
        newest = self._gate.newest
        name = ""
        try:
            if (name := CONTROLS.name) in newest:
                controls = self._checked(messages.controls_from_message(newest[name]))
            if (name := EGO_CONTROL.name) in newest:
                ego = messages.ego_from_message(newest[name])
        except ValueError as error:
            raise RunFailed(f"the answer to step {step} on {name} cannot be used: {error}") from error
        return replace(controls, step=step), replace(ego, step=step)

    def _checked(self, controls: ControlTable) -> ControlTable:
        """Controls as the world expects them from any policy.

        Raises:
            ValueError: they are not.
        """
        lengths = {len(getattr(controls, field.name)) for field in fields(controls) if field.name != "step"}
        if len(lengths) > 1:
            raise ValueError(f"its arrays have {sorted(lengths)} values, expected equally many")
        if (np.diff(controls.id) <= 0).any() or self.plan.scenario.ego_id in controls.id:
            raise ValueError(f"its ids are {controls.id.tolist()}, expected ascending ones, without the ego's")
        return controls

    def _step(self, controls: ControlTable, ego: EgoCommand) -> AgentTable:
        try:
            return self.world.step(controls, ego)
        except ValueError as error:
            raise RunFailed(str(error)) from error

    def _silent(self, step: int) -> str:
        """In words, which stages have not answered `step`, as far as they have been heard of."""
        silent = [s for s in self.plan.stages if s != "recorder" and self._heard.get(s, -1) < step]
        if self._heard.keys() <= {STAGE}:
            silent = []  # nobody was heard: nothing can be said of anybody
        if self.plan.ego == "external" and EGO_CONTROL.name in self._gate.missing:
            silent.append(f"the external ego (is it running in {self._domain}?)")
        return f"; silent: {', '.join(silent)}" if silent else ""

    @property
    def _domain(self) -> str:
        return f"ROS_DOMAIN_ID {self.context.get_domain_id()}"

    def _confirmed(self) -> str:
        return "nothing" if self._recorded < 0 else f"only step {self._recorded}"

    def _await_recorder(self, last: int) -> None:
        if "recorder" in self.plan.stages:
            until = time.perf_counter() + self._answer_timeout
            if not self._spin_until(lambda: self._recorded >= last, until):
                raise RunFailed(f"recorder: has confirmed {self._confirmed()} of {last} on {RECORDED.name}")

    def _farewell(self) -> None:
        """Let the recorder close its file."""
        until = time.monotonic() + FAREWELL_S
        while "recorder" in self._ready and not self._recorder_done and time.monotonic() < until:
            serve(self._executor)

    def _spin_until(self, done: Callable[[], bool], until: float) -> bool:
        """Serve callbacks until `done`, or until `until` of the performance counter; returns `done()`."""
        while not done():
            left = until - time.perf_counter()
            if left <= 0:
                return False
            serve(self._executor, left)
            self._raise_failures()
        return True

    def _raise_failures(self) -> None:
        if self._failures:
            raise RunFailed("; ".join(self._failures))

    def _note(self, text: str) -> None:
        """Say in the log what is going on, the same thing now and then."""
        last, when = self._noted
        if text != last or time.monotonic() > when + NOTE_PERIOD:
            self._noted = (text, time.monotonic())
            self.get_logger().info(text)

    def _answer_to(self, name: str) -> Callable[[Any], None]:
        return lambda message: self._gate.offer(name, message.run_id, message.step, message)

    def _on_status(self, status: StageStatus) -> None:
        if status.run_id != self._run_id or status.stage == STAGE:
            return
        if status.state == StageStatus.READY:
            self._ready.add(status.stage)
        elif status.state == StageStatus.FAILED:
            self._failures.append(f"{status.stage}: {status.text}")
        if status.stage == "recorder" and status.state in (StageStatus.FINISHED, StageStatus.FAILED):
            self._recorder_done = True

    def _on_timing(self, status: StageStatus) -> None:
        if status.run_id == self._run_id:
            self._heard[status.stage] = max(status.step, self._heard.get(status.stage, -1))

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


def main() -> None:
    """Entry point of ``ros2 run litsim_sim bridge``."""
    with process():
        try:
            BridgeNode().run()
        except RunFailed as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(1)


if __name__ == "__main__":
    main()
