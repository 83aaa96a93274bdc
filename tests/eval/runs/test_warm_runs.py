"""Processes with a graph and a stack that stay up: what becomes of one that hangs, dies, or is no longer wanted."""

import os
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

import campaigns
from litsim_eval.runs import warm_runs, workers
from litsim_eval.runs.case_run import RunStopped
from litsim_eval.runs.warm_runs import WarmRuns
from litsim_eval.runs.workers import serve
from litsim_sim.core.errors import InputError
from litsim_sim.launch.forked import start_forked

(CASE,) = campaigns.cases(egos=["log"], cases=[{"scenario": "demo", "ego_id": 7}], policies=["replay"])


def answer(_: object, folder: Path) -> str:
    """Stands in for a graph: says which process it is, hangs or dies, as the folder is called."""
    if folder.name == "dies":
        os._exit(7)
    time.sleep(600.0 if folder.name == "hangs" else 0.0)
    return f"process {os.getpid()}"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Runs a case into a folder of a name, and returns why it has failed."""

    def serving(_: object, pipe: Connection) -> object:
        return start_forked(serve, pipe, answer)

    monkeypatch.setattr(workers, "start_preloaded", serving)
    monkeypatch.setattr(warm_runs, "END_S", 0.2)  # a forked process holds both ends of its pipe: it never ends
    with WarmRuns() as runs:
        yield lambda name, stopped=False: runs.run(CASE, tmp_path / name, lambda: stopped, 0.5).failure


def test_a_process_has_one_run_after_the_other(run: Callable[..., str]) -> None:
    assert run("a") == run("b")


def test_one_that_dies_or_hangs_is_replaced(run: Callable[..., str]) -> None:
    first = run("a")
    assert run("dies") == "its process ended with exit status 7"
    second = run("b")
    assert run("hangs") == "time limit of 0.5 s exceeded"
    assert len({first, second, run("c")}) == 3


def test_a_run_of_a_campaign_that_has_ended_says_nothing(run: Callable[..., str]) -> None:
    with pytest.raises(RunStopped):
        run("hangs", stopped=True)


def test_dds_security_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    with pytest.raises(InputError, match="--warm"):
        WarmRuns()
