"""Autoware through its adapter: a stand-in that knows only Autoware's topics and services drives, twice the same."""

from __future__ import annotations

import json
import sys
from collections import Counter
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message

from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run

STAND_IN = Path(__file__).parent / "stand_in_autoware.py"
PLANNED = "/planning/trajectory"
NEEDED = ("autoware_adapi_v1_msgs", "autoware_control_msgs", "autoware_perception_msgs", "autoware_planning_msgs")
with_types = pytest.mark.skipif(
    not all(find_spec(name) for name in NEEDED), reason="Autoware's messages are not built (tools/interfaces.sh)"
)


def drive(
    graph: Any, name: str, *options: object, ego: str = "autoware", stack: tuple[str, ...] = (), policy: str = "replay"
) -> Any:
    """A run of the stand-in: how the launcher ended, and its metrics."""
    bag = graph.folder / name
    setup = ("--scenario", graph.scenario(), "--ego", ego, "--policy", policy, "--out", bag, *options)
    done = graph.launch(*setup, "--", sys.executable, STAND_IN, *stack)
    assert not graph.running()
    return done, json.loads((bag / "metrics.json").read_text()) if (bag / "metrics.json").is_file() else None


@with_types
def test_core_drives_and_drives_the_same_way_again(graph: Any) -> None:
    digests = []
    for name in ("first", "second"):
        done, metrics = drive(graph, name, policy="litsim")
        assert done.returncode == 0, done.stderr + (graph.folder / name / "log/ads.log").read_text()
        port = metrics["lockstep"]["ego_port"]
        assert (metrics["lockstep"]["missed"], port["interface"], port["answered"]) == (0, "control", 36)
        assert metrics["collision"]["ego_at_fault"] == 0
        digests.append(metrics["digest"])
    assert digests[0] == digests[1]
    reports = values_of(graph.folder / "second", "litsim: autoware")
    assert {values["gear"] for values in reports} == {"2"}
    assert {values["mrm_state"] for values in reports} >= {"1"}  # normal
    assert {"1", "2"} & {values["turn_indicators"] for values in reports}
    planned = Counter(m.log_time_ns // 10**8 for m in BagReader(graph.folder / "second").messages([PLANNED]))
    assert sorted(planned)[-10:] == list(range(26, 36))  # raw, as the stack has planned
    assert not list(BagReader(graph.folder / "second").messages(["/clock"]))  # that of the stack has a time of its own


@with_types
@pytest.mark.parametrize(
    ("ego", "options", "stack"),
    [
        ("autoware_universe", (), ("--universe", "--sim-time")),
        ("autoware", ("--mode", "realtime"), ()),
    ],
)
def test_universe_and_real_time(graph: Any, ego: str, options: tuple[str, ...], stack: tuple[str, ...]) -> None:
    done, metrics = drive(graph, "run", *options, ego=ego, stack=stack)
    if not options:  # on a busy machine, answers may be late in real time
        assert done.returncode == 0, done.stderr + (graph.folder / "run/log/ads.log").read_text()
    assert metrics["steps"] == 35
    run = read_run(graph.folder / "run")
    speed = [float(table.speed[table.row(run.info.ego_id)]) for table in run.tables]
    assert min(speed) > 5.0 and max(abs(a - b) for a, b in pairwise(speed)) < 0.5
    modes = {values["control_mode"] for values in values_of(graph.folder / "run", "litsim: autoware")}
    assert modes == {"1"}  # autonomous


@with_types
def test_a_trajectory_is_followed_and_the_adapter_may_be_started_by_hand(graph: Any) -> None:
    bag = graph.folder / "run"
    setup = ("--scenario", graph.scenario(), "--policy", "replay", "--out", bag, "--set", "bridge.clock=false")
    program = Path(get_package_prefix("litsim_autoware")) / "lib/litsim_autoware/autoware"
    adapter = (program, "--answers", "trajectory", "--goal", 120.0, -5.5, 0.0)
    done = graph.launch("--ego", "external", *setup, "--", *adapter, "--", sys.executable, STAND_IN)
    assert done.returncode == 0, done.stderr + (bag / "log/ads.log").read_text()
    port = json.loads((bag / "metrics.json").read_text())["lockstep"]["ego_port"]
    assert (port["interface"], port["answered"], port["invalid"]) == ("trajectory", 36, 0)
    run = read_run(bag)
    speed = [float(table.speed[table.row(run.info.ego_id)]) for table in run.tables]
    assert min(speed) > 5.0 and max(abs(a - b) for a, b in pairwise(speed)) < 0.9


@with_types
def test_what_is_waited_for_is_told(graph: Any) -> None:
    bag = graph.folder / "run"
    options = ("--set", "bridge.external_timeout_s=7", "--out", bag, "--scenario", graph.scenario())
    done = graph.launch("--ego", "autoware", "--policy", "replay", *options, "--", "sleep", 100)
    assert done.returncode == 1
    assert "waiting for service /api/routing/set_route_points" in done.stderr


def values_of(bag: Path, name: str) -> list[dict[str, str]]:
    """The values of the statuses of a name on /diagnostics."""
    messages = BagReader(bag).messages(["/diagnostics"])
    arrays = [deserialize_message(message.data, DiagnosticArray) for message in messages]
    statuses = [status for array in arrays for status in array.status if status.name == name]
    return [{pair.key: pair.value for pair in status.values} for status in statuses]
