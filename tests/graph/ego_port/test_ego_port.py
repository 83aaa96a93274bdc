"""The ego port over DDS with standard types: it serves, and whatever comes on it harms nothing else."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import resimulate
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import Run, read_run

WARN = b"\x01"
PATIENT, IMPATIENT = 60.0, 6.0
"""[s] for an answer: of an ego that answers, however busy the machine; of one that may not."""
STARTED_AGAIN = (
    "/standard_ego: its publisher on /litsim/ego/twist was not there at step 0; a stack that has been started again in "
    "mid-run answers without what it knew before"
)
COUNTS = {"answered": 36, "late": 0, "stale": 0, "future": 0, "surplus": 0, "invalid": 0, "refused": 0, "joined": 0}


def launch(graph: Any, *ego: object, launcher: tuple[object, ...] = (), timeout: float = PATIENT) -> Any:
    graph.start_script("standard_ego.py", *ego)
    return run_for(graph, "--answer-timeout", timeout, *launcher)


def run_for(graph: Any, *launcher: object) -> Any:
    """A run for a stack that is there, or comes."""
    options = ("--ego", "external", "--policy", "replay", "--out", graph.folder / "run", "--domain-id", graph.domain)
    return graph.launch("--scenario", graph.scenario(), *options, *launcher)


def lockstep(graph: Any) -> dict[str, Any]:
    return json.loads((graph.folder / "run/metrics.json").read_text())["lockstep"]


def said(bag: Path) -> list[tuple[bytes, str]]:
    """Level and text of what the port said on /diagnostics, from the record."""
    arrays = [deserialize_message(m.data, DiagnosticArray) for m in BagReader(bag).messages(["/diagnostics"])]
    found = [status for array in arrays for status in array.status if status.name == "litsim: ego port"]
    return [(status.level, status.message) for status in found if status.message]


def ego(run: Run, field: str) -> np.ndarray:
    return np.array([getattr(table, field)[table.row(run.info.ego_id)] for table in run.tables])


def test_it_is_driven_recorded_and_run_again(graph: Any) -> None:
    done = launch(graph, "--interface", "trajectory", launcher=("--vehicle", "delay_s=0.1", "lag_s=0.2"))
    assert done.returncode == 0, done.stderr
    line = "waiting for an external ego to answer on /litsim/ego/control or /litsim/ego/twist or /litsim/ego/trajectory"
    assert f"in ROS_DOMAIN_ID {graph.domain}\n{line}\n" in done.stdout
    bag = graph.folder / "run"
    port = lockstep(graph)["ego_port"]
    assert {name: port[name] for name in COUNTS} == COUNTS
    assert port["interface"] == "trajectory"
    run = read_run(bag)
    assert sorted(run.ego_commands) == list(range(36))
    assert ego(run, "speed") == pytest.approx(np.full(36, 15.0), abs=0.01)
    count = Counter(message.topic for message in BagReader(bag).messages())
    assert count["/litsim/ego/trajectory"] == count["/litsim/ego/applied"] == 36
    with open_record(bag) as record:
        assert record.scenario.vehicle.delay_s == 0.1
        again = resimulate(record)
    assert (again.steps, again.computed) == (36, again.recorded)


def test_what_is_not_asked_for_is_counted_and_changes_nothing(graph: Any) -> None:
    done = launch(graph, "--fault", "flood")
    assert done.returncode == 0, done.stderr
    counted = lockstep(graph)
    assert (counted["missed"], counted["gaps"]) == (0, 0)
    port = counted["ego_port"]
    assert port["surplus"] + port["stale"] > 0  # stale, if the next step had already begun
    assert port["answered"] == 36
    warnings = [text for level, text in said(graph.folder / "run") if level == WARN]
    assert any("more answers to step " in text or text.endswith(" is stale") for text in warnings)
    run = read_run(graph.folder / "run")
    assert ego(run, "speed") == pytest.approx(np.full(36, 15.0), abs=0.01)
    times = [message.log_time_ns for message in BagReader(graph.folder / "run").messages()]
    assert max(times) == 35 * 10**8  # a stamp of another time does not lengthen the record
    per_step = Counter(
        message.log_time_ns for message in BagReader(graph.folder / "run").messages(["/litsim/ego/twist"])
    )
    assert max(per_step.values()) <= 20


def test_two_stacks_that_answer_end_the_run(graph: Any) -> None:
    for name in ("forgotten", "standard_ego"):  # at a steady pace: the run is not over before both are found
        stack = graph.start_script("standard_ego.py", "--fault", "steady", "--ros-args", "-r", f"__node:={name}")
        assert stack.stdout.readline() == "ready\n"
    done = run_for(graph)
    assert done.returncode == 1
    assert "2 publishers are on /litsim/ego/twist (/forgotten, /standard_ego), and " in done.stderr
    assert read_run(graph.folder / "run").failure


def test_a_stack_that_is_started_again_is_told(graph: Any) -> None:
    """It answers on, before DDS has noticed that the first one is gone."""
    first = graph.start_script("standard_ego.py", "--fault", "death")
    options = ("--ego", "external", "--policy", "replay", "--out", graph.folder / "run", "--domain-id", graph.domain)
    launcher = graph.start_launch("--scenario", graph.scenario(), "--answer-timeout", PATIENT, *options)
    graph.finish(first)
    graph.start_script("standard_ego.py")
    done = graph.finish(launcher)
    assert done.returncode == 0, done.stderr
    assert STARTED_AGAIN in done.stderr
    assert said(graph.folder / "run").count((WARN, STARTED_AGAIN)) == 1
    port = lockstep(graph)["ego_port"]
    assert {name: port[name] for name in COUNTS} == COUNTS | {"joined": 1}


def test_topics_are_remapped_at_the_bridge(graph: Any) -> None:
    graph.start_script("standard_ego.py", "--topic", "cmd", "--ros-args", "-r", "__ns:=/stack")
    remapping = ("-r", "/litsim/ego/twist:=/stack/cmd")
    recorder = graph.start_node("litsim_sim", "recorder", *remapping, output=graph.folder / "run")
    parameters = {"scenario": graph.scenario(), "ego": "external", "policy": "replay", "progress": "none"}
    bridge = graph.start_node("litsim_sim", "bridge", *remapping, **parameters)
    assert graph.finish(bridge).returncode == 0
    assert graph.finish(recorder).returncode == 0
    assert read_run(graph.folder / "run").summary["ego_port"]["answered"] == 36
