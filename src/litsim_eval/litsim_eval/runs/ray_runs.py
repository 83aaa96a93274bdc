"""The runs of a campaign on a Ray cluster, one task per run; Ray is an optional requirement (requirements/ray.txt)."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from litsim_eval.campaign.case import GRAPH, Case, code_versions
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult
from litsim_eval.runs.case_run import TIME_LIMIT_S, RunOutcome, is_elsewhere, run_in_process, run_over_graph
from litsim_sim.core.errors import InputError, reason

LOCAL = "local"  # address of a cluster of this machine alone, which ends with the campaign
RETRIES = 3  # most repetitions of a run after its worker was lost
WAITING_MAX = 500  # most tasks submitted to the cluster at a time
SOURCES = "sources"  # key of the versions: a digest of the installed packages
LEAVING_S = 30.0  # [s] within which the child processes of a lost worker end


@dataclass
class RayRuns:
    """Runs cases on the nodes of a cluster, all of which must have LitSim's environment and the same packages.

    If a worker is lost, its run is repeated on any node; a finished run is stored here, and never repeated.

    Attributes:
        folder: of the results, and of recordings if the nodes share its file system.
        criteria: by which runs are judged.
        address: of the cluster for :func:`ray.init`, or :data:`LOCAL`.
        processes: number of runs at a time on a :data:`LOCAL` cluster; others use all their processors.
        time_limit_s: after which a run over DDS has failed [s].
    """

    folder: CampaignFolder
    criteria: Criteria
    address: str
    processes: int
    time_limit_s: float = TIME_LIMIT_S

    def check(self, cases: Sequence[Case]) -> None:
        """Checks that `cases` can be run on a cluster.

        Raises:
            InputError: Ray is not installed, or a stack is started by the user, where no node can reach it.
        """
        _ray()
        if elsewhere := [case.ego.name for case in cases if is_elsewhere(case)]:
            raise InputError(f"--ray: ego {elsewhere[0]} has no command; nodes of a cluster start their own stacks")

    def run(self, cases: Sequence[Case]) -> Generator[RunResult, None, None]:
        """Runs `cases` and yields the result of each once it is stored.

        Raises:
            InputError: the cluster cannot be reached.
        """
        ray = _ray()
        self._connect(ray)
        try:
            for case, outcome in self._outcomes(ray, cases):
                result = self._present(case, outcome).judged(case, self.criteria)
                self.folder.store(result)
                yield result
        finally:  # ends the tasks that still run
            ray.shutdown()

    def _connect(self, ray: Any) -> None:
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no usage statistics
        options: dict[str, Any] = (
            {"num_cpus": self.processes, "include_dashboard": False} if self.address == LOCAL else {}
        )
        try:
            ray.init(address=self.address, log_to_driver=False, logging_level="error", **options)
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            raise InputError(f"--ray {self.address}: no connection: {reason(error)}") from error

    def _outcomes(self, ray: Any, cases: Sequence[Case]) -> Iterator[tuple[Case, RunOutcome]]:
        """Yields outcomes in order of completion; at most :data:`WAITING_MAX` tasks are submitted at a time."""
        task = ray.remote(max_retries=RETRIES, num_cpus=1)(run_task)
        sources, folder = code_versions()[SOURCES], str(self.folder.path.resolve())
        left = iter(cases)
        pending: dict[Any, Case] = {}
        while True:
            for case in islice(left, WAITING_MAX - len(pending)):
                arguments = (case.to_json(), folder, sources, self.time_limit_s, str(Path.cwd()))
                pending[task.options(name=case.name).remote(*arguments)] = case
            if not pending:
                return
            (ready, *_), _ = ray.wait(list(pending), num_returns=1)
            case = pending.pop(ready)
            try:
                yield case, ray.get(ready)
            except ray.exceptions.RayError as error:  # raised after all retries
                yield case, RunOutcome(None, f"the worker was lost {RETRIES + 1} times: {reason(error)}")

    def _present(self, case: Case, outcome: RunOutcome) -> RunOutcome:
        """Returns `outcome` without files that are only on another node's disk."""
        where = self.folder.run_folder(case)
        files = {name: getattr(outcome, name) for name in ("recording", "report", "log")}
        absent = [name for name, file in files.items() if file is not None and not (where / file).exists()]
        nothing: dict[str, Any] = dict.fromkeys(absent)
        return replace(outcome, **nothing)


def run_task(case: Mapping[str, Any], folder: str, sources: str, time_limit_s: float, cwd: str) -> RunOutcome:
    """Runs a case on this node, as the task of one run; an error becomes an outcome.

    Args:
        case: by :meth:`Case.to_json`.
        folder: of the campaign, with the folders of its runs.
        sources: expected digest of the packages.
        time_limit_s: after which a run over DDS has failed [s].
        cwd: working directory of the campaign, to which a stack's command may be relative.
    """
    begin = time.monotonic()
    failure = ""
    try:
        if (here := code_versions()[SOURCES]) != sources:
            failure = f"this node has other LitSim packages: sources {here}, expected {sources}"
        else:
            this = Case.from_json(case)
            where = _cleared(CampaignFolder(Path(folder)), this)
            if this.execution_mode == GRAPH:
                with chdir(cwd):
                    return run_over_graph(this, where, time_limit_s=time_limit_s)
            return RunOutcome(run_in_process(this, where), wall_s=time.monotonic() - begin)
    except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
        failure = reason(error)
    return RunOutcome(None, failure, wall_s=time.monotonic() - begin)


def _cleared(folder: CampaignFolder, case: Case) -> Path:
    """Empties the folder of a run, possibly after the launcher of a lost worker has closed its record there."""
    until = time.monotonic() + LEAVING_S
    while True:
        try:
            return folder.clear(case)
        except OSError:
            if time.monotonic() > until:
                raise
            time.sleep(0.5)


def _ray() -> Any:
    """Imports Ray; raises InputError if it is not installed."""
    try:
        import ray
    except ImportError as error:
        raise InputError(
            "--ray: Ray is not installed: .venv/bin/pip install -r requirements/ray.txt -c requirements/constraints.txt"
        ) from error
    return ray
