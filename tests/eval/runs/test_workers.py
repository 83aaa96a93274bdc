"""Processes that run cases: a run that fails, or takes its process along, ends no other."""

import fcntl
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import campaigns
from litsim_eval.runs import workers as module
from litsim_eval.runs.case_run import RunOutcome
from litsim_eval.runs.workers import Workers


class Fatal:
    """A name of a scenario that ends the process to which it is sent."""

    def __init__(self, end: Callable[[int], object], how: int) -> None:
        self._end, self._how = end, how

    def __reduce__(self) -> tuple[Any, ...]:
        return self._end, (self._how,)


def good(ego_id: int = 7) -> Any:
    return campaigns.cases(cases=[{"scenario": "demo", "ego_id": ego_id}], egos=["log"], policies=["replay"])[0]


def test_a_process_whose_parent_is_gone_when_it_answers_ends_without_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = multiprocessing.Pipe()
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(module, "run_batch", lambda *_: ours.close())
    ours.send(([], []))
    module._serve(theirs)
    assert ours.closed


ORPHANED = """
import os, signal, time
from litsim_eval.runs.workers import Workers
from litsim_sim.launch import forked

def late():
    while os.getppid() == parent:
        time.sleep(0.01)
    begin()

parent, begin = os.getpid(), forked.end_with_parent
forked.end_with_parent = late
with Workers(2):
    os.kill(parent, signal.SIGKILL)
"""


def test_none_outlives_a_parent_that_is_killed_while_it_starts_them() -> None:
    done = subprocess.run([sys.executable, "-c", ORPHANED], capture_output=True, timeout=100, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGKILL, b"")  # its output is open for as long as any of them is


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"scenario": Fatal(os._exit, 7)}, "its process ended with exit status 7"),
        ({"scenario": Fatal(signal.raise_signal, signal.SIGKILL)}, "its process was ended by SIGKILL"),
    ],
    ids=["exit", "killed"],
)
def test_a_run_that_fails_takes_no_other_along(changes: dict[str, Any], why: str) -> None:
    with Workers(1) as workers:
        lost = workers.run(replace(good(), **changes))
        assert lost.metrics is None and why in lost.failure and "\n" not in lost.failure
        assert workers.run(good(3)).metrics is not None


class Interrupted(Workers):
    """Processes that get Ctrl-C as soon as they exist."""

    def _started(self, start: Any) -> Any:
        worker = super()._started(start)
        os.kill(worker.process.pid, signal.SIGINT)
        return worker


@pytest.mark.parametrize("forked", [1, 0])
def test_ctrl_c_is_left_to_the_parent_also_while_a_process_loads(forked: int) -> None:
    with Interrupted(forked) as workers:
        assert workers.run(good()).failure == ""


def test_what_runs_ends_with_them() -> None:
    with Workers(1) as workers:
        assert workers.run(good()).metrics is not None
        workers.close()
        assert workers.run(good()).failure == "its process was ended by SIGKILL"


def test_one_that_is_stopped_ends_with_them() -> None:
    with Workers(1) as workers:
        assert workers.run(good()).metrics is not None
        (worker,) = workers._all
        os.kill(worker.process.pid, signal.SIGSTOP)
        workers.close()
        worker.process.join(60.0)
        ended = worker.process.exitcode
        worker.process.kill()
    assert ended == -signal.SIGKILL


def test_cases_whose_process_was_closed_are_not_begun_again_one_by_one() -> None:
    with Workers(1) as workers:
        workers.run(good())
        workers.close()
        found = workers.run_batch([good(), good(3)], [None, None])
    assert [each.failure for each in found] == ["its process was closed before it began"] * 2


def test_they_are_copies_of_this_process_and_those_that_replace_them_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "run_batch", lambda *_: [RunOutcome(None, f"answered by a copy of {os.getppid()}")])
    with Workers(1) as workers:
        assert workers.run(good()).failure == f"answered by a copy of {os.getpid()}"
        lost = workers.run(replace(good(), scenario=Fatal(os._exit, 7)))
        assert lost.failure == "its process ended with exit status 7"
        assert workers.run(good()).metrics is not None


def test_none_keeps_a_file_open_that_was_open_when_they_began(tmp_path: Path) -> None:
    for _ in range(20):
        with (tmp_path / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused for as long as a copy has it
            with Workers(2):
                pass
