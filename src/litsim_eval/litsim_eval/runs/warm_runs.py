"""Runs with a stack that can begin anew: processes in which graph and stack stay up from run to run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from litsim_eval.campaign.case import Case
from litsim_eval.runs.case_run import PRELOADED, TICK_S, RunOutcome, RunStopped, outcome_of
from litsim_eval.runs.workers import WorkerPool, serve
from litsim_sim.core.errors import InputError
from litsim_sim.launch.forked import preload
from litsim_sim.launch.middleware import is_secured

END_S = 10.0  # [s] for an idle process to end its stack


class WarmRuns(WorkerPool):
    """As many processes as there are runs at a time, each with a graph and a stack; a context manager.

    Raises:
        InputError: DDS Security is requested, whose permissions are those of separate nodes.
    """

    def __init__(self) -> None:
        if is_secured(os.environ):
            raise InputError("--warm: DDS Security grants rights to separate nodes, expected runs without --warm")
        super().__init__(_serve_warm)
        preload(PRELOADED)

    def __enter__(self) -> WarmRuns:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._idle:
            worker.pipe.close()  # it ends its stack in good order
        for worker in self._all:
            worker.process.join(END_S if worker in self._idle else 0.0)
            worker.process.kill()
            worker.process.join()

    def run(self, case: Case, folder: Path, stopped: Callable[[], bool], time_limit_s: float) -> RunOutcome:
        """Runs a case into `folder`; arguments and errors are those of :func:`.case_run.run_over_graph`."""
        begin, late, failure = time.monotonic(), False, ""
        worker = self._taken()
        try:
            worker.pipe.send((case, folder))
            while not worker.pipe.poll(TICK_S):
                late = time.monotonic() > begin + time_limit_s
                if late or stopped():
                    break
            else:
                failure = worker.pipe.recv()
                self._idle.append(worker)
        except (EOFError, OSError):
            failure = worker.obituary()
        if stopped():
            raise RunStopped
        if late:
            worker.process.kill()
            worker.process.join()
        return outcome_of(folder, begin, failure, time_limit_s if late else None)


def _serve_warm(pipe: Connection) -> None:
    """Main function of a process with a graph."""
    from litsim_eval.runs.warm_graph import WarmGraph  # the requester may be without ROS

    with WarmGraph() as graph:
        serve(pipe, graph.run)
