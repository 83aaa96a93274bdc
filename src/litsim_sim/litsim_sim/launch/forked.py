"""Forks: programs of the workspace, run in copies of a process, which have all its modules already.

Six nodes that import numpy, numba and rclpy each for themselves take nine seconds of processor time; copies of a
process that has imported them take next to none. To a program, a copy looks like a process of its own: it has its own
session, environment, output and name, and ends when the process that requested it is gone.

The copied process is this one, or one that holds only what was passed to :func:`keep_ready`. It must not have made a
DDS participant yet, and runs no Python code in other threads. Copies do not get the threads of libraries; pyarrow,
OpenBLAS and jemalloc, which have some, can handle that.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import setproctitle

from litsim_sim.core.errors import EXIT_INTERRUPTED
from litsim_sim.launch.child import SIGNALS, begin_child

_HERE, _READY = multiprocessing.get_context("fork"), multiprocessing.get_context("forkserver")


class ForkedProcess:
    """A Python program in a copy of a process, with the part of the interface of ``Popen`` that is used.

    Attributes:
        stdout, stderr: to read its output from, if that is a pipe.
    """

    def __init__(
        self,
        words: Sequence[str],
        environment: Mapping[str, str],
        *,
        stdout: IO[str] | int,
        stderr: IO[str] | int,
        ready: bool = False,
    ) -> None:
        """Start the program in file ``words[0]`` with the other words as its arguments, in this folder.

        Args:
            words: words of its command line.
            environment: its whole environment.
            stdout, stderr: where its output goes; a file, ``PIPE`` or ``DEVNULL`` of :mod:`subprocess`.
            ready: whether it is a copy of the process of :func:`keep_ready`, to which no file can be given, rather than
                of this one.
        """
        self.stdout, out = _end_of(stdout)
        self.stderr, err = _end_of(stderr)
        begun, begin = multiprocessing.Pipe(duplex=False)
        given = (tuple(words), dict(environment), str(Path.cwd()), out, err, begin)
        if ready:  # it may have processes of its own
            self._process: Any = _READY.Process(target=_run_for_other, args=given)
        else:
            self._process = _HERE.Process(target=_run_as_child, args=given, daemon=True)
        self._process.start()
        for each in (out, err, begin):
            if isinstance(each, Connection):
                each.close()  # else its end would not be noticed
        with begun:
            begun.poll(None)  # until then its process group cannot be signalled

    @property
    def pid(self) -> int:
        """Id of the process, and of its process group and session."""
        return int(self._process.pid)

    @property
    def returncode(self) -> int | Any:
        """Its exit status, the number of the signal that has ended it as a negative one, None while it runs."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """See :attr:`returncode`."""
        return self.returncode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end for at most `timeout` seconds; return :attr:`returncode`."""
        self._process.join(timeout)
        return self.returncode


def keep_ready(*modules: str) -> None:
    """Start programs that are `ready` as copies of a process that has imported `modules`.

    That process is started with the first of these programs, and ends with this process.
    """
    _READY.set_forkserver_preload(list(modules))


def keep_imports() -> None:
    """Share all present objects with copies made from here on; else the garbage collector would touch them all."""
    gc.freeze()  # without collecting first: that takes longer than the copies of what little garbage there is


def _end_of(wanted: IO[str] | int) -> tuple[IO[str] | None, IO[str] | Connection | None]:
    """The end of an output to read here, if any, and the one that the copy writes to; None for nowhere."""
    if not isinstance(wanted, int):
        return None, wanted
    if wanted != subprocess.PIPE:
        return None, None
    read, write = multiprocessing.Pipe(duplex=False)
    with read:
        return os.fdopen(os.dup(read.fileno())), write


def begin_copy() -> None:
    """In a process of :mod:`multiprocessing` before its work: end when its parent is gone; hear signals."""
    begin_child()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:  # it was gone before that could be arranged
        os.kill(os.getpid(), signal.SIGTERM)


def _run_as_child(*given: Any) -> None:
    """Like :func:`_run_program`, but ends when the process that this is a copy of is gone."""
    begin_copy()
    _run_program(*given)


def _run_for_other(*given: Any) -> None:
    """Like :func:`_run_program`, but ends when the process that requested this one, not its parent, is gone."""
    asked = multiprocessing.parent_process()
    assert asked is not None

    def follow() -> None:
        asked.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=follow, daemon=True).start()
    _run_program(*given)


def _run_program(
    words: Sequence[str],
    environment: Mapping[str, str],
    folder: str,
    stdout: IO[str] | Connection | None,
    stderr: IO[str] | Connection | None,
    begin: Connection,
) -> None:
    """In the copy: become like a separate process, report that by closing `begin`, and run the program."""
    os.setsid()
    forget_signals()
    begin.close()
    with Path(os.devnull).open("w") as nothing:
        os.dup2((stdout or nothing).fileno(), 1)
        os.dup2((stderr or nothing).fileno(), 2)
    sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115 - for as long as the process lives
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    # Before the environment is changed, beside which it looks for the command line. The program's file alone: ROS takes
    # all that follows the last slash for the name of the executable, and names its log by it.
    setproctitle.setproctitle(words[0])
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.argv = list(words)
    try:
        runpy.run_path(words[0], run_name="__main__")
    except KeyboardInterrupt:  # while it was still importing; later on, programs end in good order by themselves
        sys.exit(EXIT_INTERRUPTED)


def forget_signals() -> None:
    """Handle signals as Python does when it starts, whatever the copied process does."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in set(SIGNALS) - {signal.SIGINT}:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup holds SIGHUP back
            signal.signal(number, signal.SIG_DFL)
