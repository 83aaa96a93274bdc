"""Batches of runs, and the table that sets policies side by side."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import subprocess
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from litsim_policy.run.runner import Runner, record
from litsim_sim.analysis.metrics import METRICS_FILE, compute_metrics
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import by_stage
from litsim_sim.launch.executables import find_executable
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.sumo import SumoMirror


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


def run_in_process(job: Job) -> dict[str, Any]:
    """Metrics of a run in this process, SUMO included."""
    scenario = Scenario.load(job.scenario, ego=job.ego_id, seed=job.seed)
    plan = RunPlan(scenario, job.ego, job.policy)
    mirror = SumoMirror(scenario.net_path, scenario.seed)
    return compute_metrics(record(Runner(plan, mirror, by_stage(job.parameters))))


def run_graph(job: Job, folder: Path) -> dict[str, Any]:
    """Metrics of a run over DDS, and as `recording` the name of its folder below `folder`.

    Raises:
        InputError: the launcher failed; the message is its own.
    """
    out = folder / re.sub(r"[^\w.=]+", "-", f"{job.ego}-{job.row}-{job.name}")
    launch = find_executable("litsim_sim", "launch")
    command = [str(launch), "--quiet", "--overwrite", "--scenario", job.scenario, "--out", str(out)]
    command += ["--ego", job.ego, "--policy", job.policy, "--ego-id", str(job.ego_id)]
    settings = [f"{stage}.{name}={json.dumps(value)}" for stage, name, value in job.parameters]
    command += ["--set", *settings] if settings else []
    command += [] if job.seed is None else ["--seed", str(job.seed)]
    environment = {key: value for key, value in os.environ.items() if key != "ROS_DOMAIN_ID"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise InputError(f"{out}: {done.stderr.strip().splitlines()[-1] if done.stderr.strip() else 'launch failed'}")
    metrics: dict[str, Any] = json.loads((out / METRICS_FILE).read_text())
    return metrics | {"recording": out.name}


def run_batch(
    jobs: Sequence[Job], processes: int, graph_folder: Path | None, done: Callable[[], object]
) -> dict[Job, dict[str, Any]]:
    """Metrics of every job; a process per run, since libsumo holds one simulation per process.

    Args:
        jobs: to run.
        processes: at a time; runs over DDS go one at a time, for they are several processes themselves.
        graph_folder: where runs over DDS are recorded; None runs in process.
        done: called after each run.
    """
    found = {}
    if graph_folder is not None:
        with ThreadPoolExecutor(1) as threads:
            for job, metrics in zip(jobs, threads.map(lambda j: run_graph(j, graph_folder), jobs), strict=True):
                found[job] = metrics
                done()
        return found
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, mp_context=context) as pool:
        pending = {pool.submit(run_in_process, job): job for job in jobs}
        try:
            for future in as_completed(pending):
                found[pending[future]] = future.result()
                done()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)  # one run that fails is no reason to wait for the others
            raise
    return {job: found[job] for job in jobs}


def summarise(runs: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """One row of the table: sums and means over runs; a mean over nothing is None."""
    runs = list(runs)
    ade = {h: _mean(r["ade_controlled_m"].get(h) for r in runs) for h in ("5", "10", "15", "20", "25")}
    return {
        "runs": len(runs),
        "invalid": sum(not r["valid"] for r in runs),
        "agents": sum(r["agents"] for r in runs),
        "colliding_agents": sum(r["collision"]["agents"] for r in runs),
        "colliding_runs": sum(not r["reactive"] for r in runs),
        "excess_pairs": sum(r["collision"]["excess"] for r in runs),
        "ego_contacts": sum(len(r["collision"]["ego_contacts"]) for r in runs),
        "rate_all": _mean(r["collision"]["rate_all"] for r in runs),
        "rate_controlled": _mean(r["collision"]["rate_controlled"] for r in runs),
        "reactive": _mean(float(r["reactive"]) for r in runs),
        "takeovers": sum(r["takeovers"] for r in runs),
        "takeovers_per_run": _mean(float(r["takeovers"]) for r in runs),
        "releases": sum(e["released_step"] is not None for r in runs for e in r["ledger"]),
        "held_s": sum(e["held_s"] for r in runs for e in r["ledger"]),
        "bound_hits": sum(r["detection"]["bound_hits"] for r in runs),
        "false_alarms": sum(r["false_alarms"] for r in runs),
        "relevant_ratio": _mean(r["relevant_ratio"] for r in runs),
        "ade_controlled_m": ade,
        "ade_all_m": {h: _mean(r["ade_all_m"].get(h) for r in runs) for h in ade},
        "replay_error_max_m": max((far for r in runs if (far := r["replay_error_max_m"]) is not None), default=None),
        "hard_brakes": sum(r["comfort"]["controlled"]["hard_brakes"] for r in runs),
        "guarded": _mean(r["comfort"]["controlled"]["guarded"]["share"] for r in runs),
        "off_road": _mean(r["off_road_controlled"] for r in runs),
        "progress_m": _mean(r["progress_m"] for r in runs),
        "max_position_jump_m": max((r["handback"]["max_position_jump_m"] for r in runs), default=None),
        "max_residual_m": max(
            (far for r in runs if (far := r["handback"]["max_residual_m"]) is not None), default=None
        ),
        "realtime_factor": _mean(r["timing"]["realtime_factor"] for r in runs),
    }


def _mean(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None
