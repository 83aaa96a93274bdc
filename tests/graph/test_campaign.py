"""Campaigns over DDS: runs side by side, each in a domain of its own; a stack that fails fails its runs alone."""

import json
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml
from junitparser import JUnitXml

from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import RunResult, read_campaign, rerun_command
from litsim_eval.report.thumbnails import read_thumbnail
from litsim_eval.report.verdict import verdict_in
from litsim_sim.record.run import read_run
from patience import wait_for

STACK = [sys.executable, str(Path(__file__).with_name("programs") / "external_ego.py")]
IMPATIENT = {"bridge.answer_timeout_s": 6.0}
EGOS = [
    {"name": "good", "kind": "external", "command": STACK},
    {"name": "crashes", "kind": "external", "command": ["sh", "-c", "echo no licence; exit 4"]},
    {"name": "hangs", "kind": "external", "command": [*STACK, "--skip", "12-99"], "parameters": IMPATIENT},
    {"name": "lies", "kind": "external", "command": [*STACK, "--nan-at", "12"]},
    "log",
]
CRITERIA = {"runs": [{"name": "no fault", "field": "collision.ego_at_fault", "max": 0}]}


def suite(graph: Any, egos: list[Any], ids: list[int]) -> Path:
    path: Path = graph.folder / "suite.yaml"
    content = {"name": "short", "cases": [{"scenario": "short.yaml", "ego_id": ids}], "egos": egos}
    graph.scenario()
    path.write_text(yaml.safe_dump(content | {"policies": ["replay"], "criteria": CRITERIA}))
    return path


def start(graph: Any, file: Path, *options: object, **environment: str) -> subprocess.Popen[str]:
    words = ("--suite", file, "--out", graph.folder / "out", *options)
    return graph.start_program("litsim_eval", "evaluate", *words, **environment)


def by_ego(graph: Any) -> dict[str, RunResult]:
    return {result.case.ego.name: result for result in read_campaign(graph.folder / "out").results}


def test_a_stack_that_is_broken_fails_its_run_with_the_reason_and_no_other(graph: Any) -> None:
    done = graph.finish(start(graph, suite(graph, EGOS, [13]), "--graph", "--processes", 2))
    assert done.returncode == 1, done.stderr
    assert not graph.running()
    found = by_ego(graph)
    assert {name: result.verdict for name, result in found.items()} == {
        "good": Verdict.PASSED,
        "crashes": Verdict.ERROR,
        "hangs": Verdict.ERROR,
        "lies": Verdict.ERROR,
        "log": Verdict.PASSED,
    }
    reasons = {name: result.reason for name, result in found.items()}
    assert "sh -c 'echo no licence; exit 4') ended with exit status 4: no licence" in reasons["crashes"]
    assert reasons["hangs"].startswith("no answer to step 12 on /litsim/ego/control within 6 s")
    assert "cannot be used: acceleration is nan" in reasons["lies"]
    assert f"error   short/13/crashes/replay: {reasons['crashes']}" in done.stderr

    tests = {test.name: test for each in JUnitXml.fromfile(str(graph.folder / "out/junit.xml")) for test in each}
    (said,) = tests["short/13/crashes/replay"].result
    assert "no licence" in said.text and type(said).__name__ == "Error"
    assert not tests["short/13/good/replay"].result

    folders = {name: graph.folder / "out/runs" / result.case.id for name, result in found.items()}
    crashed, good = found["crashes"], found["good"]
    assert crashed.log and (folders["crashes"] / crashed.log).read_text() == "no licence\n"
    assert good.recording and good.report and (folders["good"] / good.report).is_file()
    lies = found["lies"]
    assert lies.report and "not valid" in (folders["lies"] / lies.report).read_text(), "what led to an error is played"
    assert lies.metrics is None and lies.report in tests["short/13/lies/replay"].result[0].text
    assert read_thumbnail(folders["good"]) is not None
    run = read_run(folders["good"] / good.recording)
    assert (run.info.ego, run.complete) == ("external", True)
    assert good.metrics is not None and good.metrics["steps"] == 35


def test_a_failed_run_is_run_again_by_the_command_that_is_named(graph: Any) -> None:
    file = suite(graph, EGOS[:1], [13])
    strict = {"runs": [{"name": "far", "field": "ego_motion.progress_ratio", "min": 9.0}]}
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"criteria": strict}))
    done = graph.finish(start(graph, file))
    assert done.returncode == 1, done.stderr
    (first,) = read_campaign(graph.folder / "out").results
    command = rerun_command(graph.folder / "out", first.case)
    assert command in done.stderr
    words = shlex.split(command)
    assert words[0].endswith("litsim") and words[1] == "evaluate"
    again = graph.finish(graph.start_program("litsim_eval", *words[1:]))
    assert again.returncode == 1, again.stderr
    out = Path(words[-1])
    (second,) = read_campaign(out).results
    assert (second.case.id, second.verdict, second.criteria) == (first.case.id, Verdict.FAILED, first.criteria)
    assert second.metrics and first.metrics and second.metrics["digest"] == first.metrics["digest"]
    page = out / "runs" / second.case.id / str(second.report)
    verdict = json.loads(verdict_in(page))
    assert (verdict["verdict"], verdict["reason"]) == ("failed", second.reason)
    back, _, run = verdict["campaign"].partition("#")
    assert (page.parent / back).resolve() == (out / "experiment.html").resolve() and run == f"run={second.case.id}"


def test_a_stack_that_runs_already_drives_in_one_run_after_the_other(graph: Any) -> None:
    stack = graph.start_script("external_ego.py")
    file = suite(graph, [{"name": "mine", "kind": "external", "interface": "control"}], [13, 21])
    done = graph.finish(start(graph, file, "--processes", 2, ROS_DOMAIN_ID=str(graph.domain)))
    assert done.returncode == 0, done.stderr
    assert stack.poll() is None, "it was kept alive over the runs"
    results = read_campaign(graph.folder / "out").results
    assert [result.case.ego_id for result in results] == [13, 21]
    assert all(result.metrics and result.metrics["lockstep"]["missed"] == 0 for result in results)


def test_what_a_killed_campaign_has_started_ends_and_it_goes_on(graph: Any) -> None:
    slow = {"name": "slow", "kind": "external", "command": [*STACK, "--late", "10-20", "--late-by", "0.5"]}
    file = suite(graph, [slow], [13])
    killed = start(graph, file)
    wait_for("the run", lambda: list(graph.folder.glob("out/runs/*/run/*.mcap")))
    graph.end(killed, signal.SIGKILL)
    wait_for("the end of all that it started", lambda: not graph.running())
    assert not read_campaign(graph.folder / "out").results
    done = graph.finish(start(graph, file))
    assert done.returncode == 0, done.stderr
    (result,) = read_campaign(graph.folder / "out").results
    assert result.verdict == Verdict.PASSED
    assert result.metrics is not None and result.metrics["timing"]["answer_ms"]["p99"] > 500.0, "it sleeps for as long"
    assert [path.name for path in (graph.folder / "out/runs").iterdir()] == [result.case.id]
