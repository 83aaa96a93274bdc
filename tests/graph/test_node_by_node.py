"""The commands of docs/recording.md that start the nodes one by one make the run that one process makes."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import yaml

from litsim_eval.analysis.analyze import analyze
from litsim_eval.runs.runner import Runner
from litsim_sim.core.plugins import STAGES, package_of
from litsim_sim.core.stages import EGO, POLICY
from litsim_sim.record.digest import RunDigest
from litsim_sim.scenario.run_info import RunPlan

PAGE = Path(__file__).resolve().parents[2] / "docs/recording.md"


def commands() -> list[list[str]]:
    """Arguments of the commands of the page's section, without ``./litsim``."""
    section = PAGE.read_text().partition("### Node by node")[2].partition("## What is there")[0]
    (block,) = re.findall(r"```bash\n(.*?)```", section, re.DOTALL)
    return [shlex.split(line)[1:] for line in block.splitlines()]


def test_six_commands_make_the_run_of_one_process(graph: Any) -> None:
    words = commands()
    assert [each[0] for each in words] == ["predictor", "conflict", "policy", "ego", "recorder", "bridge"]
    started = {}
    for node, *options in words:
        package = package_of(STAGES, POLICY if node == EGO else node)
        started[node] = graph.start_program(package, node, *options)
    bridge = graph.finish(started["bridge"])
    assert bridge.returncode == 0, bridge.stderr
    assert graph.finish(started["recorder"]).returncode == 0
    metrics = analyze(graph.folder / "bags/nodes")
    assert metrics["valid"], metrics["why"]
    given = dict(yaml.safe_load(word.replace(":=", ": ")).popitem() for word in words[-1] if ":=" in word)
    total = RunDigest()
    for result in Runner(RunPlan.load(given["scenario"], given["ego"], given["policy"])).steps():
        total.update(result.table, result.controls, result.ego)
    assert metrics["digest"] == total.hexdigest()
