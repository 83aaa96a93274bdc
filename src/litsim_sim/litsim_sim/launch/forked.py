"""Programs of the workspace in copies of a process, which have all its modules already.

The launcher forks the nodes of a run: the first step comes 2.3 times as late if each node is a program that imports
numpy, numba and rclpy for itself (1.99 to 2.60), and the run takes 2.9 times the processor time (4 pairs). The
launchers and workers of a campaign are forked from a process that holds what was passed to :func:`preload`: a campaign
of 8 runs over DDS takes 1.49 times as long if each launcher imports everything for itself (1.17 to 1.83, 3 pairs).

To a program, a copy looks like a process of its own: it has its own session, environment, output and name, and ends
when the process that requested it is gone. The copied process must not have made a DDS participant yet, and runs no
Python code in other threads. Copies do not get the threads of libraries; pyarrow, OpenBLAS and jemalloc, which have
some, can handle that.
"""

from __future__ import annotations

import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import IO, Any

import setproctitle

from litsim_sim.core.errors import EXIT_INTERRUPTED
from litsim_sim.launch.signals import SIGNALS, end_with_parent, reset_handlers

_HERE, _PRELOADED = multiprocessing.get_context("fork"), multiprocessing.get_context("forkserver")


class ForkedProcess:
    """A Python program in a copy of a process, with that part of the interface of ``Popen`` that is used.

    Attributes:
        stdout, stderr: to read its output from, if that is a pipe.
    """

    def __init__(
        self,
        argv: Sequence[str],
        environment: Mapping[str, str],
        *,
        stdout: IO[str] | int,
        stderr: IO[str] | int,
        preloaded: bool = False,
    ) -> None:
        """Start the program in file ``argv[0]`` in this folder, with `environment` as its whole environment.

        Its output goes to a file, ``PIPE`` or ``DEVNULL`` of :mod:`subprocess`. A `preloaded` one is a copy of
        the process of :func:`preload`, to which no file can be given, rather than of this one.
        """
        self.stdout, out = _end_of(stdout)
        self.stderr, err = _end_of(stderr)
        begun, begin = multiprocessing.Pipe(duplex=False)
        start = start_preloaded if preloaded else start_forked
        self._process = start(_run_program, tuple(argv), dict(environment), str(Path.cwd()), out, err, begin)
        for end in (out, err, begin):
            if isinstance(end, Connection):
                end.close()  # else the end of the process would not be noticed
        with begun:
            begun.poll(None)  # until then its process group cannot be signalled

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
        """Wait for its end for at most `timeout` seconds; return :attr:`returncode`."""
        self._process.join(timeout)
        return self.returncode


def start_forked(target: Callable[..., None], *arguments: Any) -> BaseProcess:
    """Call `target` in a copy of this process; it ends when this process ends."""
    process = _HERE.Process(target=_run_as_child, args=(target, *arguments), daemon=True)
    process.start()
    return process


def _run_as_child(target: Callable[..., None], *arguments: Any) -> None:
    """Call `target`; end when the process that this is a copy of is gone."""
    end_with_parent()
    parent = multiprocessing.parent_process()
    if parent is None or os.getppid() != parent.pid:  # it was gone before that could be arranged
        os.kill(os.getpid(), signal.SIGTERM)
    target(*arguments)


def preload(*modules: str) -> None:
    """Let the process that preloaded ones are copies of import `modules`; it is started with the first of them."""
    _PRELOADED.set_forkserver_preload(list(modules))


def start_preloaded(target: Callable[..., None], *arguments: Any) -> BaseProcess:
    """Call `target` in a copy of the process of :func:`preload`; it ends when this process ends.

    Ctrl-C, which goes to all processes of a terminal, is blocked in it until it unblocks that.
    """
    process = _PRELOADED.Process(target=_follow, args=(target, *arguments))
    resource_tracker.ensure_running()  # else it is started with the first such process, and unblocks Ctrl-C
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return process


def _follow(target: Callable[..., None], *arguments: Any) -> None:
    """Call `target`; end when the process that requested this one, which is not its parent, is gone."""
    requester = multiprocessing.parent_process()
    assert requester is not None

    def follow() -> None:
        requester.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=follow, daemon=True).start()
    target(*arguments)


def _end_of(wanted: IO[str] | int) -> tuple[IO[str] | None, IO[str] | Connection | None]:
    """Returns the end of an output to read here, if any, and the one that the copy writes to; None for nowhere."""
    if not isinstance(wanted, int):
        return None, wanted
    if wanted != subprocess.PIPE:
        return None, None
    read, write = multiprocessing.Pipe(duplex=False)
    with read:
        return os.fdopen(os.dup(read.fileno())), write


def _run_program(
    argv: Sequence[str],
    environment: Mapping[str, str],
    folder: str,
    stdout: IO[str] | Connection | None,
    stderr: IO[str] | Connection | None,
    begin: Connection,
) -> None:
    """In the copy: become like a separate process, report that by closing `begin`, and run the program."""
    os.setsid()
    reset_handlers()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    begin.close()
    with Path(os.devnull).open("w") as nothing:
        os.dup2((stdout or nothing).fileno(), 1)
        os.dup2((stderr or nothing).fileno(), 2)
    sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115 - for as long as the process lives
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    # Before the environment is changed, beside which it looks for the command line. The program's file alone: ROS takes
    # all that follows the last slash for the name of the executable, and names its log by it.
    setproctitle.setproctitle(argv[0])
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    sys.argv = list(argv)
    try:
        runpy.run_path(argv[0], run_name="__main__")
    except KeyboardInterrupt:  # while it was still importing; later on, programs end in good order by themselves
        sys.exit(EXIT_INTERRUPTED)
