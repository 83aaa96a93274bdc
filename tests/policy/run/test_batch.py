"""Batches of runs: each is measured or said to have failed, whatever becomes of the others."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from litsim_policy.run import batch
from litsim_policy.run.batch import Job, run_batch, run_graph, run_in_process
from litsim_policy.run.runner import Runner, record
from litsim_sim.analysis.metrics import compute_metrics
from litsim_sim.analysis.summary import summarise
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

GOOD = Job("demo", "log", "replay", 7)


class Fatal:
    """A name of a scenario that ends the process to which it is sent."""

    def __init__(self, end: Callable[[int], object], how: int) -> None:
        self._end, self._how = end, how

    def __reduce__(self) -> tuple[Any, ...]:
        return self._end, (self._how,)


def test_a_job_is_run_without_sumo_and_measured() -> None:
    found = run_in_process(GOOD)
    assert found["valid"] and found["collision"]["excess"] == 0 and found["policy"] == "replay"
    assert found["world"]["sumo_deviation_m"] is None


def test_a_job_is_the_run_of_its_own_scenario_whatever_was_run_before() -> None:
    jobs = [Job("demo", "idm", "replay", 3), Job("demo", "idm", "replay", 3, seed=5), GOOD]
    found = [run_in_process(job) for job in jobs]
    for job, metrics in zip(jobs, found, strict=True):
        scenario = Scenario.load("demo", ego=job.ego_id, seed=job.seed)
        alone = compute_metrics(record(Runner(RunPlan(scenario, job.ego, job.policy))))
        assert (metrics["digest"], metrics["run_id"]) == (alone["digest"], alone["run_id"])
        assert metrics["ledger"] == alone["ledger"] and metrics["safety"] == alone["safety"]
    assert len({metrics["run_id"] for metrics in found}) == len(jobs)


def test_a_batch_answers_every_job_in_order_from_processes_of_its_own() -> None:
    jobs = [GOOD, Job("demo", "idm", "litsim", 3)]
    ticks: list[int] = []
    found = run_batch(jobs, 2, None, lambda: ticks.append(1)).metrics
    assert list(found) == jobs and len(ticks) == 2
    assert [m["policy"] for m in found.values()] == ["replay", "litsim"]
    assert found[jobs[1]]["digest"] == run_in_process(jobs[1])["digest"]
    row = summarise(found.values())
    assert row["runs"] == 2 and row["invalid"] == row["failed"] == 0


def test_an_ego_that_is_not_there_is_an_input_error() -> None:
    with pytest.raises(InputError, match="99999"):
        run_in_process(Job("demo", "log", "replay", 99999))


@pytest.mark.parametrize(
    ("lost", "why"),
    [
        (Job("demo", "log", "replay", 99999), "99999"),
        (Job("demo", "log", "replay", "seven"), "seven"),  # type: ignore[arg-type]
        (Job(Fatal(os._exit, 7), "log", "replay", 7), "its process ended with exit status 7"),  # type: ignore[arg-type]
        (Job(Fatal(signal.raise_signal, signal.SIGKILL), "log", "replay", 7), "was ended by SIGKILL"),  # type: ignore[arg-type]
    ],
    ids=["bad input", "an error nobody foresaw", "exit", "killed"],
)
def test_a_run_that_fails_takes_no_other_along(lost: Job, why: str) -> None:
    ticks: list[int] = []
    jobs = [GOOD, lost, Job("demo", "log", "replay", 3)]
    found = run_batch(jobs, 1, None, lambda: ticks.append(1))
    assert list(found.metrics) == [jobs[0], jobs[2]] and len(ticks) == 3
    (reason,) = found.failures.values()
    assert why in reason and "\n" not in reason and list(found.failures) == [lost]


def launcher(tmp_path: Path, script: str) -> Path:
    path = tmp_path / "launch"
    path.write_text(f"#!/bin/sh\nwhile [ $# -gt 0 ]; do [ $1 = --out ] && out=$2; shift; done\n{script}\n")
    path.chmod(0o755)
    return path


def test_over_dds_a_run_that_is_not_valid_is_measured_and_one_that_fails_is_said_to(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    script = """case $out in
        *-3) mkdir -p $out; echo '{"valid": false, "why": "gaps"}' > $out/metrics.json; exit 1;;
        *-4) exit 1;;
        *) echo first >&2; echo "error: node policy ended" >&2; exit 1;;
    esac"""
    monkeypatch.setattr(batch, "find_executable", lambda *_: launcher(tmp_path, script))
    jobs = [Job("demo", "idm", "litsim", ego) for ego in (7, 3, 4)]
    stale = tmp_path / "idm-litsim-demo-7" / "metrics.json"
    stale.parent.mkdir()
    stale.write_text('{"valid": true}')
    found = run_batch(jobs, 1, tmp_path, lambda: None)
    assert found.metrics == {jobs[1]: {"valid": False, "why": "gaps", "recording": "idm-litsim-demo-3"}}
    assert found.failures == {jobs[0]: "node policy ended", jobs[2]: "the launcher ended with status 1"}
    with pytest.raises(batch.RunFailed, match="node policy ended"):
        run_graph(jobs[0], tmp_path)
