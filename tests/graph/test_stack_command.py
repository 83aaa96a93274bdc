"""The launcher starts the stack that drives the ego, watches it like a node, and leaves nothing of it behind."""

from __future__ import annotations

import html
import subprocess
import sys
from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.record.run import read_run

STACK = (sys.executable, str(Path(__file__).with_name("external_ego.py")))
EXTERNAL = ("--ego", "external", "--policy", "replay", "--quiet")


def launch(graph: Any, *stack: object, options: tuple[object, ...] = ()) -> subprocess.CompletedProcess[str]:
    words = ("--scenario", graph.scenario(), "--out", graph.folder / "run", *EXTERNAL, *options)
    return graph.launch(*words, "--", *stack)


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
