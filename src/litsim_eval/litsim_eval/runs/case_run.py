"""A run of one case of a campaign, in this process or over DDS by the launcher; every outcome gives a result."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import METRICS_FILE, compute_metrics
from litsim_eval.campaign.case import GRAPH, Case
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import RunResult
from litsim_eval.report.run_report import REPORT_FILE, write_report
from litsim_eval.report.thumbnails import write_thumbnail
from litsim_eval.runs.in_process import record
from litsim_sim.core.errors import InputError
from litsim_sim.launch.child import how_it_ended
from litsim_sim.launch.forked import ForkedProcess, preload
from litsim_sim.launch.nodes import find_executable, nodes_of
from litsim_sim.launch.processes import LOG_FOLDER, STACK
from litsim_sim.record.failure import write_failure
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.simulation import configured

RECORDING = "run"  # folder of the record in the run's folder
LAUNCHER = ("litsim_sim", "launch")  # package and executable
PRELOADED = f"{__package__}.preloaded"  # module imported by the process of which launchers are forks
TICK_S = 0.2  # [s] between two looks at a launcher
END_S = 30.0  # [s] for a launcher to end its graph
TIME_LIMIT_S = 1800.0  # [s] default time limit of a run over DDS


class CaseRefused(InputError):
    """A case cannot be run; the message names its variant.

    Attributes:
        setting: `stage.name` and value of the first of its parameters that is the reason by itself; None if none is.
    """

    def __init__(self, case: Case, error: InputError) -> None:
        super().__init__(f"variant {case.variant}: {error}")
        settings = () if _is_refused(case, None) else (case.ego.parameters | dict(case.parameters)).items()
        self.setting = next((setting for setting in settings if _is_refused(case, setting)), None)


class RunStopped(Exception):
    """A run was ended with its campaign, and has no outcome."""


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run.

    Attributes:
        metrics: the content of `metrics.json`, of a valid or invalid run; None if there are none.
        failure: why there are none, in one line.
        recording, report, log: folder and files, relative to the run's folder; None if they do not exist.
        wall_s: wall time of the run [s].
    """

    metrics: Mapping[str, Any] | None
    failure: str = ""
    recording: str | None = None
    report: str | None = None
    log: str | None = None
    wall_s: float | None = None

    def judged(self, case: Case, criteria: Criteria) -> RunResult:
        """Returns the result of `case`, judged by `criteria`."""
        files = {name: getattr(self, name) for name in ("recording", "report", "log", "wall_s")}
        if self.metrics is None:
            return RunResult.error(case, self.failure, **files)
        return RunResult.judged(case, self.metrics, criteria, **files)


def check_cases(cases: Iterable[Case]) -> None:
    """Checks one case of each variant before the first run.

    Raises:
        CaseRefused: see :func:`check_case`.
    """
    for case in {(alike.variant, alike.execution_mode): alike for alike in cases}.values():
        try:
            check_case(case)
        except InputError as error:
            raise CaseRefused(case, error) from error


def _is_refused(case: Case, setting: tuple[str, Any] | None) -> bool:
    """Returns whether `case` is refused with this parameter alone, or none, and all others at their defaults."""
    ego = case.ego.model_copy(update={"parameters": {}})
    try:
        check_case(replace(case, ego=ego, parameters=() if setting is None else (setting,)))
    except InputError:
        return True
    return False


def check_case(case: Case) -> None:
    """Checks the parameters of a case, and the program of its stack.

    Raises:
        InputError: a parameter is unknown to its stage or invalid, or there is no such program, or no launcher.
        ModuleNotFoundError: it is to run over DDS, and there is no ROS.
    """
    if case.execution_mode != GRAPH:
        configured(case.ego.kind, case.policy, case.stage_parameters)
        return
    find_executable(*LAUNCHER)
    plan = RunPlan(_scenario(case.scenario), case.ego.kind, case.policy, case.stage_parameters)
    nodes_of(plan, case.scenario, Path(RECORDING), ego_interface=case.ego.interface)
    if case.ego.command:
        case.ego.check_command()


def run_in_process(case: Case, folder: Path | None = None) -> dict[str, Any]:
    """Returns metrics of a run in this process, without SUMO, which would only mirror it.

    Args:
        case: to run.
        folder: for a picture of the run, used by the campaign's page.

    Raises:
        InputError: the case cannot be run, or `folder` cannot be written.
    """
    return measured(record(plan_of(case)), folder)


def plan_of(case: Case) -> RunPlan:
    """Returns the plan of a case, with its scenario loaded; raises InputError if the scenario cannot be used."""
    scenario = _scenario(case.scenario).around(case.ego_id, case.seed, case.end_after_contact_s, case.draw)
    return RunPlan(scenario, case.ego.kind, case.policy, case.stage_parameters)


def measured(run: Run, folder: Path | None) -> dict[str, Any]:
    """Returns metrics of a run; its picture is written to `folder` unless that is None.

    Raises:
        InputError: metrics cannot be computed, or `folder` cannot be written.
    """
    metrics = compute_metrics(run)
    if folder is not None:
        write_thumbnail(run, metrics, folder)
    return metrics


def run_over_graph(
    case: Case, folder: Path, stopped: Callable[[], bool] = lambda: False, time_limit_s: float = TIME_LIMIT_S
) -> RunOutcome:
    """Runs a case over DDS by the launcher, in a domain reserved for it.

    With a stack that was started elsewhere, the domain is that of the environment, or 0.

    Args:
        case: to run.
        folder: of the run; the record gets a folder in it.
        stopped: polled during the run; True ends the run.
        time_limit_s: after which a run has failed [s].

    Raises:
        RunStopped: `stopped` returned True.
        InputError: there is no launcher.
    """
    out = folder / RECORDING
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID" or is_elsewhere(case)}
    begin = time.monotonic()
    preload(PRELOADED)
    launcher = ForkedProcess(
        _launch(case, out), environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, preloaded=True
    )
    errors = _Reader(launcher)
    late = False
    while launcher.wait(TICK_S) is None:
        late = time.monotonic() > begin + time_limit_s
        if late or stopped():
            _end(launcher)
            break
    if stopped():
        raise RunStopped
    return outcome_of(folder, begin, errors.reason(launcher.returncode), time_limit_s if late else None)


def outcome_of(folder: Path, begin: float, failure: str, exceeded_s: float | None) -> RunOutcome:
    """Returns the outcome of a run over DDS by what it has left in `folder`.

    Args:
        folder: of the run.
        begin: monotonic time [s].
        failure: why there are no metrics, if there are none.
        exceeded_s: time limit that ended the run [s], None if it ended by itself.
    """
    out = folder / RECORDING
    late = exceeded_s is not None
    metrics = json.loads((out / METRICS_FILE).read_text()) if (out / METRICS_FILE).is_file() and not late else None
    log = out / LOG_FOLDER / f"{STACK}.log"
    recorded = any(out.glob("*.mcap"))
    if late:
        failure = f"time limit of {exceeded_s:g} s exceeded"
    if late and recorded:  # the run itself only recorded that it was interrupted
        write_failure(out, failure)
        with suppress(InputError):
            write_report(out)
    return RunOutcome(
        metrics=metrics,
        failure="" if metrics else failure,
        recording=RECORDING if recorded else None,
        report=f"{RECORDING}/{REPORT_FILE}" if (out / REPORT_FILE).is_file() else None,
        log=str(log.relative_to(folder)) if log.is_file() else None,
        wall_s=time.monotonic() - begin,
    )


def is_elsewhere(case: Case) -> bool:
    """Returns whether the user starts the stack of a case; its runs are made one at a time, in the stack's domain."""
    return case.ego.kind == EXTERNAL and not case.ego.command


@lru_cache(maxsize=8)
def _scenario(name: str) -> Scenario:
    """Returns the scenario called `name`, cached for all its egos and policies."""
    return Scenario.load(name)


def _launch(case: Case, out: Path) -> list[str]:
    """Returns the launcher's command line."""
    argv = [str(find_executable(*LAUNCHER)), "--quiet", "--overwrite", "--out", str(out), "--case", str(out.parent)]
    argv += ["--scenario", case.scenario, "--ego", case.ego.adapter or case.ego.kind, "--policy", case.policy]
    argv += ["--ego-id", str(case.ego_id), "--ego-interface", case.ego.interface]
    argv += [] if case.seed is None else ["--seed", str(case.seed)]
    argv += [] if case.draw is None else ["--draw", str(case.draw)]
    argv += [] if case.end_after_contact_s is None else ["--end-after-contact", str(case.end_after_contact_s)]
    settings = [
        f"{stage}.{name}={json.dumps(value)}"
        for stage, values in case.stage_parameters.items()
        for name, value in values.items()
    ]
    argv += ["--set", *settings] if settings else []
    return [*argv, *(["--", *case.ego.argv] if case.ego.command else [])]


class _Reader(threading.Thread):
    """Reads the launcher's stderr, which would otherwise block once its pipe is full."""

    def __init__(self, launcher: ForkedProcess) -> None:
        super().__init__(daemon=True)
        assert launcher.stderr is not None
        self._stream, self._said = launcher.stderr, ""
        self.start()

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        with self._stream:
            self._said = self._stream.read()

    def reason(self, status: int) -> str:
        """Returns why the launcher has failed: the last error on stderr, the last line, or its exit `status`."""
        self.join(TICK_S)
        lines = [line for line in self._said.splitlines() if line.strip()]
        errors = [line.removeprefix("error: ") for line in lines if line.startswith("error: ")]
        return (errors or lines or [f"the launcher {how_it_ended(status)}"])[-1]


def _end(launcher: ForkedProcess) -> None:
    """Interrupts a launcher, so that it ends its graph; kills it after END_S."""
    with suppress(ProcessLookupError):
        os.kill(launcher.pid, signal.SIGINT)
        if launcher.wait(END_S) is None:
            os.kill(launcher.pid, signal.SIGKILL)
            launcher.wait()
