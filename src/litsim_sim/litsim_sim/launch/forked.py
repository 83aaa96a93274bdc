"""Forks: programs of the workspace, run in copies of this process, which have all its modules already.

Six nodes that import numpy, numba and rclpy each for themselves take nine seconds of processor time; copies of a
process that has imported them take next to none. A copy is to a node what a process of its own is: it has a session, an
environment, output and a name of its own, and ends when the thread that has made it is gone.

Whoever forks may have made no DDS participant yet, and runs no Python code in other threads. Threads of the libraries
are none of the copies'; pyarrow, OpenBLAS and jemalloc, which have some, are made for that.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import runpy
import signal
import sys
from collections.abc import Mapping, Sequence
from typing import IO, Any

import setproctitle

from litsim_sim.launch.child import SIGNALS, begin_child

_CONTEXT = multiprocessing.get_context("fork")


class ForkedProcess:
    """A Python program in a copy of this process, with as much of the interface of ``Popen`` as is used of it.

    Attributes:
        stdout: what it writes to its standard output, where that is a pipe.
    """

    def __init__(
        self, words: Sequence[str], environment: Mapping[str, str], output: IO[str], *, piped: bool = False
    ) -> None:
        """Start the program in file ``words[0]`` with the other words as its arguments.

        Args:
            words: of its command line.
            environment: all that it finds in its environment.
            output: file that its errors go to, and its standard output unless that is `piped`.
            piped: whether its standard output is read from :attr:`stdout`.
        """
        read, write = os.pipe() if piped else (None, output.fileno())
        self._process = _CONTEXT.Process(
            target=_run_program,
            args=(os.getpid(), tuple(words), dict(environment), write, output.fileno()),
            daemon=True,
        )
        self._process.start()
        self.stdout = None
        if read is not None:
            os.close(write)
            self.stdout = os.fdopen(read)

    @property
    def pid(self) -> int:
        """Id of the process, and of its process group and session."""
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | Any:
        """Its exit status, the number of the signal that has ended it as a negative one, None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """See :attr:`returncode`."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end for at most `timeout` seconds; returns :attr:`returncode`."""
        self._process.join(timeout)
        return self.returncode


def keep_imports() -> None:
    """Have what there is by now shared with the copies that are made from here on: the collector would touch it all."""
    gc.collect()
    gc.freeze()


def _run_program(parent: int, words: Sequence[str], environment: Mapping[str, str], stdout: int, stderr: int) -> None:
    """In the copy: become what a process of its own would be, and run the program."""
    os.setsid()
    _forget_signals()
    begin_child()
    if os.getppid() != parent:  # it was gone before that could be asked for
        os.kill(os.getpid(), signal.SIGTERM)
    os.dup2(stdout, 1)
    os.dup2(stderr, 2)
    sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115 - for as long as the process lives
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    # Before the environment is changed, beside which it looks for the command line. The program's file alone: ROS takes
    # all that follows the last slash for the name of the executable, and names its log by it.
    setproctitle.setproctitle(words[0])
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = list(words)
    runpy.run_path(words[0], run_name="__main__")


def _forget_signals() -> None:
    """Handle signals as Python does when it starts, whatever the process does that this is a copy of."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in set(SIGNALS) - {signal.SIGINT}:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup holds SIGHUP back
            signal.signal(number, signal.SIG_DFL)
