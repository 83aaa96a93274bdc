"""Common parts of the processes of all nodes: serving callbacks, signals, exit statuses, and unknown arguments."""

from __future__ import annotations

import gc
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from litsim_sim.core.errors import EXIT_INPUT, EXIT_INTERRUPTED, InputError, print_error, refused
from litsim_sim.launch.middleware import use_middleware_settings

try:
    from rclpy.experimental import EventsExecutor as LoopExecutor
except ImportError:  # rclpy before 7.1.4; the fallback is equivalent, at twice the cost
    from rclpy.executors import SingleThreadedExecutor as LoopExecutor

USAGE = """\
usage: {name} {arguments}[--ros-args -p NAME:=VALUE ... --params-file FILE ...]

One node of a run; `litsim_sim launch` starts all of them. Its parameters, with units and defaults, are in
config/{name}.yaml of its package.
"""
SIGNAL_PERIOD = 0.05  # [s] longest delay until Ctrl-C is noticed: signals do not interrupt waiting for DDS
TOGETHER_S = 0.5  # [s] signals within this time count as one


def spin(node: Node, done: Callable[[], bool] = lambda: False) -> None:
    """Serve the callbacks of `node` until `done`, which is called between them; raises as :func:`serve`."""
    executor = executor_of(node)
    while not done():
        serve(executor)


def executor_of(*nodes: Node) -> Executor:
    """Returns an executor for nodes.

    Other executors iterate over all entities of a node, in Python, whenever they wait; the events executor is notified
    by DDS. Without it a step takes 1.17 times as long (1.07 to 1.31, 4 pairs).
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


class _Interruption:
    """Ctrl-C and SIGTERM: the first takes effect between callbacks, so that none is interrupted; the next at once.

    Signals in quick succession count as one: when a launcher is killed, its nodes get one for each of its threads.
    """

    def __init__(self) -> None:
        self._asked, self._since = False, 0.0

    def install(self) -> None:
        for number in (signal.SIGINT, signal.SIGTERM):  # SIGINT too: background jobs of scripts ignore it
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
def process(interrupted: int = EXIT_INTERRUPTED, arguments: Sequence[str] = ()) -> Iterator[None]:
    """Context of a node's process: initialises rclpy, and turns errors into exit statuses.

    `arguments` of the command line are known to the program; it can have no others but ROS arguments.

    SIGTERM acts like Ctrl-C: :func:`serve` raises KeyboardInterrupt, and the exit status is `interrupted`. An input
    error, such as a wrong parameter, is one line on stderr and exit status 2; so is a path that the system refuses.
    """
    _interruption.install()
    try:
        _init(arguments)
        yield
    except (InputError, ParameterException) as error:
        print_error(" ".join(str(error).split()))  # rclpy breaks lines
        sys.exit(EXIT_INPUT)
    except OSError as error:
        if (why := refused(error)) is None:
            raise
        print_error(why)
        sys.exit(EXIT_INPUT)
    except KeyboardInterrupt:
        sys.exit(interrupted)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process is ending already
        rclpy.try_shutdown()


def spare_from_collection() -> None:
    """Exempt all existing objects (libraries, scenario, core) from garbage collection.

    A pass over them takes a tenth of a second, a whole step in real time, and finds nothing. On average a step takes
    1.05 times as long without this (0.98 to 1.11, 3 pairs).
    """
    gc.freeze()


def _init(positional: Sequence[str] = ()) -> None:
    """Initialise rclpy from the command line, which may hold ROS arguments and `positional` ones only."""
    name = Path(sys.argv[0]).name
    extra = [argument for argument in remove_ros_args(sys.argv)[1:] if argument not in positional]
    if extra[:1] in (["-h"], ["--help"]):
        print(USAGE.format(name=name, arguments=" ".join([*positional, ""])), end="")
        sys.exit(0)
    if extra:
        raise InputError(f"{name}: unknown argument {extra[0]}; parameters are given as --ros-args -p NAME:=VALUE")
    use_middleware_settings(name, sys.argv)
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise InputError(f"{name}: ROS arguments: {error}") from error
