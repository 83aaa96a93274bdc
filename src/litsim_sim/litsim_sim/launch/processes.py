"""The processes of one graph: started each in a group of its own, watched, and ended in good order."""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from tqdm import tqdm

from litsim_sim.core.errors import EXIT_FAILED
from litsim_sim.core.stages import BRIDGE, RECORDER

GRACE_S = 8.0  # [s] that the bridge and the recorder get to end a run in good order
KILL_S = 3.0  # [s] between SIGINT, SIGTERM and SIGKILL
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables by which a user has Fast DDS read settings; where one is set, the launcher leaves it at that."""
DISCOVERY = Path(__file__).with_name("discovery.xml")
"""Settings by which nodes that are started together find each other in tenths of a second."""
DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG

_LIBC = ctypes.CDLL(None)


@dataclass
class Child:
    """A node's process, in a process group of its own, its output in a log file."""

    name: str
    process: subprocess.Popen[str]
    log: Path

    def signal(self, number: int) -> None:
        """Signal the whole group; `ros2 run`-like wrappers pass nothing on."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self.process.poll() is None

    @property
    def errors(self) -> list[str]:
        """Errors in its log."""
        lines = self.log.read_text(errors="replace").splitlines()
        return [line.removeprefix("error: ") for line in lines if line.startswith("error: ") or "[ERROR]" in line]

    def obituary(self) -> str:
        """How the process ended, and the last thing in its log where that may say why."""
        code, words = self.process.returncode, self.errors
        if code is None:
            how = f"has not ended within {GRACE_S:g} s"
        elif code < 0:
            how = f"was ended by {signal.Signals(-code).name}"
        else:
            how = f"ended with exit status {code}"
            words = words or (self.log.read_text(errors="replace").strip().splitlines() if code > 0 else [])
        return f"node {self.name} {how}{''.join(f': {line}' for line in words[-1:])}"


class GraphFailed(Exception):
    """A node died or the bridge ended the run; the message says which and why."""


class Graph:
    """The processes of one run."""

    def __init__(self, out: Path, domain_id: int) -> None:
        self._log_folder = out / "log"
        self._log_folder.mkdir(parents=True, exist_ok=True)
        for log in self._log_folder.glob("*.log"):  # of a run that is overwritten
            log.unlink()
        discovery = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        profiles = {} if any(name in os.environ for name in PROFILES) else {PROFILES[0]: str(DISCOVERY)}
        self._environment = (
            os.environ
            | profiles
            | {
                "ROS_DOMAIN_ID": str(domain_id),
                "ROS_AUTOMATIC_DISCOVERY_RANGE": discovery,
                "PYTHONUNBUFFERED": "1",
            }
        )
        self.children: dict[str, Child] = {}
        self._progress: threading.Thread | None = None

    def start(self, name: str, path: Path, parameters: dict[str, object]) -> None:
        """Start the executable at `path` as node `name`."""
        arguments = [str(path), "--ros-args"]
        for key, value in parameters.items():  # a text in quotes: YAML would find numbers and worse in it
            quoted = json.dumps(value, ensure_ascii=False) if isinstance(value, str | tuple) else value
            arguments += ["-p", f"{key}:={quoted}"]
        log = self._log_folder / f"{name}.log"
        with log.open("w") as stream, _held_back():
            process = subprocess.Popen(
                arguments,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if name == BRIDGE else stream,
                stderr=stream,
                text=True,
                start_new_session=True,
                preexec_fn=_begin_child,  # noqa: PLW1509 - two system calls
            )
            self.children[name] = Child(name, process, log)

    def watch(self, quiet: bool) -> None:
        """Wait for the run to end.

        Raises:
            GraphFailed: a node died before the run was over, or the bridge says that the run failed.
        """
        bridge, recorder = self.children[BRIDGE], self.children[RECORDER]
        assert bridge.process.stdout is not None
        self._progress = threading.Thread(target=_show_progress, args=(bridge.process.stdout, quiet), daemon=True)
        self._progress.start()
        while bridge.running:
            dead = [c for c in self.children.values() if not c.running and c is not bridge]
            dead = [c for c in dead if c is not recorder or recorder.process.returncode != 0]
            if dead:
                if all(child.process.returncode >= 0 for child in dead):
                    _wait([bridge], 1.0)  # they have told it, and it ends over it
                if bridge.running:
                    raise GraphFailed("; ".join(child.obituary() for child in dead))
            time.sleep(0.05)
        _wait([recorder], GRACE_S if bridge.process.returncode == 0 else 0.0)
        if bridge.process.returncode == EXIT_FAILED and bridge.errors:
            raise GraphFailed(bridge.errors[-1])
        for child in (bridge, recorder):
            if child.process.returncode != 0:
                raise GraphFailed(child.obituary())

    def stop(self) -> None:
        """End what still runs: first the bridge, which tells the recorder to close its file, then the rest."""
        bridge, recorder = self.children.get(BRIDGE), self.children.get(RECORDER)
        if bridge and bridge.running:
            bridge.signal(signal.SIGINT)
            _wait([bridge], GRACE_S if recorder and recorder.running else 0.5)
        if recorder and bridge and not bridge.running and bridge.process.returncode >= 0:
            _wait([recorder], KILL_S)  # it was told to close its file
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            running = [c for c in self.children.values() if c.running]
            for child in running:
                child.signal(number)
            _wait(running, KILL_S)
        if self._progress:
            self._progress.join(timeout=1.0)
        killed = any(c.process.returncode == -signal.SIGKILL for c in self.children.values())
        if killed and (fastdds := shutil.which("fastdds")):  # it leaves its shared memory behind
            with contextlib.suppress(subprocess.SubprocessError):
                subprocess.run([fastdds, "shm", "clean"], capture_output=True, check=False, timeout=10)


def _show_progress(lines: IO[str], quiet: bool) -> None:
    """A bar from the bridge's lines `step K of N`."""
    bar = None
    for line in lines:
        words = line.split()
        if quiet or len(words) != 4 or words[0] != "step":
            continue
        step, total = int(words[1]), int(words[3])
        bar = bar or tqdm(total=total, unit="step", dynamic_ncols=True)
        bar.update(step - bar.n)
    if bar is not None:
        bar.close()


def _wait(children: list[Child], timeout: float) -> None:
    """Until all of `children` have ended, or for `timeout` seconds."""
    until = time.monotonic() + timeout
    while any(child.running for child in children) and time.monotonic() < until:
        time.sleep(0.02)


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """Signals wait until this is over; Python swallows the exceptions of those that come amid a fork."""
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _begin_child() -> None:
    """In a child before its program starts: end when the launcher is gone, whatever has ended it; hear signals."""
    _LIBC.prctl(DIE_WITH_PARENT, signal.SIGTERM)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def without_interrupts(action: Callable[[], None]) -> None:
    """Run `action` with Ctrl-C held back, so that impatience leaves no orphans."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    try:
        action()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
