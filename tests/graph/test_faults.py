"""What goes wrong in a run changes nothing, or ends it with one line that names it; the table is in docs/faults.md.

Other files here have the rest of it: pauses, the launcher, the recorder, two runs on a domain, external egos.
"""

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_eval.analysis.measures.identity import digest
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.benchmark.steps import write_scenario
from litsim_eval.runs.in_process import record
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from patience import wait_for

PROGRAMS = {
    "predictor": ("litsim_predictor", "predictor"),
    "conflict": ("litsim_policy", "conflict"),
    "policy": ("litsim_policy", "policy"),
    "ego": ("litsim_policy", "ego"),
}
HOPS = {
    "bridge": "/litsim/agents",
    "predictor": "/litsim/forecasts",
    "conflict": "/litsim/takeovers",
    "policy": "/litsim/controls",
    "ego": "/litsim/ego/control",
}
"""What each node publishes in every step."""
DEEDS = ("lost", "late", "twice", "older")  # of the relay
MEMORY = 400 * 2**20  # bytes; a node takes more than twice as much address space
CLOCK = Path(__file__).with_name("jumping_clock.c")


def error_of(done: subprocess.CompletedProcess[str]) -> str:
    """The one error of a run that has failed."""
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("error: "))
    return line.removeprefix("error: ")


def assert_whole_steps(bag: Path) -> int:
    """See that the record holds every step up to the last; returns that."""
    steps = [table.step for table in read_run(bag).tables]
    assert steps == list(range(len(steps)))
    return len(steps) - 1


@pytest.mark.parametrize("name", ["bridge", "stages"])
def test_a_node_that_is_killed_is_named(graph: Any, name: str) -> None:
    """Of a stage with a process of its own and the recorder, see test_launcher.py and test_recording.py."""
    bag = graph.folder / "run"
    policy = "litsim" if name == "stages" else "replay"
    scenario = graph.scenario(simulation_s=24.0)
    words = ("--mode", "realtime", "--scenario", scenario, "--policy", policy, "--out", bag)
    launcher = graph.start_launch(*words, *(() if name == "stages" else ("--apart",)))
    graph.wait_under_way(bag)
    graph.signal(name, signal.SIGKILL)
    error = error_of(graph.finish(launcher))
    several = {"stages": "process stages (ego, predictor, conflict, policy)"}
    named = several.get(name, f"node {name.removesuffix('_idm')}")
    assert error.startswith(f"{named} was ended by SIGKILL (logs: ")
    assert not graph.running()
    assert read_run(bag).complete
    assert 9 <= assert_whole_steps(bag) < 245


def test_messages_lost_late_twice_or_out_of_order_change_nothing(graph: Any, recorded: Any) -> None:
    expected = json.loads((recorded("idm", "litsim").bag / "metrics.json").read_text())["digest"]
    relay = graph.start_script("relay.py", *HOPS.values())
    recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / "run")
    before = {name: ("--ros-args", "-r", f"{topic}:=/before{topic}") for name, topic in HOPS.items()}
    for name, program in PROGRAMS.items():
        graph.start_node(*program, *before[name])
    given = {"scenario": graph.scenario(), "progress": "none", "handshake_timeout_s": "200.0"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", *before["bridge"][1:], **given))
    assert bridge.returncode == 0, bridge.stderr
    assert graph.finish(recorder).returncode == 0
    metrics = compute_metrics(read_run(graph.folder / "run"))
    assert (metrics["valid"], metrics["why"], metrics["digest"]) == (True, "", expected)
    _, said = graph.end(relay)
    done = {tuple(line.split()) for line in said.splitlines() if line.startswith(DEEDS)}  # not how it was ended
    assert done == {(deed, topic) for deed in DEEDS for topic in HOPS.values()}


def test_a_node_without_memory_ends_the_run(graph: Any) -> None:
    """It is given less than it takes to get ready; how that ends is up to the library that wants some first."""
    bag = graph.folder / "run"
    launcher = graph.start_launch("--scenario", graph.scenario(), "--out", bag, "--apart")
    wait_for("the predictor", lambda: [line for line in graph.running().values() if "/predictor " in line])
    (pid,) = (pid for pid, line in graph.running().items() if "/predictor " in line)
    resource.prlimit(pid, resource.RLIMIT_AS, (MEMORY, MEMORY))
    error = error_of(graph.finish(launcher))
    assert error.removeprefix("node ").startswith("predictor")
    assert not graph.running()


def test_a_wall_clock_that_is_set_back_amid_a_run_does_not_matter(graph: Any, tmp_path: Path) -> None:
    by_s = -3600
    library, go, bag = tmp_path / "clock.so", graph.folder / "go", graph.folder / "run"
    subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-Wall", "-Werror", "-o", library, CLOCK], check=True)
    clock = {"LD_PRELOAD": str(library), "CLOCK_JUMPS": str(go), "CLOCK_JUMP": str(by_s)}
    graph.start_script("external_ego.py", "--hold-at", 20, "--until", go)
    words = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "replay", "--out", bag)
    launcher = graph.start_launch(*words, "--domain-id", graph.domain, "--answer-timeout", 60, **clock)
    log = bag / "log/bridge.log"
    wait_for("step 20", lambda: log.is_file() and "step 20: waiting for /litsim/ego/" in log.read_text())
    before = wall_clock(clock)
    go.touch()
    assert abs(wall_clock(clock) - before - by_s) < 1800
    done = graph.finish(launcher)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((bag / "metrics.json").read_text())
    assert (metrics["valid"], metrics["lockstep"]["missed"], metrics["lockstep"]["gaps"]) == (True, 0, 0)


def wall_clock(environment: dict[str, str]) -> float:
    """What a process sees [s]."""
    words = [sys.executable, "-c", "import time; print(time.time())"]
    return float(subprocess.run(words, env=os.environ | environment, capture_output=True, check=True).stdout)


def test_a_thousand_agents_are_nothing_special(graph: Any) -> None:
    """For ten minutes, and the memory that they take, see docs/performance.md."""
    scenario, bag = write_scenario(graph.folder, 1000, 3.5), graph.folder / "run"
    done = graph.launch("--scenario", scenario, "--ego", "idm", "--policy", "litsim", "--out", bag, "--no-analyze")
    assert done.returncode == 0, done.stderr
    run, plan = read_run(bag), RunPlan(Scenario.load(scenario), "idm", "litsim")
    assert run.complete and not any(run.gaps.values())
    assert assert_whole_steps(bag) == plan.scenario.total_steps
    assert max(len(table.id) for table in run.tables) == 1000
    assert digest(run) == digest(record(plan))
