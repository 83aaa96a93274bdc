"""The bridge: steps the world, publishes every step, and waits for the answers to it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import yaml
from litsim_msgs.msg import Hello, StageStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from tqdm import tqdm

from litsim_sim.core.lockstep import RECORDER_WINDOW, Gate
from litsim_sim.core.scene import STEP_S, AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE as STAGE
from litsim_sim.ego_port.answer import Interface
from litsim_sim.ego_port.port import COUNTS, AnswerInvalid, EgoPort, Level, ego_state
from litsim_sim.nodes import diagnostics
from litsim_sim.nodes.bridge_options import bridge_stage
from litsim_sim.nodes.broadcast import Broadcast, run_info
from litsim_sim.nodes.diagnostics import Diagnostics
from litsim_sim.ros import messages
from litsim_sim.ros.ego_port import subscribe
from litsim_sim.ros.parameters import parameters, read_parameters
from litsim_sim.ros.stage import process, reason, serve
from litsim_sim.ros.topics import CONTROLS, EGO_APPLIED, HELLO, RECORDED, STATUS, TIMING
from litsim_sim.scenario.run_info import EXTERNAL
from litsim_sim.world.sumo import SumoMirror
from litsim_sim.world.world import World, WorldConfig

HELLO_PERIOD = 0.1  # [s] between the greetings of the handshake
RESEND_FIRST, RESEND = 0.25, 1.0  # [s] without all answers after which step 0, or any other, is published again
FAREWELL_S = 5.0  # [s] that the recorder gets to close its file
NOTE_PERIOD = 5.0  # [s] between two lines in the log that say the same


class RunFailed(Exception):
    """The run cannot go on; the message says what was waited for, and where."""


class BridgeNode(Node):
    """One run of one scenario: `run` returns when it is over and recorded."""

    def __init__(self) -> None:
        super().__init__(STAGE, automatically_declare_parameters_from_overrides=True)
        self._options = options = read_parameters(self, bridge_stage)
        self.plan = options.plan()
        scenario = self.plan.scenario
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
        self._ego = EgoCommand(-1)  # the command for the step that it names
        external = self.plan.ego == EXTERNAL
        self._gate = Gate(self._run_id, () if self.plan.policy == "replay" else (CONTROLS.name,))
        self._port = EgoPort(
            self._run_id,
            scenario.vehicle,
            options.ego_interface if external else Interface.CONTROL,
            stop_on_invalid=options.on_invalid == "stop",
        )
        self._to = {t: self.create_publisher(t.type, t.name, t.qos) for t in (HELLO, STATUS, TIMING)}
        if external:
            self._to[EGO_APPLIED] = self.create_publisher(EGO_APPLIED.type, EGO_APPLIED.name, EGO_APPLIED.qos)
        self._broadcast = Broadcast(self, self.plan)
        self._diagnostics = Diagnostics(self, self._run_id, scenario.total_steps, self._port)
        subscribe(self, self._port, tuple(Interface) if external else (Interface.CONTROL,))
        if self._gate.required:
            self.create_subscription(CONTROLS.type, CONTROLS.name, self._on_controls, CONTROLS.qos)
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

    def _handshake(self) -> None:
        self._broadcast.begin(run_info(self.plan, self._options.mode, {STAGE: parameters(self)}))
        begin = time.monotonic()
        while missing := set(self.plan.stages) - self._ready:
            waiting = sorted(missing - {"recorder"}) or ["recorder"]  # which waits to hear all others
            since = time.monotonic() - begin
            if since > self._options.handshake_timeout_s:
                raise RunFailed(
                    f"{', '.join(waiting)}: no READY for run {self._run_id} on {STATUS.name} within "
                    f"{self._options.handshake_timeout_s:g} s; is the node running in {self._domain}?"
                )
            if since > RESEND:
                self._note(f"waiting for READY from {', '.join(waiting)} on {STATUS.name}")
            self._to[HELLO].publish(Hello(header=messages.header(0), run_id=self._run_id))
            self._spin_until(lambda: set(self.plan.stages) <= self._ready, time.perf_counter() + HELLO_PERIOD)

    def _loop(self) -> None:
        total, start = self.plan.scenario.total_steps, time.perf_counter()
        controls = ControlTable.empty(0)
        table, compute, due = self.world.reset(), 0.0, 0.0
        with tqdm(total=total, unit="step", disable=self._options.progress != "bar") as bar:
            for step in range(total + 1):
                # A pace that was lost by more than half a step is not made up for.
                due = max(due + STEP_S, time.perf_counter() + 0.5 * STEP_S)
                self._round(table, due)
                if step == 0:
                    start = due = time.perf_counter()  # meeting everybody at step 0 is no part of the run's pace
                controls = self._take(step, controls)
                self._to[TIMING].publish(messages.status(self._run_id, STAGE, StageStatus.RUNNING, step, compute))
                if self._options.mode == "realtime":
                    self._spin_until(lambda: False, due)
                if step < total:
                    before = time.perf_counter()
                    table = self._step(controls)
                    compute = time.perf_counter() - before
                bar.update(step > 0)
                if self._options.progress == "lines" and (step % 10 == 0 or step == total):
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
        self._port.open(step, ego_state(table, self.plan.scenario.ego_id), driven=self.world.ego_is_driven)
        self._broadcast.show(table)
        resend = RESEND_FIRST if step == 0 else RESEND
        give_up = time.perf_counter() + self._timeout(step)
        if self._options.mode == "realtime" and step > 0:
            give_up = due
        while True:
            self._diagnostics.step(step)
            self._port.ask()
            until = min(give_up, time.perf_counter() + resend)
            if self._spin_until(lambda: not self._missing, until):
                self._command(step)  # the recorder waits for it
                self._spin_until(lambda: self._answered(step), until)
            if self._answered(step) or time.perf_counter() >= give_up:
                return
            self._ask_around(step)
            self._broadcast.repeat()

    def _timeout(self, step: int) -> float:
        """How long the answers to a step are waited for [s]; an external ego is met at step 0."""
        if step > 0:
            return self._options.answer_timeout_s
        return self._options.external_timeout_s if self.plan.ego == EXTERNAL else self._options.handshake_timeout_s

    def _answered(self, step: int) -> bool:
        """Whether all answers to `step` are in, and the recorder is not too far behind (at step 0: not at all)."""
        return not self._missing and self._recorded >= max(0, step - RECORDER_WINDOW)

    @property
    def _missing(self) -> list[str]:
        """Topics on which an answer is still waited for."""
        return self._gate.missing + ([" or ".join(self._port.topics)] if self._port.missing else [])

    def _command(self, step: int) -> None:
        """The ego's command for `step`; that of an external ego is published for the record.

        Raises:
            RunFailed: its answer cannot be used.
        """
        if self._ego.step != step:
            try:
                self._ego = self._port.take()
            except AnswerInvalid as error:
                raise RunFailed(str(error)) from error
        if EGO_APPLIED in self._to:
            self._to[EGO_APPLIED].publish(messages.ego_to_message(self._ego, self._run_id))

    def _ask_around(self, step: int) -> None:
        """Something is missing: say so, and learn from the timing of the stages, who repeat it, which one is silent."""
        if STAGE not in self._heard:
            self._heard[STAGE] = step
            self.create_subscription(TIMING.type, TIMING.name, self._on_timing, TIMING.qos)
        waiting = self._missing or [f"{RECORDED.name} of the recorder"]
        if step > 0 or self.plan.ego == EXTERNAL:
            self._note(f"step {step}: waiting for {', '.join(waiting)}")
            self._diagnostics.say(step, diagnostics.RUNNING, Level.WARN, f"waiting for {', '.join(waiting)}")

    def _take(self, step: int, controls: ControlTable) -> ControlTable:
        """The answers to `step`; where one is missing, the newest that there is counts on, or the run ends."""
        missing = self._missing
        if not missing and not self._answered(step):
            raise RunFailed(
                f"recorder: has confirmed {self._confirmed()} on {RECORDED.name} at step {step}, expected at most "
                f"{RECORDER_WINDOW} steps behind"
            )
        if missing and (step == 0 or (self._options.mode == "lockstep" and self._options.on_missing == "stop")):
            raise RunFailed(
                f"no answer to step {step} on {', '.join(missing)} within {self._timeout(step):g} s{self._silent(step)}"
            )
        for name in missing:
            self._missed[name] = self._missed.get(name, 0) + 1
        if missing:  # the recorder need not wait for them
            self._say(StageStatus.RUNNING, step, text=f"missed {', '.join(missing)}")
        if self._ego.step != step:
            self._command(step)
        newest = self._gate.newest
        if CONTROLS.name not in newest:
            return replace(controls, step=step)
        try:
            controls = self._checked(messages.controls_from_message(newest[CONTROLS.name]))
        except ValueError as error:
            raise RunFailed(f"the answer to step {step} on {CONTROLS.name} cannot be used: {error}") from error
        return replace(controls, step=step)

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

    def _step(self, controls: ControlTable) -> AgentTable:
        try:
            return self.world.step(controls, self._ego)
        except ValueError as error:
            raise RunFailed(str(error)) from error

    def _silent(self, step: int) -> str:
        """In words, which stages have not answered `step`, as far as they have been heard of."""
        silent = [s for s in self.plan.stages if s != "recorder" and self._heard.get(s, -1) < step]
        if self._heard.keys() <= {STAGE}:
            silent = []  # nobody was heard: nothing can be said of anybody
        if self.plan.ego == EXTERNAL and self._port.missing:
            topics = [self.resolve_topic_name(name) for name in self._port.topics]
            left = step > 0 and not any(self.count_publishers(topic) for topic in topics)
            silent.append(
                f"the external ego ({'its publisher has left' if left else f'is it running in {self._domain}?'})"
            )
        return f"; silent: {', '.join(silent)}" if silent else ""

    @property
    def _domain(self) -> str:
        return f"ROS_DOMAIN_ID {self.context.get_domain_id()}"

    def _confirmed(self) -> str:
        return "nothing" if self._recorded < 0 else f"only step {self._recorded}"

    def _await_recorder(self, last: int) -> None:
        if "recorder" in self.plan.stages:
            until = time.perf_counter() + self._options.answer_timeout_s
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
            if self._port.remarks:
                self._diagnostics.remarks(self._gate.step)
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

    def _on_controls(self, message: Any) -> None:
        self._gate.offer(CONTROLS.name, message.run_id, message.step, message)

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
        ended = {StageStatus.FINISHED: diagnostics.FINISHED, StageStatus.FAILED: diagnostics.FAILED}
        on = diagnostics.RUNNING
        self._diagnostics.say(step, ended.get(state, on), Level.OK if state in ended else Level.WARN, text)
        status = messages.status(self._run_id, STAGE, state, max(0, step), compute_time, text)
        self._to[STATUS].publish(status)

    def _summary(self) -> dict[str, Any]:
        """What only the bridge knows, for the record."""
        counts = self._port.counts
        late = counts["late"] + counts["stale"]
        stale = self._gate.stale | ({self._port.topics[0]: late} if late else {})
        port = {"interface": str(self._port.interface)} | {name: counts[name] for name in COUNTS}
        return {"missed": self._missed, "stale": stale, "ego_port": port} | self.world.summary()


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
