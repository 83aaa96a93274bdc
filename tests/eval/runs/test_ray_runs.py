"""Campaigns on a Ray cluster: one of this machine, with a worker that is lost midway."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import campaigns
from campaigns import told
from command_line import status
from litsim_eval.campaign.case import code_versions
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.cli import evaluate
from litsim_eval.runs import ray_runs
from litsim_eval.runs.case_run import RunOutcome, run_in_process
from litsim_eval.runs.ray_runs import RayRuns, run_task
from litsim_sim.core.errors import InputError
from litsim_sim.launch.supervisor import descendants

PATIENCE_S = 300.0  # a cluster takes its time to begin on a busy machine
WORDS = ("--ego-id", "3,7,24", "--ego", "idm", "--policy", "yield", "--processes", "2")


def runs(folder: Path) -> RayRuns:
    return RayRuns(CampaignFolder(folder), campaigns.CRITERIA, "local", 2)


def case(**suite: Any) -> Any:
    (made,) = campaigns.cases(policies=["replay"], **suite)
    return made


def test_it_is_said_where_ray_is_not_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"Ray is not installed: .venv/bin/pip install -r requirements/ray.txt"):
        runs(tmp_path).check([case()])


def test_a_stack_that_runs_already_is_met_by_no_node(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(ray_runs, "_ray", lambda: None)
    runs(tmp_path).check([case(egos=[{"kind": "external", "command": ["my_stack"]}])])
    with pytest.raises(InputError, match="ego external has no command"):
        runs(tmp_path).check([case(egos=["external"])])


def test_a_task_is_a_run_and_says_why_it_is_none(tmp_path: Path) -> None:
    made, sources = case(), code_versions()["sources"]
    found = run_task(made.to_json(), str(tmp_path), sources, 60.0, ".")
    assert found.metrics is not None and found.metrics["digest"] == run_in_process(made)["digest"]
    for changes, failure in (({"ego_id": 99999}, "99999"), ({"scenario": "nowhere"}, "nowhere")):
        lost = run_task(made.to_json() | changes, str(tmp_path), sources, 60.0, ".")
        assert lost.metrics is None and failure in lost.failure


def test_a_node_with_other_packages_runs_nothing(tmp_path: Path) -> None:
    found = run_task(case().to_json(), str(tmp_path), "0123456789abcdef", 60.0, ".")
    assert found.metrics is None and "this node has other LitSim packages" in found.failure


def test_files_on_another_nodes_disk_are_not_named(tmp_path: Path) -> None:
    made = case()
    (tmp_path / "runs" / made.id / "run").mkdir(parents=True)
    found = runs(tmp_path)._present(made, RunOutcome(None, "lost", "run", "run/report.html", None))
    assert (found.recording, found.report, found.log) == ("run", None, None)


def start(scenario: str, out: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "litsim_eval.cli.evaluate", "--scenario", scenario, *WORDS, *words]
    pipe = subprocess.PIPE
    return subprocess.Popen([*command, "--out", str(out)], stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def status_here(scenario: str, out: Path) -> int:
    """Exit status of the same campaign in this process."""
    return status(evaluate.main, "--scenario", scenario, *WORDS, "--out", out)


def kill_a_worker(of: subprocess.Popen[str]) -> str:
    """Kill a worker amid a run; returns the name of the run."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end and of.poll() is None:
        for process in descendants(of.pid):
            with suppress(OSError):  # it ended meanwhile
                if (line := Path(f"/proc/{process}/cmdline").read_text()).startswith("ray::demo/"):
                    os.kill(process, signal.SIGKILL)
                    return line
        time.sleep(0.02)
    raise AssertionError(f"no run was seen within {PATIENCE_S:g} s, or before all were over")


def test_runs_of_a_worker_that_is_lost_are_done_again_and_none_twice(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed (requirements/ray.txt)")
    demo = campaigns.scenario_file(tmp_path, "demo", simulation_s=20.0)  # long enough to be seen
    on_ray = start(demo, tmp_path / "ray", "--ray", "local")
    try:
        assert kill_a_worker(on_ray)
        said = on_ray.communicate(timeout=PATIENCE_S)[1]
    finally:
        on_ray.kill()
    assert on_ray.returncode == status_here(demo, tmp_path / "here"), said
    assert told(tmp_path / "ray") == told(tmp_path / "here") and len(told(tmp_path / "ray")) == 3

    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("ray/runs/*/result.json")}
    assert status_here(demo, tmp_path / "ray") == on_ray.returncode
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("ray/runs/*/result.json")} == before
