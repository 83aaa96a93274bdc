"""Process supervisor of a foreign command: started in a session of its own, and ended with all that it has started.

A driving stack is often a script that starts more processes, some of which leave its process group. The launcher
starts this program in its place, which hands signals on to the whole tree and leaves nothing of it behind, however the
command, or the launcher, ends. It needs nothing but Python: ``python supervisor.py COMMAND...`` ends as COMMAND does.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

LOG_MAX, HEAD, TAIL = 16 * 2**20, 8 * 2**20, 2**20  # [B] most of a log, and what is kept of a larger one
GRACE_S = 2.0  # [s] from SIGTERM to SIGKILL, shorter than the launcher's patience
TICK_S = 0.05  # [s] period of checks
NOT_FOUND = 127  # exit status of a command that cannot be started, as shells have it
DIE_WITH_PARENT, SUBREAPER = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER
HANDED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_LIBC = ctypes.CDLL(None)


def descendants(of: int) -> list[int]:
    """Ids of the running processes that process `of` has started, and of those that they have; parents come first."""
    children: dict[int, list[int]] = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            state, parent = file.read_text(errors="replace").rpartition(")")[2].split()[:2]
            if state not in "ZX":  # neither waits to be asked how it ended
                children.setdefault(int(parent), []).append(int(file.parent.name))
    tree = [of]
    for process in tree:  # which grows meanwhile
        tree += children.get(process, [])
    return tree[1:]


def _signal_all(number: int) -> None:
    """Signal the whole tree, parents first: a script whose child is interrupted before it would just go on."""
    for process in descendants(os.getpid()):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, number)


def _end_rest() -> None:
    """End the remaining processes: orphans have become children of this process."""
    until = time.monotonic() + GRACE_S
    _signal_all(signal.SIGTERM)
    while descendants(os.getpid()):
        if time.monotonic() > until:
            _signal_all(signal.SIGKILL)
        time.sleep(TICK_S)


def _bound_log(log: int) -> None:
    """Leave out the middle of the output in the file `log` once it is too large, with a line there that says so.

    The file is open for appending, so that the command goes on after what is kept. A few lines that it writes meanwhile
    may be lost.
    """
    size = os.fstat(log).st_size
    if not stat.S_ISREG(os.fstat(log).st_mode) or size <= LOG_MAX:
        return
    with Path(f"/proc/self/fd/{log}").open("rb") as file:
        file.seek(size - TAIL)
        tail = file.read(TAIL)
    os.ftruncate(log, HEAD)
    os.write(log, b"\n[%d bytes of output are left out here: a log has at most %d]\n" % (size - HEAD - TAIL, LOG_MAX))
    os.write(log, tail)


def _begin() -> None:
    """In the command's process before it starts: make it end with the supervisor, even if the supervisor is killed."""
    _LIBC.prctl(DIE_WITH_PARENT, signal.SIGKILL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, HANDED_ON)


def supervise(command: list[str]) -> int:
    """Run `command` to its end; return its exit status, a signal as a negative number."""
    for number in HANDED_ON:  # shells have what they start in the background ignore SIGINT, and so would the command
        signal.signal(number, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_BLOCK, HANDED_ON)  # taken one by one below
    _LIBC.prctl(SUBREAPER, 1)
    try:
        process = subprocess.Popen(
            command,
            start_new_session=True,
            preexec_fn=_begin,  # noqa: PLW1509 - two system calls
        )
    except OSError as error:
        print(f"error: {command[0]}: cannot be started: {error.strerror or error}", file=sys.stderr)
        return NOT_FOUND
    killed_at = None
    while process.poll() is None:
        info = signal.sigtimedwait(HANDED_ON, TICK_S)
        _bound_log(sys.stdout.fileno())
        if info is not None:
            _signal_all(info.si_signo)
            if info.si_signo != signal.SIGINT:  # the launcher has lost patience, or is gone
                killed_at = killed_at or time.monotonic() + GRACE_S
        if killed_at is not None and time.monotonic() > killed_at:
            _signal_all(signal.SIGKILL)
    _end_rest()
    _bound_log(sys.stdout.fileno())
    return process.returncode


if __name__ == "__main__":
    status = supervise(sys.argv[1:])
    if status < 0:  # end in the same way, so that the parent learns of the signal
        if -status != signal.SIGKILL:
            signal.signal(-status, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, HANDED_ON)
        os.kill(os.getpid(), -status)
    sys.exit(status)
