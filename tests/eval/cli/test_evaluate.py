"""`evaluate`: what is wrong is said before the first run, every run has a verdict, and what was interrupted goes on."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from campaigns import EGO, scenario_file, told
from command_line import status
from litsim_eval.cli import evaluate, run
from litsim_sim.launch.supervisor import descendants
from litsim_sim.scenario.scenario import packaged
from patience import PATIENCE_S, wait_for

FAULT = {"runs": [{"name": "no fault", "field": "collision.ego_at_fault", "max": 0}]}


@pytest.fixture
def scenario(make_scenario, track, tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(make_scenario(track(1, x=100.0, last=20), track(2, x=60.0, last=20)).to_yaml())
    return path


@pytest.fixture
def criteria(tmp_path: Path) -> Path:
    path = tmp_path / "criteria.yaml"
    path.write_text(yaml.safe_dump(FAULT))
    return path


called = partial(status, evaluate.main)


def results(out: Path) -> dict[str, Any]:
    return json.loads((out / "results.json").read_text())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--policy", "replay", "--set", "conflct.horizon=2"],
            "variant idm, replay: no stage of this run: conflct; expected ego",
        ),
        (
            ["--policy", "yield", "--set", "conflict.horizon=2,-1"],
            "conflict: parameter horizon is -1, expected a number of at least 0.1 and at most 60 [s]",
        ),
        (["--set", "conflict.handback=jump"], "conflict: parameter handback is 'jump'"),
        (["--ego-id", "2,99999"], "99999"),
        (["--ego-id", "tuning"], "tuning"),
        (["--processes", "0"], "'0', expected a whole number of at least 1"),
        (["--ego", "external", "--", "no_such_stack"], "no_such_stack: no such program"),
        (["--warm"], "--warm: expected runs over DDS"),
        (["--policy", "litsm"], "--policy litsm (near: litsim"),
        (["--scenario", "nowhere"], "nowhere"),
    ],
)
def test_what_is_wrong_is_said_before_the_first_run(
    monkeypatch, capsys, tmp_path, scenario, words: list[str], said: str
) -> None:
    monkeypatch.setattr(evaluate, "LocalRuns", lambda *_: pytest.fail("runs have begun"))
    given = words if words[0] == "--scenario" else ["--scenario", scenario, *words]
    assert called("--out", tmp_path / "out", *given) == 2
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("", "line 2, field cases.0: ego_id: 99999 not there at the start of "),
        (
            "parameters: {conflict.horizon: [2, -1]}",
            "line 5, field parameters.conflict.horizon: variant idm, litsim, horizon=-1: conflict: parameter horizon",
        ),
        (
            "policies: [replay, {name: a, kind: litsim,\nparameters: {conflict.horizn: 1}}]",
            "line 5, field policies.1.parameters.conflict.horizn: variant idm, litsim, a: conflict: unknown parameter",
        ),
        (
            "policies: [replay]\nparameters:\n  predictor.model: cv\n  ego.kind: brake",
            "line 7, field parameters.ego.kind: variant idm, replay: ego: unknown parameter kind",
        ),
        (
            "egos:\n- {name: own, kind: external, command: [no_such_stack], parameters: {bridge.patience: 1}}",
            "variant own, litsim: bridge: unknown parameter patience",
        ),
    ],
)
def test_what_is_wrong_in_a_suite_is_told_with_its_file(capsys, tmp_path, scenario, more: str, said: str) -> None:
    suite = tmp_path / "suite.yaml"
    entry = f"{{scenario: {scenario}, ego_id: {1 if more else 99999}}}"
    usual = [line for line in ("egos: [idm]", "policies: [litsim]") if line.split(":")[0] not in more]
    suite.write_text("\n".join(["name: some", f"cases: [{entry}]", *usual, more, ""]))
    assert called("--suite", suite, "--out", tmp_path / "out") == 2
    assert capsys.readouterr().err.startswith(f"error: {suite}: {said}")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ("passed, min: 5", "at least 5"),
        ("errors, equals: 5", "5"),
        ("failed, one_of: [6, 5]", "one of 6, 5"),
        ("passed, min: 4", None),
        ("failed, max: 9", None),
        ("passed_share, min: 0.5", None),
    ],
)
def test_a_count_of_more_runs_than_there_are_is_refused(capsys, tmp_path, scenario, limit: str, said: str) -> None:
    """Two policies drive with two egos."""
    run = "{field: collision.excess, max: 0}"
    kept = f"{{runs: [{run}], suite: [{{field: errors, max: 0}}, {{name: mine, field: {limit}}}]}}"
    suite, criteria = tmp_path / "suite.yaml", tmp_path / "criteria.yaml"
    text = f"name: some\ncases: [{{scenario: {scenario}, ego_id: 1}}]\negos: [idm, log]\npolicies: [yield, replay]\n"
    suite.write_text(text + f"criteria: {kept}\n")
    criteria.write_text(kept)
    wanted = f"{limit.partition(',')[0]} is at most 4, the number of runs, expected {said}\n"
    given = {f"{suite}: field criteria.suite.1": [], f"{criteria}: field suite.1": ["--criteria", criteria]}
    for where, words in given.items():
        status = called("--suite", suite, "--out", tmp_path / "out", "--dry-run", *words)
        assert status == (2 if said else 0)
        assert capsys.readouterr().err == (f"error: {where}: {wanted}" if said else "")


@pytest.mark.parametrize("policy", ["replay", "yield"])
def test_the_table_tells_of_takeovers_where_there_can_be_any(capsys, tmp_path, scenario, policy: str) -> None:
    called("--scenario", scenario, "--policy", policy, "--ego-id", "1", "--all", "--out", tmp_path / "out")
    assert ("takeovers per run" in capsys.readouterr().out) == (policy == "yield")


def test_driven_traffic_is_told_beside_its_log_and_can_be_judged(capsys, tmp_path, criteria) -> None:
    """Behind this ego, agents are under control that follow more closely than in their logs."""
    criteria.write_text(yaml.safe_dump({"runs": [{"field": "traffic.headway_ratio", "min": 0.95}]}))
    words = ["--policy", "yield", "--ego-id", "ego", "--criteria", criteria, "--out", tmp_path / "out"]
    assert called(*words, "--all") == 1
    said = capsys.readouterr()
    assert "median headway, of their logs [s]" in said.out and "traffic.headway_ratio is 0." in said.err
    (variant,) = results(tmp_path / "out")["variants"].values()
    assert 0.0 < variant["traffic_driven"]["headway_s"] < variant["traffic_same_log"]["headway_s"]


def test_intervals_stand_behind_the_figures_on_demand(capsys, tmp_path) -> None:
    words = ["--policy", "replay", "--ego-id", "7", "20", "24", "--out", tmp_path / "out"]
    called(*words, "--all", "--intervals")
    found = re.search(r"colliding agents ↓ +(\d+) \[(\d+), (\d+)\]", capsys.readouterr().out)
    assert found is not None and int(found[2]) < int(found[1]) < int(found[3])
    called(*words, "--all")
    assert re.search(r"colliding agents ↓ +\d+ *\n", capsys.readouterr().out)


def test_several_egos_and_values_are_variants(capsys, tmp_path, criteria) -> None:
    """Taken over by predicted contacts, those behind the ego are held for less time if their logs may be shifted."""
    waves = {"recording": str(packaged("scenarios/us101_like.parquet")), "ego": 7, "egos": [7], "simulation_s": 14.0}
    words = ["--policy", "replay", "yield", "--set", "conflict.handback=catch_up,time_shift", "conflict.unlikely=0"]
    words += ["--ego-id", "ego"]
    words += ["--scenario", scenario_file(tmp_path, "waves", **waves)]
    called("--ego", "idm", "log", *words, "--all", "--out", tmp_path / "out", "--criteria", criteria)
    found = results(tmp_path / "out")["variants"]
    variants = ["replay", "yield, handback=catch_up", "yield, handback=time_shift"]
    assert list(found) == [f"{ego}, {variant}" for ego in ("idm", "log") for variant in variants]
    assert found["idm, yield, handback=time_shift"]["held_s"] < found["idm, yield, handback=catch_up"]["held_s"]
    printed = capsys.readouterr().out
    assert "time under control [s]" in printed and "  6  log, yield, handback=time_shift\n" in printed


@pytest.mark.parametrize(("limit", "status"), [(0, 1), (100, 0)])
def test_the_exit_status_is_the_verdict_by_the_criteria(tmp_path, capsys, limit: int, status: int) -> None:
    criteria = tmp_path / "criteria.yaml"
    some = {"name": "few", "field": "collision.excess", "max": limit}
    criteria.write_text(yaml.safe_dump({"runs": [some]}))
    words = ["--policy", "replay", "--ego-id", "ego", "--criteria", criteria, "--out", tmp_path / "out"]
    assert called(*words) == status
    said = capsys.readouterr()
    assert (f"failed  demo/{EGO}/idm/replay: few: collision.excess is " in said.err) == bool(status)
    assert f"{1 - status} passed, {status} failed, 0 errors" in said.out
    assert re.search(r"runs with new contacts ↓ +1 *\n", said.out) and "contacts, background's fault ↓" in said.out
    found = results(tmp_path / "out")
    assert found["verdict"] == ("failed" if status else "passed")
    variant = found["variants"]["idm, replay"]
    assert variant["colliding_runs"] == 1 and variant["background_faults"] > 0
    passed = "idm, replay: 1 of 1 runs that passed have contacts that the log has not, "
    by_fault = f"{variant['background_faults']} at the background's fault and 0 at the ego's\n"
    assert (passed + by_fault in said.out) == (not status)
    page = tmp_path / "out/experiment.html"
    assert f"report: {page}\n" in said.out
    assert ('<span class="badge bad">not passed</span>' in page.read_text()) == bool(status)


def test_a_run_that_fails_is_marked_in_the_table_listed_and_run_again_on_demand(
    monkeypatch, capsys, tmp_path, scenario, criteria
) -> None:
    net, other = tmp_path / "lost.net.xml", tmp_path / "lost.yaml"
    fields = yaml.safe_load(scenario.read_text())
    shutil.copy(fields["net"], net)
    other.write_text(yaml.safe_dump(fields | {"net": str(net)}))
    words = ["--scenario", scenario, other, "--ego-id", "1", "--policy", "replay", "--out", tmp_path / "out"]
    words += ["--criteria", criteria, "--all"]
    kept = tmp_path / "kept"
    local_runs = evaluate.LocalRuns

    def without_net(*given: Any) -> Any:
        net.rename(kept)  # gone after all was checked, before the run
        return local_runs(*given)

    monkeypatch.setattr(evaluate, "LocalRuns", without_net)
    assert called(*words) == 1
    monkeypatch.undo()
    said = capsys.readouterr()
    cells = {line.rsplit(maxsplit=1)[0].strip(): line.split()[-1] for line in said.out.splitlines() if line.split()}
    assert (cells["runs"], cells["passed ↑"], cells["errors ↓"]) == ("2", "1", "1")
    assert cells["agents"].endswith("*") and not cells["no new contacts [%] ↑"].endswith("*")
    assert "error   lost/1/idm/replay: " in said.err and "lost.net.xml" in said.err
    found = {each["case"]["name"]: each["verdict"] for each in results(tmp_path / "out")["runs"]}
    assert found == {"short/1/idm/replay": "passed", "lost/1/idm/replay": "error"}

    kept.rename(net)
    assert called(*words) == 1, "it is known how that run has come out"
    assert called(*words, "--dry-run", "--retry-errors") == 0
    assert "to run  lost/1/idm/replay\n" in capsys.readouterr().out
    assert called(*words, "--retry-errors") == 0
    assert results(tmp_path / "out")["verdict"] == "passed"


def test_a_dry_run_says_what_would_be_run_and_touches_nothing(capsys, tmp_path, scenario, criteria) -> None:
    words = ["--scenario", scenario, "--ego-id", "1", "--policy", "replay", "--out", tmp_path / "out"]
    words += ["--criteria", criteria]
    assert called(*words, "--dry-run") == 0
    assert capsys.readouterr().out.splitlines() == [
        "to run  short/1/idm/replay",
        "0 passed, 0 failed, 0 errors; 1 of 1 to be run",
    ]
    assert not (tmp_path / "out").exists()
    called(*words)
    capsys.readouterr()
    words[3] = "1,2"
    assert called(*words, "--dry-run") == 0
    assert capsys.readouterr().out.splitlines() == [
        "passed  short/1/idm/replay",
        "to run  short/2/idm/replay",
        "1 passed, 0 failed, 0 errors; 1 of 2 to be run",
    ]


def test_another_campaign_in_the_folder_is_kept_unless_it_may_go(capsys, tmp_path, scenario) -> None:
    words = ["--scenario", scenario, "--policy", "replay", "--out", tmp_path / "out"]
    called(*words, "--ego-id", "1")
    assert called(*words, "--ego-id", "2") == 2
    assert "holds another campaign" in capsys.readouterr().err
    called(*words, "--ego-id", "2", "--overwrite")
    assert [each["case"]["ego_id"] for each in results(tmp_path / "out")["runs"]] == [2]


DEMO = ("--ego-id", "3,7,24", "--ego", "idm", "perturbed", "--policy", "replay", "--processes", "2")


@pytest.fixture(scope="module")
def short_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of the demo: six of its runs take a while, which is enough to end them midway."""
    return Path(scenario_file(tmp_path_factory.mktemp("short_demo"), "demo", simulation_s=15.0))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, short_demo: Path) -> tuple[int, list[Any]]:
    """Exit status and results of the campaign that nothing ends."""
    out = tmp_path_factory.mktemp("whole")
    return called("--scenario", short_demo, *DEMO, "--out", out), told(out)


def start(scenario: Path, out: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "litsim_eval.cli.evaluate", "--scenario", str(scenario), *DEMO, "--out", str(out)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def test_parts_that_are_merged_are_the_whole(capsys, tmp_path, short_demo: Path, whole: tuple[int, list[Any]]) -> None:
    parts = [tmp_path / "second", tmp_path / "first"]
    for part, number in zip(parts, ("2/2", "1/2"), strict=True):
        called("--scenario", short_demo, *DEMO, "--part", number, "--out", part)
    assert (called("--merge", *parts, "--out", tmp_path / "out"), told(tmp_path / "out")) == whole
    assert len(told(parts[0])) == 3
    assert called("--part", "3/2", "--out", tmp_path / "third") == 2
    assert "'3/2', expected I/N" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_what_was_ended_midway_goes_on_to_the_result_of_one_that_was_not(
    tmp_path, short_demo: Path, whole: tuple[int, list[Any]], number: signal.Signals
) -> None:
    ended = start(short_demo, tmp_path / "ended")
    wait_for("a result", lambda: list(tmp_path.glob("ended/runs/*/result.json")))
    workers = descendants(ended.pid)
    os.kill(ended.pid, number)
    said = ended.communicate(timeout=PATIENCE_S)[1]
    assert ended.returncode == (-number if number == signal.SIGKILL else 130)
    assert "Traceback" not in said
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "ended").glob("runs/*/result.json")}
    if number == signal.SIGINT:
        assert "the same command resumes it" in said
        assert len(results(tmp_path / "ended")["runs"]) == len(before)
    wait_for("the end of its processes", lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers))
    status = called("--scenario", short_demo, *DEMO, "--out", tmp_path / "ended")
    assert (status, told(tmp_path / "ended")) == whole
    assert len(whole[1]) == 6 and len(before) < 6
    assert all(path.stat().st_mtime_ns == when for path, when in before.items()), "no run twice"


@pytest.mark.parametrize("policy", ["replay", "yield"])
def test_every_policy_can_be_run(monkeypatch, tmp_path, scenario, policy: str) -> None:
    out = tmp_path / "metrics.json"
    words = ["--scenario", str(scenario), "--policy", policy, "--predictor", "kinematic", "--json", str(out)]
    monkeypatch.setattr(sys, "argv", ["run", *words])
    run.main()
    assert json.loads(out.read_text())["policy"] == policy
