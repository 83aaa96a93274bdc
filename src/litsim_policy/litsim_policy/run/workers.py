"""Processes that run cases one after the other: a crash of one run, in native code too, ends no other."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from litsim_policy.run.case_run import RunFailed, RunOutcome, run_in_process
from litsim_sim.campaign.case import Case
from litsim_sim.core.errors import reason
from litsim_sim.launch.child import end_with_parent, how_it_ended


class Workers:
    """A process for each thread that runs cases: libsumo holds one simulation a process, and a crash ends no other."""

    def __init__(self) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._mine = threading.local()
        self._all: list[Any] = []

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all of them, whatever they do."""
        for process in list(self._all):
            process.terminate()

    def run(self, case: Case, folder: Path | None = None) -> RunOutcome:
        """Run a case in this thread's process; its picture is left in `folder`."""
        begin = time.monotonic()
        try:
            metrics, failure = self._ask(case, folder), ""
        except RunFailed as error:
            metrics, failure = None, str(error)
        return RunOutcome(metrics, failure, wall_s=time.monotonic() - begin)

    def _ask(self, case: Case, folder: Path | None) -> dict[str, Any]:
        """Metrics of a case from this thread's process.

        Raises:
            RunFailed: the run has raised an error, or its process has ended.
        """
        if not hasattr(self._mine, "process"):
            self._start()
        try:
            self._mine.pipe.send((case, folder))
            found: dict[str, Any] | str = self._mine.pipe.recv()
        except (EOFError, OSError):
            self._mine.process.join()
            status = self._mine.process.exitcode
            del self._mine.process
            raise RunFailed(f"its process {how_it_ended(status)}") from None
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
    """The process of a worker: metrics of every case that comes, or why there are none."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group; who has begun this one ends it
    end_with_parent()
    while True:
        try:
            case, folder = pipe.recv()
        except EOFError:  # who has begun this one is gone
            return
        try:
            found: dict[str, Any] | str = run_in_process(case, folder)
        except Exception as error:  # noqa: BLE001 - whatever it is, the others are to go on, and the table is to say it
            found = reason(error)
        pipe.send(found)
