"""Processes that run batches of cases, so that a crash of one run, also in native code, ends no other."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

from litsim_eval.campaign.case import Case
from litsim_eval.runs.batched import run_batch
from litsim_eval.runs.case_run import RunOutcome
from litsim_sim.launch.child import how_it_ended
from litsim_sim.launch.forked import start_forked, start_preloaded
from litsim_sim.launch.signals import SIGNALS, reset_handlers, signals_deferred


class WorkerEnded(Exception):
    """The process that was to run cases has ended, or was never begun; the message says how, in one line."""


@dataclass(frozen=True)
class Worker:
    """A process that serves requests, and the pipe to it."""

    process: BaseProcess
    pipe: Connection

    @classmethod
    def started(cls, start: Callable[..., BaseProcess], main: Callable[[Connection], None]) -> Worker:
        """Returns a worker whose process `start` makes, with `main` as its main function."""
        ours, theirs = Pipe()
        process = start(main, theirs)
        theirs.close()  # so that the end of the process closes the pipe
        return cls(process, ours)

    def obituary(self) -> str:
        """Waits for the end of the process, and returns how it has ended."""
        self.process.join()
        return f"its process {how_it_ended(self.process.exitcode or 0)}"


class WorkerPool:
    """Processes that wait for requests; each request takes one of them, and a new one if all are taken."""

    def __init__(self, main: Callable[[Connection], None]) -> None:
        """`main` is the main function of the processes."""
        self._main = main
        self._all: list[Worker] = []
        self._idle: list[Worker] = []
        self._closed = False
        self._starting = threading.Lock()

    def _taken(self) -> Worker:
        """Returns an idle process, or a new one; raises WorkerEnded if the pool is closed and no process is idle."""
        with self._starting:
            if self._idle:
                return self._idle.pop()
            if self._closed:
                raise WorkerEnded("its process was closed before it began")
            return self._started(start_preloaded)

    def _started(self, start: Callable[..., BaseProcess]) -> Worker:
        """Returns a new process."""
        self._all.append(Worker.started(start, self._main))
        return self._all[-1]


class Workers(WorkerPool):
    """One process for each thread that runs cases; a context manager.

    On entry, `count` processes are forked from this one, which must not have started those threads yet: they have all
    its modules, and a campaign of 20 runs would take 1.29 times as long with preloaded ones (1.29 to 1.33, 3 pairs). A
    process that has ended is replaced by a preloaded one.
    """

    def __init__(self, count: int) -> None:
        super().__init__(_serve)
        self._count = count

    def __enter__(self) -> Workers:
        with signals_deferred():
            self._idle = [self._started(start_forked) for _ in range(self._count)]
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        for worker in self._all:
            worker.process.join()  # else files that this process had open, such as locks, would still be open in copies

    def close(self) -> None:
        """Kills all processes, which also ends stopped ones, and starts no further ones."""
        with self._starting:
            self._closed = True
            for worker in self._all:
                worker.process.kill()

    def run(self, case: Case, folder: Path | None = None) -> RunOutcome:
        """Runs a case in one of the processes; its picture is written to `folder`."""
        (outcome,) = self.run_batch([case], [folder])
        return outcome

    def run_batch(self, cases: Sequence[Case], folders: Sequence[Path | None]) -> list[RunOutcome]:
        """Runs cases in one of the processes, together where possible; their pictures are written to their `folders`.

        The wall time is divided equally among the cases. If the process ends, the cases are repeated one by one to find
        the one that ends it.
        """
        begin = time.monotonic()
        try:
            outcomes = self._ask(cases, folders)
        except WorkerEnded as error:
            if len(cases) > 1:
                return [self.run(case, folder) for case, folder in zip(cases, folders, strict=True)]
            outcomes = [RunOutcome(None, str(error))]
        share = (time.monotonic() - begin) / len(cases)
        return [replace(outcome, wall_s=share) for outcome in outcomes]

    def _ask(self, cases: Sequence[Case], folders: Sequence[Path | None]) -> list[RunOutcome]:
        """Returns outcomes of cases; raises WorkerEnded if the process has ended, or the workers are closed."""
        worker = self._taken()
        try:
            worker.pipe.send((cases, folders))
            outcomes: list[RunOutcome] = worker.pipe.recv()
        except (EOFError, OSError):
            raise WorkerEnded(worker.obituary()) from None
        self._idle.append(worker)
        return outcomes


def _serve(pipe: Connection) -> None:
    """Main function of a worker's process: run the batches received, and send their results."""
    serve(pipe, run_batch)


def serve(pipe: Connection, answer: Callable[..., object]) -> None:
    """Send the `answer` to what comes through a pipe, its arguments, until the other end is closed."""
    reset_handlers()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the campaign ends this one
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    with suppress(EOFError, ConnectionError):  # the parent is gone
        while True:
            pipe.send(answer(*pipe.recv()))
