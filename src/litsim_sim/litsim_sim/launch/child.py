"""A process of a graph: started, signalled, and its end explained."""

from __future__ import annotations

import contextlib
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
from typing import Any

from litsim_sim.core.errors import EXIT_INTERRUPTED, InputError
from litsim_sim.launch import supervisor
from litsim_sim.launch.forked import ForkedProcess
from litsim_sim.launch.signals import begin_child

GRACE_S = 20.0  # [s] time for the bridge and the recorder to end a run in good order
ROOM_MIN = 65536  # [bytes] free space on a disk below which a process could not have logged why it ended
NAME_MAX = 60  # characters of a stack's command that messages show
LINE_MAX = 1000  # characters of the last line of its log that they show
COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")  # and other commands to a terminal


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
    process: subprocess.Popen[str] | ForkedProcess
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
            stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        except OSError:
            return False
        return stat.rpartition(") ")[2][:1] in ("T", "t")  # after the name, which may hold anything

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
        """Returns how the process ended, with the last error or line of its log, which may say why."""
        status = self.process.returncode
        ending = f"has not ended within {GRACE_S:g} s" if status is None else how_it_ended(status)
        if self.command:  # the format of errors in a foreign log is unknown; the last line is the best guess
            why = self.last_line or "it has said nothing"
        else:
            why = "".join(self.errors[-1:])
            if status is not None and status > 0:
                why = why or self.last_line or self._why_silent()
        return f"{self} {ending}" + (f": {why}" if why else "")

    def _why_silent(self) -> str:
        """Returns the reason for its empty log; empty if unknown."""
        full = shutil.disk_usage(self.log.parent).free < ROOM_MIN
        return f"it could say nothing, as the disk of {self.log.parent} is full" if full else ""

    def __str__(self) -> str:
        if self.command:
            return f"the stack ({textwrap.shorten(shlex.join(self.command), NAME_MAX, placeholder=' …')})"
        return f"process {self.name} ({', '.join(self.nodes)})" if self.nodes else f"node {self.name}"

    @property
    def _lines(self) -> list[str]:
        return self.log.read_text(errors="replace").splitlines()


def _readable(line: str) -> str:
    """Returns `line` without commands to a terminal and other characters that are no text."""
    return "".join(c if c.isprintable() else " " * c.isspace() for c in COLOUR.sub("", line)).strip()


def how_it_ended(status: int) -> str:
    """Text, to follow its name, on how a process ended, by its exit status as of :mod:`subprocess`."""
    if status < 0:
        return f"was ended by {signal.Signals(-status).name}"
    if status == EXIT_INTERRUPTED:
        return "was interrupted"
    return f"ended with exit status {status}"


def start_process(argv: Sequence[str], **options: Any) -> subprocess.Popen[str]:
    """Start a process, in a session of its own, that ends when this thread ends, however that ends.

    `options` are those of ``Popen``.
    """
    return subprocess.Popen(
        argv,
        stdin=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        preexec_fn=begin_child,  # noqa: PLW1509 - two system calls
        **options,
    )


def start_supervised(command: Sequence[str], **options: Any) -> subprocess.Popen[str]:
    """Start a stack's command by a :mod:`.supervisor`, with `options` of ``Popen``; raises as :func:`check_program`."""
    check_program(command)
    return start_process([sys.executable, "-I", "-S", supervisor.__file__, *command], **options)


def check_program(command: Sequence[str]) -> None:
    """Raise InputError if the command that starts a stack does not begin with a program."""
    if shutil.which(command[0]) is None:
        raise InputError(f"{command[0]}: no such program, expected the command that starts a driving stack")
