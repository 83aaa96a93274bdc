"""What the processes of all nodes share: how callbacks are served, signals, exit statuses, arguments nobody knows."""

from __future__ import annotations

import gc
import inspect
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from litsim_sim.core.errors import EXIT_INPUT, EXIT_INTERRUPTED, InputError, print_error
from litsim_sim.launch.middleware import use_middleware_settings

try:
    from rclpy.experimental import EventsExecutor as LoopExecutor
except ImportError:  # rclpy before 7.1.4 has none; this one serves the same, and takes twice the time
    from rclpy.executors import SingleThreadedExecutor as LoopExecutor

USAGE = """\
usage: {name} [--ros-args -p NAME:=VALUE ... --params-file FILE ...]

One node of a run; `litsim_sim launch` starts all of them. Its parameters, with units and defaults, are in
config/{name}.yaml of its package.
"""
SIGNAL_PERIOD = 0.05  # [s] for which Ctrl-C may go unnoticed: waiting for DDS does not wake up for signals
TOGETHER_S = 0.5  # [s] within which signals are one


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


def executor_of(*nodes: Node) -> Executor:
    """What serves the callbacks of nodes that are waited for.

    Other executors go through all that a node might wait for whenever they wait, in Python; the events executor is told
    by DDS, and takes half of their time for a message.
    """
    executor: Executor = LoopExecutor()
    for node in nodes:
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
    _know_callers()
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


def _know_callers() -> None:
    """Tell :mod:`inspect` which modules the files of source are.

    rclpy asks it who logs a line, and at the first it would follow the links in the paths of all modules (0.05 s).
    """
    files = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
    inspect.modulesbyfile.update({file: name for name, file in files.items() if file})


def _init() -> None:
    """Initialise rclpy from the command line, which may hold nothing but ROS arguments."""
    name = Path(sys.argv[0]).name
    extra = remove_ros_args(sys.argv)[1:]
    if extra[:1] in (["-h"], ["--help"]):
        print(USAGE.format(name=name), end="")
        sys.exit(0)
    if extra:
        raise InputError(f"{name}: unknown argument {extra[0]}; parameters are given as --ros-args -p NAME:=VALUE")
    use_middleware_settings(name, sys.argv)
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(f"{name}: ROS arguments: {error}") from error
