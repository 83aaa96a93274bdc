"""Batches of runs: in processes of this machine, or over DDS; a run that fails is reported and takes no other along."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import subprocess
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import lru_cache, partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from litsim_policy.run.runner import Runner, record
from litsim_sim.analysis.metrics import METRICS_FILE, compute_metrics
from litsim_sim.core.errors import reason
from litsim_sim.core.parameters import by_stage
from litsim_sim.launch.executables import find_executable
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario


@dataclass(frozen=True)
class Job:
    """One run of a batch.

    Attributes:
        scenario: name or file.
        ego: what drives the ego.
        policy: what moves the background.
        ego_id: vehicle that is the ego.
        parameters: stage, name and value of each that is not at its default.
        label: what tells its row of the table from others with the same policy.
        seed: of everything random in the run; None leaves it to the scenario.
    """

    scenario: str
    ego: str
    policy: str
    ego_id: int
    parameters: tuple[tuple[str, str, Any], ...] = ()
    label: str = ""
    seed: int | None = None

    @property
    def row(self) -> str:
        """Name of the row of the table that the run is counted in: policy and label."""
        return ", ".join(part for part in (self.policy, self.label) if part)

    @property
    def name(self) -> str:
        """Name of the run within its row: scenario and ego, and the seed where one was asked for."""
        run = f"{Path(self.scenario).stem}/{self.ego_id}"
        return run if self.seed is None else f"{run}/{self.seed}"


class RunFailed(Exception):
    """A run of a batch has left no measures; the message says why, in one line."""


@dataclass
class Batch:
    """What has become of the runs of a batch.

    Attributes:
        metrics: of each run that was measured, whether it is valid or not.
        failures: why each of the others was not.
    """

    metrics: dict[Job, dict[str, Any]] = field(default_factory=dict)
    failures: dict[Job, str] = field(default_factory=dict)

    def ordered(self, jobs: Sequence[Job]) -> Batch:
        """The same in the order of `jobs`, not in that in which they ended."""
        metrics = {job: self.metrics[job] for job in jobs if job in self.metrics}
        return Batch(metrics, {job: self.failures[job] for job in jobs if job in self.failures})


def run_in_process(job: Job) -> dict[str, Any]:
    """Metrics of a run in this process, without SUMO: it would only show what is measured.

    Raises:
        InputError: the run cannot be run.
    """
    scenario = _scenario(job.scenario).around(job.ego_id, job.seed)
    return compute_metrics(record(Runner(RunPlan(scenario, job.ego, job.policy, by_stage(job.parameters)))))


@lru_cache(maxsize=8)
def _scenario(name: str) -> Scenario:
    """A scenario, read once in a process for all its egos and policies."""
    return Scenario.load(name)


def run_graph(job: Job, folder: Path) -> dict[str, Any]:
    """Metrics of a run over DDS, valid or not, and as `recording` the name of its folder below `folder`.

    Raises:
        RunFailed: the launcher failed; the message is its own.
        InputError: there is no launcher.
    """
    out = folder / re.sub(r"[^\w.=]+", "-", f"{job.ego}-{job.row}-{job.name}")
    (out / METRICS_FILE).unlink(missing_ok=True)  # of an earlier run, which is not to be taken for this one's
    launch = find_executable("litsim_sim", "launch")
    command = [str(launch), "--quiet", "--overwrite", "--scenario", job.scenario, "--out", str(out)]
    command += ["--ego", job.ego, "--policy", job.policy, "--ego-id", str(job.ego_id)]
    settings = [f"{stage}.{name}={json.dumps(value)}" for stage, name, value in job.parameters]
    command += ["--set", *settings] if settings else []
    command += [] if job.seed is None else ["--seed", str(job.seed)]
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if not (out / METRICS_FILE).is_file():
        said = done.stderr.strip().splitlines() or [f"the launcher ended with status {done.returncode}"]
        raise RunFailed(said[-1].removeprefix("error: "))
    metrics: dict[str, Any] = json.loads((out / METRICS_FILE).read_text())
    return metrics | {"recording": out.name}


def run_batch(jobs: Sequence[Job], processes: int, graph_folder: Path | None, done: Callable[[], object]) -> Batch:
    """Run every job.

    Args:
        jobs: to run.
        processes: at a time; runs over DDS go one at a time, for they are several processes themselves.
        graph_folder: where runs over DDS are recorded; None runs in process.
        done: called after each run, whatever has become of it.
    """
    batch = Batch()
    with ThreadPoolExecutor(processes if graph_folder is None else 1) as threads, _Workers() as workers:
        run = workers.run if graph_folder is None else partial(run_graph, folder=graph_folder)
        pending = {threads.submit(run, job): job for job in jobs}
        try:
            for future in as_completed(pending):
                _take(batch, pending[future], future)
                done()
        finally:
            threads.shutdown(wait=False, cancel_futures=True)  # interrupted: what has not begun will not
    return batch.ordered(jobs)


def _take(batch: Batch, job: Job, future: Future[dict[str, Any]]) -> None:
    error = future.exception()
    if error is None:
        batch.metrics[job] = future.result()
    else:
        batch.failures[job] = str(error) if isinstance(error, RunFailed) else reason(error)


class _Workers:
    """A process for each thread that runs jobs: libsumo holds one simulation a process, and a crash ends no other."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._mine = threading.local()
        self._all: list[Any] = []

    def __enter__(self) -> _Workers:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._all:
            process.terminate()

    def run(self, job: Job) -> dict[str, Any]:
        """Metrics of a run in this thread's process.

        Raises:
            RunFailed: the run has raised an error, or its process has ended.
        """
        if not hasattr(self._mine, "process"):
            self._start()
        try:
            self._mine.pipe.send(job)
            found: dict[str, Any] | str = self._mine.pipe.recv()
        except (EOFError, OSError):
            self._mine.process.join()
            status = self._mine.process.exitcode
            del self._mine.process
            raise RunFailed(f"its process {_ended(status)}") from None
        if isinstance(found, str):
            raise RunFailed(found)
        return found

    def _start(self) -> None:
        self._mine.pipe, theirs = self._context.Pipe()
        self._mine.process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
        self._mine.process.start()
        self._all.append(self._mine.process)
        theirs.close()  # else its end would not be noticed


def _serve(pipe: Connection) -> None:
    """The process of a worker: metrics of every job that comes, or why there are none."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; who has begun this one ends it
    while True:
        job = pipe.recv()
        try:
            found: dict[str, Any] | str = run_in_process(job)
        except Exception as error:  # noqa: BLE001 - whatever it is, the others are to go on, and the table is to say it
            found = reason(error)
        pipe.send(found)


def _ended(status: int) -> str:
    if status < 0:
        return f"was ended by {signal.Signals(-status).name}"
    return f"ended with exit status {status}"
