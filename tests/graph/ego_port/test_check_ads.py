"""`check_ads` passes a stack that keeps the contract, and of one that breaks it fails the clause that says so."""

import json
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_eval.cli import check_ads
from patience import wait_for

HERE = Path(__file__).parents[1]
EXAMPLES = HERE.parents[1] / "examples"
CLAUSES = (
    "discovery",
    "types and QoS",
    "keeps to its topics",
    "answers every step",
    "latency",
    "frames plausible",
    "values finite and feasible",
    "end of run",
)


def start(graph: Any, *arguments: object, command: tuple[object, ...] = ()) -> Any:
    """Start `check_ads` on the short scenario, with patience."""
    scenario, result = graph.scenario(), graph.folder / "result.json"
    usual = ("--scenario", scenario, "--seconds", 3, "--answer-timeout", 8, "--end-wait", 2, "--wait", 60)
    usual += ("--json", result)
    stack = ("--", sys.executable, *command) if command else ()
    return graph.start_node("litsim_eval", "check_ads", *map(str, (*usual, *arguments, *stack)))


def verdicts(graph: Any) -> dict[str, str]:
    clauses = json.loads((graph.folder / "result.json").read_text())["clauses"]
    assert tuple(clauses) == CLAUSES
    return {name: clause["verdict"] for name, clause in clauses.items()}


def why(graph: Any, clause: str) -> str:
    return json.loads((graph.folder / "result.json").read_text())["clauses"][clause]["why"]


def test_an_example_passes(graph: Any) -> None:
    """The others drive a whole run in test_minimal_ads.py."""
    done = graph.finish(start(graph, "--out", graph.folder / "kept", command=(EXAMPLES / "trajectory_ads.py",)))
    assert done.returncode == 0, done.stdout + done.stderr
    assert verdicts(graph) == dict.fromkeys(CLAUSES, "pass")
    result = json.loads((graph.folder / "result.json").read_text())
    assert (result["passed"], result["steps"]) == (True, 35)
    clauses = result["clauses"]
    assert list(clauses["discovery"]["publishers_s"]) == ["/litsim/ego/trajectory"]
    # what has been found of it by the end of so short a run
    reads = {
        f"/litsim/{name}" for name in ("ego/footprint", "ego/route", "ego/state", "lanes/table", "lights", "objects")
    }
    reads |= {"/diagnostics"}
    assert clauses["discovery"]["reads"] and set(clauses["discovery"]["reads"]) <= reads
    assert (clauses["answers every step"]["steps"], clauses["answers every step"]["missing"]) == (36, [])
    times = [clauses["latency"][name] for name in ("min_ms", "median_ms", "p95_ms", "max_ms")]
    assert times == sorted(times)
    assert clauses["end of run"] | {"why": ""} == {
        "verdict": "pass",
        "why": "",
        "state": "FINISHED",
        "left": None,
        "exit_status": 0,
        "last_message_s": None,
    }
    assert list((graph.folder / "kept").glob("*.mcap"))
    assert not graph.running()


def test_a_fault_fails_its_clause_alone(graph: Any) -> None:
    """It is found, and then waited for as long; faults in mid-run are in tests/eval/check_ads."""
    command = (HERE / "programs/standard_ego.py", "--reliability", "best_effort")
    done = graph.finish(start(graph, "--wait", 12, command=command))
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    found = verdicts(graph)
    assert [name for name, verdict in found.items() if verdict == "fail"] == ["types and QoS"]
    words = "/litsim/ego/twist: publisher does not match: offered BEST_EFFORT VOLATILE, requested RELIABLE VOLATILE"
    assert words in why(graph, "types and QoS")
    not_begun = list(CLAUSES[3:7])
    assert [name for name, verdict in found.items() if verdict == "not judged"] == not_begun
    assert not graph.running()


def test_a_stack_that_others_have_started(graph: Any) -> None:
    stack = graph.start_script("standard_ego.py", "--interface", "trajectory")
    done = graph.finish(start(graph, "--warm"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert why(graph, "begins anew") == "a second run has the digest of the first"
    assert "by /standard_ego" in why(graph, "discovery")
    assert "its publisher is still there, idle" in why(graph, "end of run")
    assert graph.end(stack, signal.SIGKILL)[0] == -signal.SIGKILL  # it was left alone


def test_all_of_a_stack_ends_with_a_check_that_is_ended(graph: Any) -> None:
    script = "import os; os.system('setsid sleep 600 & sleep 601')"
    check = start(graph, command=("-c", script))
    wait_for("the stack", lambda: {"sleep 600 ", "sleep 601 "} <= set(graph.running().values()))
    graph.end(check, signal.SIGTERM)
    wait_for("the end of all", lambda: not graph.running())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--scenario", "nowhere"), "error: nowhere: no such scenario"),
        (
            ("--", "no-such-stack"),
            "error: no-such-stack: no such program, expected the command that starts a driving stack",
        ),
    ],
)
def test_bad_input(
    arguments: tuple[str, ...], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["check_ads", *arguments])
    monkeypatch.setattr(check_ads, "interrupt_on_signals", lambda: None)  # this process has its own
    with pytest.raises(SystemExit) as stop:
        check_ads.main()
    assert stop.value.code == 2
    assert words in capsys.readouterr().err
