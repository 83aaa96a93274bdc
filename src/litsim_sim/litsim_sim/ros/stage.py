"""The base class of stage nodes: handshake, joining of inputs, one answer per step, timing, errors."""

from __future__ import annotations

import gc
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any

from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_sim.core.errors import InputError, reason
from litsim_sim.core.lockstep import Joiner, step_marks
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.plugins import stage_reader
from litsim_sim.core.stages import BRIDGE
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.ros import messages
from litsim_sim.ros.endpoints import publisher_on, subscribe
from litsim_sim.ros.in_process import InProcessTransport, Read
from litsim_sim.ros.parameters import parameters_yaml, read_parameters
from litsim_sim.ros.process import executor_of, process, serve, spare_from_collection
from litsim_sim.ros.topics import HELLO, RUN_INFO, STATUS, TIMING, Topic
from litsim_sim.scenario.scenario import Scenario

BRIDGE_QUIET_S = 5.0
"""[s] Time without messages of a run after which another may begin: unanswered steps are repeated each second."""

Write = Callable[[Any, str], Any]
"""Converts an answer of a stage's core to a message of the run with the given id."""


class StageNode(Node):
    """A node that answers every step of a run once all inputs of the step are in.

    A subclass declares its topics, and calls the core of its stage in :meth:`answer`. It serves successive runs: an
    error ends its part in a run, not the node.

    Attributes:
        stage: name of the stage.
        inputs: topics that it waits for, each with its conversion; the first one requests a step.
        output: topic that it answers on, with its conversion.
    """

    stage: str
    inputs: Sequence[tuple[Topic, Read]]
    output: tuple[Topic, Write]

    def __init__(self, transport: InProcessTransport | None = None, **options: Any) -> None:
        """Make the node, with `options` of rclpy's.

        `transport` holds the stages of its process, including all that it waits for.
        """
        super().__init__(self.stage, automatically_declare_parameters_from_overrides=True, **options)
        self._transport = transport or InProcessTransport()
        self._joiner: Joiner | None = None
        self._asked = 0.0  # time of the last message of the current run [s]
        self._next: RunInfo | None = None  # a run that was announced during another
        self._newest_status: StageStatus | None = None  # READY or FAILED, repeated when the bridge greets
        self._published: list[tuple[Publisher, Any]] = []
        self._status = publisher_on(self, STATUS)
        self._timing = publisher_on(self, TIMING)
        self._output = publisher_on(self, self.output[0])
        for topic, read in self.inputs:
            self._transport.listen(self, topic, read, self._input(topic.name))
        self._transport.join(self.output[0])
        subscribe(self, RUN_INFO, self._on_run_info)
        subscribe(self, HELLO, self._on_hello)
        subscribe(self, STATUS, self._on_status)
        self._make: Callable[..., Any] = read_parameters(self, self.reader())

    @classmethod
    def main(cls) -> None:
        """Entry point of the stage alone, such as ``ros2 run litsim_policy policy``."""
        run_stages(cls)

    def reader(self) -> Callable[[ParameterOverrides], Callable[..., Any]]:
        """Returns the function that reads the parameters; what it returns makes the core for a run."""
        return stage_reader(self.stage)

    def configure(self, info: RunInfo, scenario: Scenario) -> Any:
        """Returns the core for a run; raises InputError if it cannot be served, by which the bridge ends the run."""
        return self._make(info.policy, scenario)

    def answer(self, core: Any, *inputs: Any) -> Any:
        """Returns the answer of the `core` to the converted `inputs` of a step."""
        raise NotImplementedError

    def leave(self) -> None:
        """Tell the bridge that there will be no more answers."""
        if self._joiner is not None:
            self._say(self._joiner.run_id, StageStatus.FAILED, self._joiner.answered + 1, "the node was ended")

    def _on_run_info(self, info: RunInfo) -> None:
        if self._busy(info.run_id):
            self._next = info
            return
        self._forget()
        try:
            self._core = self.configure(info, self._transport.scenario(info))
            load_kernels()
        except Exception as error:  # noqa: BLE001 - whatever it is, the bridge has to hear of it
            self._fail(info.run_id, 0, reason(error), error)
            return
        spare_from_collection()
        self._joiner = Joiner(info.run_id, tuple(topic.name for topic, _ in self.inputs))
        self._say(info.run_id, StageStatus.READY, text=parameters_yaml(self))
        self.get_logger().info(f"ready for run {info.run_id}; waiting for its steps on {self.inputs[0][0].name}")

    def _busy(self, run_id: str) -> bool:
        """Returns whether another run with a live bridge is active, which a new run must not displace."""
        on = self._joiner is not None and self._joiner.run_id != run_id and self._joiner.answered >= 0
        return on and time.monotonic() < self._asked + BRIDGE_QUIET_S

    def _on_hello(self, hello: Hello) -> None:
        if self._next is not None and self._next.run_id == hello.run_id and not self._busy(hello.run_id):
            self._on_run_info(self._next)
        if self._newest_status is not None and self._newest_status.run_id == hello.run_id:
            self._status.publish(self._newest_status)

    def _on_status(self, status: StageStatus) -> None:
        ended = status.stage == BRIDGE and status.state in (StageStatus.FINISHED, StageStatus.FAILED)
        if ended and self._newest_status is not None and status.run_id == self._newest_status.run_id:
            self._forget()
            self.get_logger().info(f"run {status.run_id} is over; waiting for another on {RUN_INFO.name}")

    def _input(self, name: str) -> Callable[[str, int, Callable[[], Any]], None]:
        def receive(run_id: str, step: int, read: Callable[[], Any]) -> None:
            if self._joiner is None:
                return
            if run_id == self._joiner.run_id:
                self._asked = time.monotonic()
            if self._joiner.too_late(name, run_id, step):
                self.get_logger().warning(
                    f"run {run_id} has begun without this node, which takes part from step 0 on or not at all"
                )
                self._forget()
                return
            if self._joiner.asked_again(name, run_id, step):
                for publisher, answer in self._published:
                    publisher.publish(answer)
                return
            if run_id == self._joiner.run_id and step > self._joiner.answered:
                self._take(name, run_id, step, read)

        return receive

    def _take(self, name: str, run_id: str, step: int, read: Callable[[], Any]) -> None:
        """Take an input of the current run, and answer its step once it is complete."""
        start = time.perf_counter()
        try:
            value = read()
            inputs = self._joiner.offer(name, run_id, step, value) if self._joiner else None
            if inputs is None:
                return
            answer = self.answer(self._core, *(inputs[topic.name] for topic, _ in self.inputs))
        except Exception as error:  # noqa: BLE001 - whatever it is, the bridge has to hear of it
            self._fail(run_id, step, f"step {step}: {reason(error)}", error)
            return
        computed = time.perf_counter()
        status = messages.status(run_id, self.stage, StageStatus.RUNNING, step, computed - start)
        topic, _ = self.output
        if self._transport.has_listener(topic):  # publishing can wait, then
            self._transport.defer(lambda: self._publish(answer, status, {"begin": start, "answered": computed}))
            self._transport.publish(topic, answer, run_id, step)
        else:
            self._publish(answer, status, {"begin": start})

    def _publish(self, answer: Any, status: StageStatus, marks: dict[str, float]) -> None:
        """Publish an answer, and `status` with the marks of its step: `answered` is now, unless given."""
        _, write = self.output
        try:
            message = write(answer, status.run_id)
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(status.run_id, status.step, f"step {status.step}: {reason(error)}", error)
            return
        self._output.publish(message)
        status.text = step_marks({"answered": time.perf_counter()} | marks)
        self._transport.defer(lambda: self._timing.publish(status))
        self._published = [(self._output, message), (self._timing, status)]

    def _fail(self, run_id: str, step: int, text: str, error: Exception) -> None:
        """Leave the run; report one line to the bridge, and the traceback to the log of this node."""
        self._forget()
        self._say(run_id, StageStatus.FAILED, step, text)
        self.get_logger().error(text if isinstance(error, InputError) else "".join(traceback.format_exception(error)))

    def _say(self, run_id: str, state: int, step: int = 0, text: str = "") -> None:
        self._newest_status = messages.status(run_id, self.stage, state, step, text=text)
        self._status.publish(self._newest_status)

    def _forget(self) -> None:
        self._joiner, self._newest_status, self._published, self._next = None, None, [], None
        gc.unfreeze()  # the objects of the run can be collected


def run_stages(*factories: Callable[[InProcessTransport], StageNode], arguments: Sequence[str] = ()) -> None:
    """Serve runs until Ctrl-C or SIGTERM, which are the ordinary end: exit status 0.

    Args:
        factories: functions that make the stages of this process, each after those that it waits for.
        arguments: those that the program knows, which choose its stages.
    """
    with process(interrupted=0, arguments=arguments):
        if not factories:
            raise InputError(f"no stage is given, expected some of {', '.join(arguments)}")
        transport = InProcessTransport()
        nodes = [make(transport) for make in factories]
        load_kernels()  # while others get ready; a run may need more
        executor = executor_of(*nodes)
        for node in nodes:
            node.get_logger().info(f"waiting for a run on {RUN_INFO.name}")
        try:
            while True:
                serve(executor)
        finally:
            for node in nodes:
                node.leave()
