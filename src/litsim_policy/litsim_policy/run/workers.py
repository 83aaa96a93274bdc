"""Processes that run batches of cases, so that a crash of one run, also in native code, ends no other."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from litsim_policy.run.case_batch import Found, run_batch
from litsim_policy.run.case_run import RunFailed, RunOutcome
from litsim_sim.campaign.case import Case
from litsim_sim.launch.child import end_with_parent, how_it_ended


class Workers:
    """One process for each thread that runs cases, as libsumo allows one simulation per process; a context manager."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._mine = threading.local()
        self._all: list[Any] = []
        self._closed = False
        self._starting = threading.Lock()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Terminate all processes, and start no further ones."""
        with self._starting:
            self._closed = True
            for process in self._all:
                process.terminate()

    def run(self, case: Case, folder: Path | None = None) -> RunOutcome:
        """Run a case in this thread's process; its picture is written to `folder`."""
        (outcome,) = self.run_batch([case], [folder])
        return outcome

    def run_batch(self, cases: Sequence[Case], folders: Sequence[Path | None]) -> list[RunOutcome]:
        """Run cases in this thread's process, together where possible; their pictures are written to their `folders`.

        The wall time is divided equally among the cases. If the process ends, the cases are repeated one by one to find
        the one that ends it.
        """
        begin = time.monotonic()
        try:
            found = self._ask(cases, folders)
        except RunFailed as error:
            if len(cases) > 1:
                return [self.run(case, folder) for case, folder in zip(cases, folders, strict=True)]
            found = [str(error)]
        share = (time.monotonic() - begin) / len(cases)
        return [
            RunOutcome(None, each, wall_s=share) if isinstance(each, str) else RunOutcome(each, wall_s=share)
            for each in found
        ]

    def _ask(self, cases: Sequence[Case], folders: Sequence[Path | None]) -> list[Found]:
        """Metrics of cases from this thread's process, or the reasons for their absence.

        Raises:
            RunFailed: the process has ended, or the workers are closed.
        """
        if not hasattr(self._mine, "process"):
            with self._starting:
                self._start()
        try:
            self._mine.pipe.send((cases, folders))
            found: list[Found] = self._mine.pipe.recv()
        except (EOFError, OSError):
            self._mine.process.join()
            status = self._mine.process.exitcode
            del self._mine.process
            raise RunFailed(f"its process {how_it_ended(status)}") from None
        return found

    def _start(self) -> None:
        if self._closed:
            raise RunFailed("its process was closed before it began")
        self._mine.pipe, theirs = self._context.Pipe()
        self._mine.process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
        self._mine.process.start()
        self._all.append(self._mine.process)
        theirs.close()  # so that the end of the process closes the pipe


def _serve(pipe: Connection) -> None:
    """Main function of a worker's process: run the batches received, and send their results."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; the parent ends this one
    end_with_parent()
    with suppress(EOFError, ConnectionError):  # the parent is gone
        while True:
            cases, folders = pipe.recv()
            pipe.send(run_batch(cases, folders))
