"""The shell around a stage's core: handshake, joining of inputs, one answer per step, timing, errors.

And what the processes of all nodes share: signals, exit statuses, parameters that nobody knows.
"""

from __future__ import annotations

import gc
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from litsim_msgs.msg import Hello, RunInfo, StageStatus
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor, TimeoutException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from litsim_sim.core.compiled import load_kernels
from litsim_sim.core.errors import EXIT_INPUT, EXIT_INTERRUPTED, InputError, print_error, reason
from litsim_sim.core.lockstep import Joiner
from litsim_sim.core.stages import BRIDGE
from litsim_sim.core.step_marks import step_marks
from litsim_sim.launch.middleware import use_middleware_settings
from litsim_sim.ros import messages
from litsim_sim.ros.endpoints import Endpoints, publisher_on, subscribe
from litsim_sim.ros.parameters import parameters_yaml
from litsim_sim.ros.topics import HELLO, RUN_INFO, STATUS, TIMING, Topic
from litsim_sim.scenario.scenario import Scenario

SIGNAL_PERIOD = 0.2  # [s] for which Ctrl-C may go unnoticed: waiting for DDS does not wake up for signals
BRIDGE_QUIET_S = 5.0
"""[s] without anything of a run after which another may begin: what is waited for is published each second."""
TOGETHER_S = 0.5  # [s] within which signals are one


class StageNode(Node):
    """A node that answers every step of a run once all inputs of the step are in.

    A subclass says what it reads and writes, builds its core in :meth:`configure`, and calls it in :meth:`answer`.
    It serves one run after the other: an error ends its part in a run, not the node.
    """

    stage: str
    inputs: Sequence[Topic]
    outputs: Sequence[Topic]
    declared: Endpoints

    def __init_subclass__(cls, **given: Any) -> None:
        """Note the endpoints of a stage: its own, and those that every stage has."""
        super().__init_subclass__(**given)
        cls.declared = Endpoints(cls.stage, (*cls.outputs, STATUS, TIMING), (*cls.inputs, RUN_INFO, HELLO, STATUS))

    def __init__(self) -> None:
        super().__init__(self.stage, automatically_declare_parameters_from_overrides=True)
        self._joiner: Joiner | None = None
        self._asked = 0.0  # when something came last of the run at hand [s]
        self._next: RunInfo | None = None  # a run that began while another was on
        self._word: StageStatus | None = None  # on the run at hand, READY or FAILED; repeated when the bridge greets
        self._last: list[tuple[Publisher, Any]] = []
        self._status = publisher_on(self, STATUS)
        self._timing = publisher_on(self, TIMING)
        self._outputs = [publisher_on(self, topic) for topic in self.outputs]
        for topic in self.inputs:
            subscribe(self, topic, self._input(topic.name))
        subscribe(self, RUN_INFO, self._on_run_info)
        subscribe(self, HELLO, self._on_hello)
        subscribe(self, STATUS, self._on_status)

    def configure(self, info: RunInfo, scenario: Scenario) -> None:
        """Build the core for a run.

        Raises:
            InputError: the run cannot be served; the message goes to the bridge, which ends the run.
        """
        raise NotImplementedError

    def read(self, topic: str, message: Any) -> Any:
        """What :meth:`answer` is given of a message that has come on `topic`.

        It is called as soon as the message is there: what one stage makes of it, it makes while those before it work.
        """
        del topic
        return message

    def answer(self, inputs: dict[str, Any]) -> Sequence[Any]:
        """Messages for `outputs`, in their order, from what :meth:`read` has made of those of a step, by topic name."""
        raise NotImplementedError

    def leave(self) -> None:
        """Tell the bridge, which would wait, that no more answers come."""
        if self._joiner is not None:
            self._say(self._joiner.run_id, StageStatus.FAILED, self._joiner.answered + 1, "the node was ended")

    def _on_run_info(self, info: RunInfo) -> None:
        if self._busy(info.run_id):
            self._next = info
            return
        self._forget()
        try:
            self.configure(info, Scenario.from_yaml(info.scenario_yaml, f"{RUN_INFO.name} of run {info.run_id}"))
            load_kernels()
        except Exception as error:  # noqa: BLE001 - whatever it is, the bridge has to hear of it
            self._fail(info.run_id, 0, reason(error), error)
            return
        spare_from_collection()
        self._joiner = Joiner(info.run_id, tuple(t.name for t in self.inputs))
        self._say(info.run_id, StageStatus.READY, text=parameters_yaml(self))
        self.get_logger().info(f"ready for run {info.run_id}; waiting for its steps on {self.inputs[0].name}")

    def _busy(self, run_id: str) -> bool:
        """Whether another run is on, whose bridge is alive: whoever begins one beside it has to wait, not this one."""
        on = self._joiner is not None and self._joiner.run_id != run_id and self._joiner.answered >= 0
        return on and time.monotonic() < self._asked + BRIDGE_QUIET_S

    def _on_hello(self, hello: Hello) -> None:
        if self._next is not None and self._next.run_id == hello.run_id and not self._busy(hello.run_id):
            self._on_run_info(self._next)
        if self._word is not None and self._word.run_id == hello.run_id:
            self._status.publish(self._word)

    def _on_status(self, status: StageStatus) -> None:
        ended = status.stage == BRIDGE and status.state in (StageStatus.FINISHED, StageStatus.FAILED)
        if ended and self._word is not None and status.run_id == self._word.run_id:
            self._forget()
            self.get_logger().info(f"run {status.run_id} is over; waiting for another on {RUN_INFO.name}")

    def _input(self, name: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            if self._joiner is None:
                return
            if message.run_id == self._joiner.run_id:
                self._asked = time.monotonic()
            if self._joiner.too_late(name, message.run_id, message.step):
                self.get_logger().warning(
                    f"run {message.run_id} has begun without this node, which takes part from step 0 on or not at all"
                )
                self._forget()
                return
            if self._joiner.asked_again(name, message.run_id, message.step):
                for publisher, answer in self._last:
                    publisher.publish(answer)
                return
            if message.run_id == self._joiner.run_id and message.step > self._joiner.answered:
                self._take(name, message)

        return receive

    def _take(self, name: str, message: Any) -> None:
        """Take an input of the run at hand, and answer its step if it is the last of it."""
        start = time.perf_counter()
        try:
            given = self.read(name, message)
            inputs = self._joiner.offer(name, message.run_id, message.step, given) if self._joiner else None
            if inputs is None:
                return
            answers = self.answer(inputs)
        except Exception as error:  # noqa: BLE001 - whatever it is, the bridge has to hear of it
            self._fail(message.run_id, message.step, f"step {message.step}: {reason(error)}", error)
            return
        computed = time.perf_counter()
        self._last = list(zip(self._outputs, answers, strict=True))
        for publisher, answer in self._last:
            publisher.publish(answer)
        marks = step_marks({"begin": start, "answered": time.perf_counter()})
        timing = messages.status(message.run_id, self.stage, StageStatus.RUNNING, message.step, computed - start, marks)
        self._timing.publish(timing)
        self._last.append((self._timing, timing))

    def _fail(self, run_id: str, step: int, text: str, error: Exception) -> None:
        """Leave the run; the bridge gets one line, the log of this node all there is."""
        self._forget()
        self._say(run_id, StageStatus.FAILED, step, text)
        self.get_logger().error(text if isinstance(error, InputError) else "".join(traceback.format_exception(error)))

    def _say(self, run_id: str, state: int, step: int = 0, text: str = "") -> None:
        self._word = messages.status(run_id, self.stage, state, step, text=text)
        self._status.publish(self._word)

    def _forget(self) -> None:
        self._joiner, self._word, self._last, self._next = None, None, [], None
        gc.unfreeze()  # what the run has left can go


def run_node(create: Callable[[], StageNode]) -> None:
    """Serve runs until Ctrl-C or SIGTERM, which are the ordinary end: exit status 0."""
    with process(interrupted=0):
        node = create()
        node.get_logger().info(f"waiting for a run on {RUN_INFO.name}")
        try:
            spin(node)
        finally:
            node.leave()


def spin(node: Node, done: Callable[[], bool] = lambda: False, rest: float = 0.0) -> None:
    """Serve the callbacks of `node` until `done`.

    Args:
        node: whose callbacks are served.
        done: is asked between two of them.
        rest: a node that nobody waits for may rest that long [s] whenever it has served all there is: serving many
            messages at a time costs much less than waking for each of them.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM.
    """
    if not rest:
        executor = executor_of(node)
        while not done():
            serve(executor)
        return
    patient = SingleThreadedExecutor()
    patient.add_node(node)
    while not done():
        if not _serve_round(patient):
            time.sleep(rest)


def executor_of(node: Node) -> Executor:
    """What serves the callbacks of a node that is waited for.

    Other executors go through all that a node might wait for whenever they wait, in Python; this one is told by DDS,
    and takes half of their time for a message.
    """
    executor = EventsExecutor()
    executor.add_node(node)
    return executor


def serve(executor: Executor, timeout: float = SIGNAL_PERIOD) -> None:
    """Serve a callback, or wait for one for at most `timeout` and :data:`SIGNAL_PERIOD` seconds.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM.
    """
    _interruption.check()
    executor.spin_once(timeout_sec=min(timeout, SIGNAL_PERIOD))


def _serve_round(executor: SingleThreadedExecutor) -> bool:
    """Serve what is ready, of each subscription one message; returns whether there was any."""
    served = False
    while True:
        _interruption.check()
        try:
            callback, _, _ = executor.wait_for_ready_callbacks(timeout_sec=0.0)
        except TimeoutException:  # rclpy says so at the end of a round that found something, too
            return served
        callback()
        callback.result()  # raises what the callback has raised
        served = True


class _Interruption:
    """Ctrl-C and SIGTERM: the first is noticed between two callbacks, so that none is cut in two; another at once.

    Signals that come together count as one: when a launcher is killed, its nodes get one for each of its threads.
    """

    def __init__(self) -> None:
        self._asked, self._since = False, 0.0

    def install(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):  # SIGINT too: background jobs of scripts begin with it ignored
            signal.signal(number, self._on_signal)

    def check(self) -> None:
        if self._asked:
            self._asked = False
            raise KeyboardInterrupt

    def _on_signal(self, *_: object) -> None:
        now = time.monotonic()
        if not self._asked:
            self._asked, self._since = True, now
        elif now - self._since > TOGETHER_S:
            raise KeyboardInterrupt


_interruption = _Interruption()


@contextmanager
def process(interrupted: int = EXIT_INTERRUPTED) -> Iterator[None]:
    """The frame of a node's process: rclpy, and how it ends.

    SIGTERM does what Ctrl-C does: :func:`serve` raises KeyboardInterrupt, and the exit status is `interrupted`. An
    input error, which a wrong parameter is too, is one line on stderr and exit status 2.
    """
    _interruption.install()
    try:
        _init()
        yield
    except (InputError, ParameterException) as error:
        print_error(" ".join(str(error).split()))  # rclpy breaks lines
        sys.exit(EXIT_INPUT)
    except KeyboardInterrupt:
        sys.exit(interrupted)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is ending already
        rclpy.try_shutdown()


def spare_from_collection() -> None:
    """Have the garbage collector leave alone what there is by now: libraries, scenario, core.

    Going through all of that takes a tenth of a second, a whole step in real time, and finds nothing.
    """
    gc.freeze()


def _init() -> None:
    """Initialise rclpy from the command line, which may hold nothing but ROS arguments."""
    name = Path(sys.argv[0]).name
    extra = remove_ros_args(sys.argv)[1:]
    if extra:
        raise InputError(f"{name}: unknown argument {extra[0]}; parameters are given as --ros-args -p NAME:=VALUE")
    use_middleware_settings(name, sys.argv)
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(f"{name}: ROS arguments: {error}") from error
