"""The processes of one graph: started each in a group of its own, watched, and ended in good order."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

from tqdm import tqdm

from litsim_sim.core.errors import EXIT_FAILED
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.launch.child import GRACE_S, Child, start_process, start_supervised
from litsim_sim.launch.domain import EMPTY, HOLDER, is_known_empty
from litsim_sim.launch.forked import ForkedProcess
from litsim_sim.launch.middleware import LOOPBACK, RANGE, enclave_setting, middleware_settings
from litsim_sim.launch.signals import signals_deferred
from litsim_sim.record.seal import KEY_VARIABLE, RunFacts

KILL_S = 3.0  # [s] between SIGINT, SIGTERM and SIGKILL
QUIET_S = 120.0  # [s] longest time without a sign of life of a running bridge, which may be loading or computing
TOLD_S = 1.0  # [s] for the bridge to end the run after a node has told it that it ends
STOPPED_TIMEOUTS = 2.0  # the same for a stopped one, as a multiple of the time limit for the answers to a step
LOG_FOLDER = "log"  # folder of the logs in that of a recording
STACK = "ads"
"""Name of the process that a user's command starts to drive the ego; its log is `ads.log`."""


class GraphFailed(Exception):
    """A node died or the bridge ended the run; the message says which and why."""


class Graph:
    """The processes of one run."""

    def __init__(self, out: Path, domain_id: int, answer_timeout_s: float = 5.0) -> None:
        """Prepare the folder `out` for the logs of a run in `domain_id`, whose steps wait for `answer_timeout_s`."""
        self._stopped_s = STOPPED_TIMEOUTS * answer_timeout_s
        self._log_folder = out / LOG_FOLDER
        self._log_folder.mkdir(parents=True, exist_ok=True)
        for log in self._log_folder.glob("*.log"):  # of a run that is overwritten
            log.unlink()
        own = {"ROS_DOMAIN_ID": str(domain_id), HOLDER: str(os.getpid()), "PYTHONUNBUFFERED": "1"}
        self._environment = {RANGE: "LOCALHOST"} | os.environ | own
        # The bridge need not look for other runs: this is decided before any process of this graph exists.
        self._of_bridge = {EMPTY: str(domain_id)} if is_known_empty(domain_id, self._environment) else {}
        self.children: dict[str, Child] = {}
        self._progress: Progress | None = None

    def start(
        self,
        name: str,
        path: Path,
        parameters: Mapping[str, object],
        *,
        forked: bool = False,
        several: Sequence[str] = (),
    ) -> None:
        """Start the executable at `path`, in Python, as node `name`, with ROS parameters by name, or by NODE:NAME.

        If `forked`, it runs in a copy of this process, see :mod:`litsim_sim.launch.forked`. `several` are the
        names of its nodes if it has several, and its arguments.
        """
        argv = [str(path), *several, *ros_arguments(parameters)]
        environment = self._environment | (self._of_bridge if name == BRIDGE else {})
        with self._log(name) as log, signals_deferred():
            out = subprocess.PIPE if name == BRIDGE else log  # the bridge's lines are read
            process = (
                ForkedProcess(argv, environment, stdout=out, stderr=log)
                if forked
                else start_process(argv, env=environment, stdout=out, stderr=log)
            )
            self.children[name] = Child(name, process, Path(log.name), nodes=several)

    def start_stack(self, command: Sequence[str]) -> None:
        """Start the command that drives the ego, in the domain of the graph; raises as :func:`.check_program`.

        It stays on the loopback interface where the nodes do, unless the user has chosen settings of the middleware.
        """
        environment = self._environment | enclave_setting(self._environment, STACK, command)
        environment.pop(KEY_VARIABLE, None)
        settings = middleware_settings(environment)
        if str(LOOPBACK) in settings.values():
            environment |= settings
        with self._log(STACK) as log, signals_deferred():
            process = start_supervised(command, env=environment, stdout=log, stderr=log)
            self.children[STACK] = Child(STACK, process, Path(log.name), tuple(command))

    @property
    def invalid(self) -> str:
        """Why the run, which :meth:`watch` has seen end, is not valid; empty if the bridge knows of nothing."""
        if self._progress is None:
            return ""
        self._progress.join(timeout=1.0)  # what the bridge has printed last
        return self._progress.invalid

    def facts(self) -> RunFacts:
        """Returns what the run came to, as the bridge has told after its end; raises GraphFailed if it has not."""
        told = set(self._progress.facts) if self._progress else set()
        if len(told) != 1:
            raise GraphFailed(f"node {BRIDGE} has told {len(told)} ends of the run on its output, expected one")
        return told.pop()

    def _log(self, name: str) -> IO[str]:
        return (self._log_folder / f"{name}.log").open("a")  # which was removed; the supervisor may shorten it

    def watch(self, quiet: bool) -> None:
        """Wait for the run to end; raises GraphFailed if a node dies before, or the bridge fails or goes quiet."""
        bridge, recorder = self.children[BRIDGE], self.children[RECORDER]
        assert bridge.process.stdout is not None
        self._progress = Progress(bridge.process.stdout, quiet)
        self._progress.start()
        while bridge.running:
            dead = [c for c in self.children.values() if not c.running and c is not bridge and not self._may_leave(c)]
            if dead:
                if all(child.process.returncode >= 0 for child in dead):
                    _wait([bridge], TOLD_S)  # a node has told it why it ends
                if self._heard_of_failure(dead):
                    _wait([bridge], GRACE_S)  # it has told them that the run is over; the recorder is still writing
                if bridge.running and not all(map(self._may_leave, dead)):
                    raise GraphFailed("; ".join(child.obituary() for child in dead))
            self._check_alive(bridge, self._progress)
            time.sleep(0.05)
        _wait([recorder], GRACE_S if bridge.process.returncode == 0 else 0.0)
        if bridge.process.returncode == EXIT_FAILED and bridge.errors:
            stopped = [str(child) for child in self.children.values() if child.running and child.stopped]
            why = f"; stopped, by a signal or a debugger: {', '.join(stopped)}" if stopped else ""
            raise GraphFailed(bridge.errors[-1] + why + self.about_the_stack(bridge.errors[-1]))
        for child in (bridge, recorder):
            if child.process.returncode != 0:
                raise GraphFailed(child.obituary())

    def _check_alive(self, bridge: Child, progress: Progress) -> None:
        """Raise GraphFailed if the bridge, which watches all others, has shown no sign of life for too long."""
        quiet_s = time.monotonic() - progress.heard
        if quiet_s > min(self._stopped_s, QUIET_S) and quiet_s > (self._stopped_s if bridge.stopped else QUIET_S):
            how = "it is stopped, by a signal or a debugger" if bridge.stopped else "it runs, but does not go on"
            raise GraphFailed(f"{bridge}: no sign of life for {quiet_s:.0f} s, at step {progress.step}; {how}")

    def _may_leave(self, child: Child) -> bool:
        """Returns whether a process may end before the bridge: a recorder that is done, or a stack after the end."""
        if child.name == RECORDER:
            return child.process.returncode == 0
        return child.name == STACK and self._progress is not None and self._progress.complete

    def _heard_of_failure(self, dead: Sequence[Child]) -> bool:
        """Returns whether all of `dead` have ended after the bridge announced that the run has failed."""
        failed = self._progress.failed if self._progress else None
        return failed is not None and all(child.ended_at > failed for child in dead)

    def about_the_stack(self, why: str) -> str:
        """Returns a text to add to the bridge's reason `why`: how the stack ended before that, or its last output."""
        stack = self.children.get(STACK)
        if stack is None:
            return ""
        if self._progress:
            self._progress.join(timeout=1.0)  # what the bridge has printed last
        if not stack.running and not (stack.process.returncode == 0 and self._heard_of_failure([stack])):
            return f"; {stack.obituary()}"
        last = stack.last_line or "nothing"
        return f"; {stack} was running" + ("" if why in last else f", and said last: {last}")

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


def ros_arguments(parameters: Mapping[str, object]) -> list[str]:
    """Returns the arguments that set ROS parameters, by name or NODE:NAME; of texts, YAML would make numbers."""
    quoted = {
        key: json.dumps(value, ensure_ascii=False) if isinstance(value, str | tuple) else value
        for key, value in parameters.items()
    }
    return ["--ros-args", *(word for key, value in quoted.items() for word in ("-p", f"{key}:={value}"))]


class Progress(threading.Thread):
    """Reads the bridge's lines; every line is a sign of life.

    Unless `quiet`, `step K of N` is shown as a bar, and `note TEXT`, what the run has been waiting for, printed once.
    With `failed at T s` the bridge announces that the run has failed, before it tells the nodes and the stack, and with
    `facts JSON` what the run came to.

    Attributes:
        complete: whether the last step has been answered.
        step: last step named; 0 before the first.
        heard: monotonic time of the last line [s].
        invalid: why the run is not valid, once it has ended; empty if the bridge knows of nothing.
        failed: time at which the bridge was about to tell the nodes that the run has failed, on the monotonic clock,
            which all processes share [s]; None if it has not.
        facts: what the run came to, each time that it was told.
    """

    def __init__(self, lines: IO[str], quiet: bool) -> None:
        super().__init__(daemon=True)
        self._lines, self._quiet = lines, quiet
        self.complete = False
        self.step = 0
        self.heard = time.monotonic()
        self.invalid = ""
        self.failed: float | None = None
        self.facts: list[RunFacts] = []

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        bar, noted = None, ""
        for line in self._lines:
            self.heard = time.monotonic()
            match line.split():
                case ["note", *_] if line != noted and not self._quiet:
                    noted = line
                    tqdm.write(line.removeprefix("note ").rstrip(), file=sys.stderr)
                case ["alive", "at", "step", step]:
                    self.step = int(step)
                case ["invalid", *_]:
                    self.invalid = line.removeprefix("invalid ").rstrip()
                case ["facts", *_]:
                    self.facts.append(RunFacts.of_text(line.removeprefix("facts ")))
                case ["failed", "at", time_s, "s"]:
                    self.failed = float(time_s)
                case ["step", step, "of", total]:
                    self.step, self.complete = int(step), step == total
                    if not self._quiet:
                        bar = bar or tqdm(total=int(total), unit="step", dynamic_ncols=True)
                        bar.update(self.step - bar.n)
        if bar is not None:
            bar.close()


def _wait(children: list[Child], timeout: float) -> None:
    """Wait until all of `children` have ended, or for `timeout` seconds."""
    until = time.monotonic() + timeout
    while any(child.running for child in children) and time.monotonic() < until:
        time.sleep(0.02)
