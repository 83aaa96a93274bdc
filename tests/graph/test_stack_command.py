"""The launcher starts the stack that drives the ego, watches it like a node, and leaves nothing of it behind."""

from __future__ import annotations

import html
import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.record.bag import FAILURE_FILE
from litsim_sim.record.run import read_run

STACK = (sys.executable, str(Path(__file__).with_name("external_ego.py")))
EXTERNAL = ("--ego", "external", "--policy", "replay", "--quiet")


def launch(graph: Any, *stack: object, options: tuple[object, ...] = ()) -> subprocess.CompletedProcess[str]:
    words = ("--scenario", graph.scenario(), "--out", graph.folder / "run", *EXTERNAL, *options)
    return graph.launch(*words, "--", *stack)


def test_it_drives_in_a_domain_that_nobody_had_to_choose(graph: Any) -> None:
    options = ("--set", "bridge.external_timeout_s=100.0")  # an option of many values before the command
    done = launch(graph, *STACK, options=options)
    assert (done.returncode, done.stderr) == (0, "")
    metrics = json.loads((graph.folder / "run/metrics.json").read_text())
    assert (metrics["valid"], metrics["ego"], metrics["lockstep"]["ego_port"]["answered"]) == (True, "external", 36)
    assert (graph.folder / "run/log/ads.log").is_file()
    assert not graph.running()


@pytest.mark.parametrize(
    ("stack", "words"),
    [
        ((*STACK, "--die-at", 12), "ended with exit status 3: it has said nothing"),
        (("sh", "-c", "echo ready; echo no licence; exit 0"), "ended with exit status 0: no licence"),
        (("sh", "-c", "sleep 1; echo far; kill -SEGV $$"), "was ended by SIGSEGV: far"),
    ],
)
def test_one_that_ends_before_the_run_fails_it(graph: Any, stack: tuple[object, ...], words: str) -> None:
    done = launch(graph, *stack)
    assert done.returncode == 1
    (error,) = done.stderr.splitlines()
    assert error.startswith(f"error: the stack ({stack[0]} ") and words in error
    assert not graph.running()
    assert (graph.folder / "run" / FAILURE_FILE).read_text().strip() in error


def test_why_it_has_ended_is_told_by_what_the_run_leaves(graph: Any) -> None:
    run = graph.folder / "run"
    script = f"import runpy, sys\nsys.argv[0] = 'mine'\ntry: runpy.run_path({STACK[1]!r}, run_name='__main__')\n"
    script += "except SystemExit: raise ValueError('planner lost its mind')"
    done = launch(graph, sys.executable, "-c", script, "--die-at", 12)
    assert "ended with exit status 1: ValueError: planner lost its mind (logs: " in done.stderr
    why = compute_metrics(read_run(run))["why"]
    assert why.startswith("the stack (") and "interrupted" not in why
    assert "exit status 1: ValueError: planner lost its mind; the bridge did not finish: last step 12 of 35" in why
    assert why in html.unescape((run / "report.html").read_text())

    broken = launch(graph, "sh", "-c", "exit 5", options=("--overwrite",))
    assert "ended with exit status 5" in broken.stderr
    assert "planner" not in "".join(path.read_text() for path in run.glob("*.[ht]*")), "of the run before"


def test_one_that_hangs_is_named_beside_the_reason_of_the_bridge(graph: Any) -> None:
    script = f"print('tired', flush=True)\nimport runpy\nrunpy.run_path({STACK[1]!r}, run_name='__main__')"
    done = launch(graph, sys.executable, "-c", script, "--skip", "12-99", options=("--answer-timeout", 8))
    assert done.returncode == 1
    (error,) = done.stderr.splitlines()
    assert error.startswith("error: no answer to step 12 on /litsim/ego/control within 8 s")
    assert "; the stack (" in error and " was running, and said last: tired" in error
    assert not graph.running()


def test_all_of_it_ends_with_a_launcher_that_is_killed(graph: Any) -> None:
    words = ("--scenario", graph.scenario(), "--out", graph.folder / "run", *EXTERNAL)
    launcher = graph.start_launch(*words, "--", "sh", "-c", "setsid sleep 600 & sleep 601")
    graph.wait("the stack", lambda: {"sleep 600 ", "sleep 601 "} <= set(graph.running().values()))
    graph.end(launcher, signal.SIGKILL)
    graph.wait("the end of all", lambda: not graph.running())
