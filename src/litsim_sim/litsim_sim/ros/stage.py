"""The shell around a stage's core: handshake, joining of inputs, one answer per step, timing, errors."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher

from litsim_sim.errors import InputError
from litsim_sim.lockstep import Joiner
from litsim_sim.ros import messages
from litsim_sim.ros.topics import HELLO, RUN_INFO, STATUS, TIMING, Topic
from litsim_sim.scenario import Scenario


class StageNode(Node):
    """A node that answers every step of a run once all inputs of the step are in.

    A subclass says what it reads and writes, builds its core in :meth:`configure`, and calls it in :meth:`answer`.
    """

    stage: str
    inputs: Sequence[Topic]
    outputs: Sequence[Topic]

    def __init__(self) -> None:
        super().__init__(self.stage)
        self._joiner: Joiner | None = None
        self._last: list[tuple[Publisher, Any]] = []
        self._status = self.create_publisher(STATUS.type, STATUS.name, STATUS.qos)
        self._timing = self.create_publisher(TIMING.type, TIMING.name, TIMING.qos)
        self._outputs = [self.create_publisher(t.type, t.name, t.qos) for t in self.outputs]
        for topic in self.inputs:
            self.create_subscription(topic.type, topic.name, self._input(topic.name), topic.qos)
        self.create_subscription(RUN_INFO.type, RUN_INFO.name, self._on_run_info, RUN_INFO.qos)
        self.create_subscription(HELLO.type, HELLO.name, self._on_hello, HELLO.qos)

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """Build the core for a run.

        Raises:
            InputError: the run cannot be served; the message goes to the bridge, which ends the run.
        """
        raise NotImplementedError

    def answer(self, step: int, inputs: dict[str, Any]) -> Sequence[Any]:
        """Messages for `outputs`, in their order, from the messages of a step by topic name."""
        raise NotImplementedError

    def _on_run_info(self, info: RunInfo) -> None:
        self._joiner = None
        try:
            self.configure(info, Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}"))
        except InputError as error:
            self._fail(info.run_id, 0, str(error))
            return
        self._last = []
        self._joiner = Joiner(info.run_id, tuple(t.name for t in self.inputs))
        self._status.publish(messages.status(info.run_id, self.stage, StageStatus.READY))

    def _on_hello(self, hello: Hello) -> None:
        if self._joiner is not None and self._joiner.run_id == hello.run_id:
            self._status.publish(messages.status(hello.run_id, self.stage, StageStatus.READY))

    def _input(self, name: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            if self._joiner is None:
                return
            if self._joiner.asked_again(name, message.run_id, message.step):
                for publisher, answer in self._last:
                    publisher.publish(answer)
                return
            inputs = self._joiner.offer(name, message.run_id, message.step, message)
            if inputs is not None:
                self._answer(message.step, inputs)

        return receive

    def _answer(self, step: int, inputs: dict[str, Any]) -> None:
        assert self._joiner is not None
        run_id, start = self._joiner.run_id, time.perf_counter()
        try:
            answers = self.answer(step, inputs)
        except Exception:
            self._fail(run_id, step, traceback.format_exc(limit=-3))
            raise
        took = time.perf_counter() - start
        timing = messages.status(run_id, self.stage, StageStatus.RUNNING, step, took)
        self._last = [*zip(self._outputs, answers, strict=True), (self._timing, timing)]
        for publisher, message in self._last:
            publisher.publish(message)

    def _fail(self, run_id: str, step: int, text: str) -> None:
        self.get_logger().error(text)
        self._status.publish(messages.status(run_id, self.stage, StageStatus.FAILED, step, text=text))


def run_node(create: Callable[[], Node]) -> None:
    """Spin a node until Ctrl-C or SIGTERM; input errors are one line on stderr and exit status 2."""
    rclpy.init()
    try:
        node = create()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InputError as error:
        sys.exit(_say(error))
    finally:
        rclpy.try_shutdown()


def _say(error: InputError) -> int:
    print(f"error: {error}", file=sys.stderr)
    return 2
