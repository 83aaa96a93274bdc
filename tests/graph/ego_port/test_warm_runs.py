"""Campaigns whose graph and stack stay up from run to run: the same results as with a new stack for each."""

import sys
from pathlib import Path
from typing import Any

import yaml

from litsim_eval.campaign.results import RunResult, read_campaign
from litsim_sim.record.bag import BagReader

HERE = Path(__file__).parents[1]
STAYS, LEAVES = HERE / "programs/external_ego.py", HERE.parents[1] / "examples/trajectory_ads.py"
CRITERIA = {"runs": [{"name": "no fault", "field": "collision.ego_at_fault", "max": 0}]}


def command(graph: Any, name: str, script: Path) -> list[str]:
    """A stack that notes each of its starts in a file of its name."""
    return ["sh", "-c", f"echo started >> {graph.folder}/{name}; exec {sys.executable} {script}"]


def campaign(graph: Any, egos: list[Any], policies: list[str], *options: str) -> dict[str, RunResult]:
    suite = graph.folder / "suite.yaml"
    graph.scenario()
    content = {"name": "short", "cases": [{"scenario": "short.yaml", "ego_id": [13, 21]}], "egos": egos}
    suite.write_text(yaml.safe_dump(content | {"policies": policies, "criteria": CRITERIA}))
    out = graph.folder / ("warm" if options else "cold")
    words = ("--suite", suite, "--out", out, "--processes", "1", *options)
    done = graph.finish(graph.start_program("litsim_eval", "evaluate", *words))
    assert "Traceback" not in done.stderr
    assert not graph.running()
    return {result.case.name: result for result in read_campaign(out).results}


def attachments(graph: Any, out: str, result: RunResult) -> dict[str, bytes]:
    assert result.recording
    return BagReader(graph.folder / out / "runs" / result.case.id / result.recording).attachments


def test_a_stack_that_stays_drives_all_runs_and_one_that_leaves_is_started_again(graph: Any) -> None:
    scripts = {"stays": STAYS, "leaves": LEAVES}
    egos = [{"name": name, "kind": "external", "command": command(graph, name, path)} for name, path in scripts.items()]
    cold = campaign(graph, egos, ["litsim"])
    started = {name: (graph.folder / name).read_text().count("started") for name in scripts}
    warm = campaign(graph, egos, ["litsim"], "--warm")
    again = {name: (graph.folder / name).read_text().count("started") - started[name] for name in scripts}
    assert (started, again) == ({"stays": 2, "leaves": 2}, {"stays": 1, "leaves": 2})
    assert {name: result.metrics and result.metrics["digest"] for name, result in warm.items()} == {
        name: result.metrics and result.metrics["digest"] for name, result in cold.items()
    }
    assert all(result.metrics and result.recording and result.report and result.log for result in warm.values())
    assert [attachments(graph, "warm", result) for result in warm.values()] == [
        attachments(graph, "cold", cold[name]) for name in warm
    ]


def test_a_stack_that_ends_early_fails_its_runs_with_the_reason(graph: Any) -> None:
    crashes = {"name": "crashes", "kind": "external", "command": ["sh", "-c", "echo no licence; exit 4"]}
    results = campaign(graph, [crashes], ["replay"], "--warm")
    assert {result.reason for result in results.values()} == {
        "the stack (sh -c 'echo no licence; exit 4') ended with exit status 4: no licence"
    }
