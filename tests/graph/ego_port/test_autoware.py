"""Autoware through its adapter: a stand-in that knows only Autoware's topics and services drives, twice the same."""

import json
import sys
from collections import Counter
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from litsim_msgs.msg import JointForecast
from rclpy.serialization import deserialize_message

from litsim_data.generic.resampling import PIECE
from litsim_sim.core.topic_names import FORECASTS
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run
from litsim_sim.scenario.load import load_recording

STAND_IN = Path(__file__).parents[1] / "programs/stand_in_autoware.py"
PLANNED = "/planning/trajectory"
OBJECTS = "/perception/object_recognition/objects"
BAG_TOPICS = (
    "/perception/object_recognition/tracking/objects",
    "/localization/kinematic_state",
    "/localization/acceleration",
    "/tf",
    "/tf_static",
)
NEEDED = (
    "autoware_adapi_v1_msgs",
    "autoware_control_msgs",
    "autoware_perception_msgs",
    "autoware_planning_msgs",
    "tf2_msgs",
)
if all(find_spec(name) for name in NEEDED):
    from autoware_perception_msgs.msg import PredictedObjects
    from tf2_msgs.msg import TFMessage
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
    """Planner and controller are two processes: which trajectory a command follows must not depend on their speed."""
    digests = []
    for name in ("first", "second"):
        done, metrics = drive(graph, name, "--record", OBJECTS, stack=("--apart",), policy="litsim")
        assert done.returncode == 0, done.stderr + (graph.folder / name / "log/ads.log").read_text()
        port = metrics["lockstep"]["ego_port"]
        assert (metrics["lockstep"]["missed"], port["interface"], port["answered"]) == (0, "control", 36)
        assert metrics["collision"]["ego_at_fault"] == 0
        digests.append(metrics["digest"])
    assert digests[0] == digests[1]
    assert metrics["minimum_risk_s"] == 0.0
    check_paths(graph.folder / "second")
    reports = values_of(graph.folder / "second", "litsim: autoware")
    assert {values["gear"] for values in reports} == {"2"}
    assert {values["mrm_state"] for values in reports} >= {"1"}  # normal
    assert {"1", "2"} & {values["turn_indicators"] for values in reports}
    planned = Counter(m.log_time_ns // 10**8 for m in BagReader(graph.folder / "second").messages([PLANNED]))
    assert sorted(planned)[-10:] == list(range(26, 36))  # raw, as the stack has planned
    assert not list(BagReader(graph.folder / "second").messages(["/clock"]))  # that of the stack has a time of its own


@with_types
@pytest.mark.parametrize(
    ("ego", "mode", "stack"),
    [
        ("autoware_universe", "lockstep", ("--universe", "--sim-time")),
        ("autoware", "realtime", ()),
    ],
)
def test_universe_and_real_time(graph: Any, ego: str, mode: str, stack: tuple[str, ...]) -> None:
    done, metrics = drive(graph, "run", "--mode", mode, "--record", *BAG_TOPICS, ego=ego, stack=stack)
    if mode == "lockstep":  # on a busy machine, answers may be late in real time
        check_bag(graph.folder / "run")
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
    scenario = graph.scenario(goal=[120.0, -5.5, 0.0])
    setup = ("--scenario", scenario, "--policy", "replay", "--out", bag, "--set", "bridge.clock=false")
    program = Path(get_package_prefix("litsim_autoware")) / "lib/litsim_autoware/autoware"
    adapter = (program, "--answers", "trajectory")
    done = graph.launch("--ego", "external", *setup, "--", *adapter, "--", sys.executable, STAND_IN)
    assert done.returncode == 0, done.stderr + (bag / "log/ads.log").read_text()
    port = json.loads((bag / "metrics.json").read_text())["lockstep"]["ego_port"]
    assert (port["interface"], port["answered"], port["invalid"]) == ("trajectory", 36, 0)
    run = read_run(bag)
    speed = [float(table.speed[table.row(run.info.ego_id)]) for table in run.tables]
    assert min(speed) > 5.0 and max(abs(a - b) for a, b in pairwise(speed)) < 0.9


@with_types
def test_a_stack_that_is_slow_and_comes_late_drives(graph: Any) -> None:
    done, metrics = drive(graph, "run", stack=("--late", "3", "--slow", "0.15"))
    assert done.returncode == 0, done.stderr + (graph.folder / "run/log/ads.log").read_text()
    assert (metrics["lockstep"]["missed"], metrics["lockstep"]["ego_port"]["answered"]) == (0, 36)


@with_types
def test_a_stack_that_starts_anew_and_has_lost_its_route_ends_the_run(graph: Any) -> None:
    done, _ = drive(graph, "run", "--answer-timeout", "4", stack=("--restart-after", "20"))
    assert done.returncode == 1
    assert "missed" not in done.stdout
    assert "the external ego (/litsim_autoware" in done.stderr


@with_types
def test_what_is_waited_for_is_told(graph: Any) -> None:
    bag = graph.folder / "run"
    options = ("--set", "bridge.external_timeout_s=7", "--out", bag, "--scenario", graph.scenario())
    done = graph.launch("--ego", "autoware", "--policy", "replay", *options, "--", "sleep", 100)
    assert done.returncode == 1
    assert "waiting for service /api/routing/set_route_points" in done.stderr


def check_paths(bag: Path) -> None:
    """Checks that the predicted paths of a step are of the predictor's forecast of the step before."""
    reader = BagReader(bag)
    forecasts = [deserialize_message(message.data, JointForecast) for message in reader.messages([FORECASTS])]
    by_step = {message.step: message for message in forecasts}
    messages = [deserialize_message(message.data, PredictedObjects) for message in reader.messages([OBJECTS])]
    stamps = [round(message.header.stamp.sec * 10 + message.header.stamp.nanosec * 1e-8) for message in messages]
    compared = 0
    for message, stamp in zip(messages, stamps, strict=True):
        step = max(by_step) - max(stamps) + stamp
        if step < 20 or step - 1 not in by_step:
            continue
        objects, forecast = message.objects, by_step[step - 1]
        mean = np.asarray(forecast.mean).reshape(len(forecast.id), -1, 2)
        for each in objects:
            agent = int.from_bytes(bytes(each.object_id.uuid[8:]), "little")
            if agent in forecast.id and forecast.valid[row := list(forecast.id).index(agent)]:
                (path,) = each.kinematics.predicted_paths
                place = path.path[4].position  # 2 s ahead: 2.1 s after the step before
                between = mean[row, [9, 10]].mean(axis=0) if forecast.dt == 0.2 else mean[row, 20]
                assert [place.x, place.y] == pytest.approx(between)
                compared += 1
    assert compared > 5


def check_bag(bag: Path) -> None:
    """Checks the ego's frames in a record, and that the recording made of Autoware's topics in it equals the run."""
    run = read_run(bag)
    messages = {topic: list(BagReader(bag).messages([topic])) for topic in ("/tf", "/tf_static")}
    fixed = deserialize_message(messages["/tf_static"][0].data, TFMessage).transforms
    (moving,) = deserialize_message(messages["/tf"][-1].data, TFMessage).transforms
    chain = {each.child_frame_id: (each.header.frame_id, each.transform.translation.x) for each in (*fixed, moving)}
    lever = 0.29 * 4.5
    last = run.tables[-1]
    ego = last.row(run.info.ego_id)
    assert chain == {
        "odom": ("map", 0.0),
        "base_link": ("odom", pytest.approx(last.x[ego] - lever * np.cos(last.yaw[ego]))),
        "ego": ("base_link", pytest.approx(lever)),
    }
    sizes = {"wheel_base": 0.58 * 4.5, "front_overhang": 0.21 * 4.5, "rear_overhang": 0.21 * 4.5, "wheel_tread": 2.0}
    sizes |= {"left_overhang": 0.0, "right_overhang": 0.0}
    (bag / "vehicle_info.param.yaml").write_text(json.dumps({"/**": {"ros__parameters": sizes}}))
    recording = load_recording(bag / "metadata.yaml")
    tracks = recording.table.assign(
        vehicle_id=recording.table["vehicle_id"] % PIECE
    )  # a hole before the run splits them
    steps = tracks.set_index(["frame", "vehicle_id"])
    end = int(recording.table["frame"].max())
    ids = {run.info.ego_id: recording.header.notes["ego"] % PIECE}
    for table in run.tables[1:]:  # of step 0 the record has the first 20 messages only, all from before the run
        found = steps.loc[end - last.step + table.step].loc[[ids.get(agent, agent) for agent in table.id.tolist()]]
        for name in ("x", "y", "yaw", "speed", "length", "width", "kind"):
            assert found[name].to_numpy() == pytest.approx(getattr(table, name), abs=1e-6), (table.step, name)


def values_of(bag: Path, name: str) -> list[dict[str, str]]:
    """The values of the statuses of a name on /diagnostics."""
    messages = BagReader(bag).messages(["/diagnostics"])
    arrays = [deserialize_message(message.data, DiagnosticArray) for message in messages]
    statuses = [status for array in arrays for status in array.status if status.name == name]
    return [{pair.key: pair.value for pair in status.values} for status in statuses]
