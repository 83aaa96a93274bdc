"""A process of a graph: started so that it does not outlive its parent, signalled, and its end explained."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import IO, Any, Protocol

from litsim_sim.core.errors import EXIT_INTERRUPTED, InputError
from litsim_sim.launch import supervisor

GRACE_S = 20.0  # [s] time for the bridge and the recorder to end a run in good order
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
STATE = re.compile(r"\) ")  # in /proc/PID/stat the state follows the name, which may hold anything else
ROOM_MIN = 65536  # [bytes] free space on a disk below which a process could not have logged why it ended
NAME_MAX = 60  # characters of a stack's command that messages show
LINE_MAX = 1000  # characters of the last line of its log that they show
COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")  # and other commands to a terminal

_LIBC = ctypes.CDLL(None)


class Process(Protocol):
    """The interface of a process, however it was started; see :class:`subprocess.Popen`."""

    @property
    def pid(self) -> int:
        """Its id, and that of its process group."""

    @property
    def returncode(self) -> int | Any:
        """Its exit status, the number of the signal that has ended it as a negative one, None before :meth:`poll`."""

    @property
    def stdout(self) -> IO[str] | None:
        """Its standard output, if that is a pipe."""

    def poll(self) -> int | None:
        """Return :attr:`returncode` if it has ended, else None."""


@dataclass
class Child:
    """A process of the graph, in a process group of its own, its output in a log file.

    Attributes:
        name: name of the node, or :data:`litsim_sim.launch.processes.STACK`.
        command: command of a stack, as the user gave it; empty for a node.
        nodes: names of its nodes, if these are several.
        ended_at: monotonic time at which it was first seen to have ended [s]; infinite while it runs.
    """

    name: str
    process: Process
    log: Path
    command: Sequence[str] = ()
    nodes: Sequence[str] = ()
    ended_at: float = inf

    def signal(self, number: int) -> None:
        """Signal the whole group; `ros2 run`-like wrappers pass nothing on."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)
            os.killpg(self.process.pid, signal.SIGCONT)  # one that is stopped takes no other signal

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        if self.process.poll() is None:
            return True
        self.ended_at = min(self.ended_at, time.monotonic())
        return False

    @property
    def stopped(self) -> bool:
        """Whether the process is stopped, by SIGSTOP or a debugger."""
        try:
            return STATE.split(Path(f"/proc/{self.process.pid}/stat").read_text())[1][:1] in ("T", "t")
        except (OSError, IndexError):
            return False

    @property
    def errors(self) -> list[str]:
        """Errors in its log."""
        return [line.removeprefix("error: ") for line in self._lines if line.startswith("error: ") or "[ERROR]" in line]

    @property
    def last_line(self) -> str:
        """The last non-empty line of its log, shortened, and without what is no text; empty without one."""
        last = next(filter(None, map(_readable, reversed(self._lines))), "")
        return last if len(last) <= LINE_MAX else f"{last[:LINE_MAX]} …"

    def obituary(self) -> str:
        """How the process ended, with the last error or line of its log, which may say why."""
        code, words = self.process.returncode, self.errors
        how = f"has not ended within {GRACE_S:g} s" if code is None else how_it_ended(code)
        if code is not None and code > 0:
            words = words or ([self.last_line] if self.last_line else self._why_silent())
        if self.command:  # the format of errors in a foreign log is unknown; the last line is the best guess
            words = [self.last_line or "it has said nothing"]
        return f"{self} {how}{''.join(f': {line}' for line in words[-1:])}"

    def _why_silent(self) -> list[str]:
        """The reason for its empty log, if known."""
        full = shutil.disk_usage(self.log.parent).free < ROOM_MIN
        return [f"it could say nothing, as the disk of {self.log.parent} is full"] if full else []

    def __str__(self) -> str:
        if self.command:
            return f"the stack ({textwrap.shorten(shlex.join(self.command), NAME_MAX, placeholder=' …')})"
        return f"process {self.name} ({', '.join(self.nodes)})" if self.nodes else f"node {self.name}"

    @property
    def _lines(self) -> list[str]:
        return self.log.read_text(errors="replace").splitlines()


def _readable(line: str) -> str:
    """`line` without commands to a terminal and other characters that are no text."""
    return "".join(c if c.isprintable() else " " * c.isspace() for c in COLOUR.sub("", line)).strip()


def how_it_ended(status: int) -> str:
    """Text, to follow its name, on how a process ended, by its exit status as of :mod:`subprocess`."""
    if status < 0:
        return f"was ended by {signal.Signals(-status).name}"
    if status == EXIT_INTERRUPTED:
        return "was interrupted"
    return f"ended with exit status {status}"


def start_process(argv: Sequence[str], **given: Any) -> subprocess.Popen[str]:
    """Start a process that ends when this thread ends, however that ends; `given` is passed to ``Popen``."""
    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        text=True,
        preexec_fn=begin_child,  # noqa: PLW1509 - two system calls
        **given,
    )


def start_supervised(command: Sequence[str], **given: Any) -> subprocess.Popen[str]:
    """Start a stack's command by a :mod:`.supervisor`, in a session of its own; `given` is passed to ``Popen``.

    Raises:
        InputError: there is no such program.
    """
    check_program(command)
    argv = [sys.executable, "-I", "-S", supervisor.__file__, *command]
    return start_process(argv, start_new_session=True, **given)


def check_program(command: Sequence[str]) -> None:
    """Check that the command that starts a stack begins with a program.

    Raises:
        InputError: there is no such program.
    """
    if shutil.which(command[0]) is None:
        raise InputError(f"{command[0]}: no such program, expected the command that starts a driving stack")


def end_with_parent() -> None:
    """Make this process end when the thread that started it ends, however that ends."""
    _LIBC.prctl(supervisor.DIE_WITH_PARENT, signal.SIGTERM)


def begin_child() -> None:
    """In a child before its program starts: end when the launcher is gone; hear signals."""
    end_with_parent()
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
