"""A recorded run is an ordinary rosbag2 bag, whole or cut short."""

import json
import resource
import signal
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.stages import StageState
from litsim_sim.record.bag import BagReader, find_mcap
from litsim_sim.record.run import read_run
from litsim_sim.scenario.mission import ego_mission
from litsim_sim.scenario.scenario import Scenario

STEP_NS = 100_000_000
BY_STEP_FIELD = ("/litsim/agents", "/litsim/forecasts", "/litsim/takeovers", "/litsim/controls", "/litsim/ego/control")
BY_STAMP = ("/clock", "/litsim/ego/state")
EVERY_STEP = list(range(36))
LATCHED = ("run_info", "ego/route", "ego/goal", "lanes", "lanes/table", "lanes/links", "signals/map")


def step_of(topic: str, message: Any) -> int:
    if topic in BY_STEP_FIELD:
        return int(message.step)
    stamp = message.clock if topic == "/clock" else message.header.stamp
    return round((stamp.sec * 10**9 + stamp.nanosec) / STEP_NS)


def test_mcap_ros2_support_reads_every_step_once_and_in_order(recorded: Any) -> None:
    run = recorded("idm", "litsim")
    steps, decoded = defaultdict(list), {}
    with find_mcap(run.bag).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages(log_time_order=False):
            topic, message = found.channel.topic, found.decoded_message
            decoded[topic] = message
            if topic in BY_STEP_FIELD + BY_STAMP:
                steps[topic].append(step_of(topic, message))
                assert found.message.log_time == steps[topic][-1] * STEP_NS
    assert steps == dict.fromkeys(BY_STEP_FIELD + BY_STAMP, EVERY_STEP)
    assert {"/litsim/run_info", "/litsim/status", "/litsim/ego/route", "/litsim/timing"} <= decoded.keys()
    agents = decoded["/litsim/agents"]
    assert len(agents.id) == len(agents.x) == len(agents.controller) == 40
    assert sorted(agents.id) == list(agents.id)
    mission, again = read_run(run.bag).mission, ego_mission(Scenario.load(run.scenario))
    assert mission is not None and len(decoded["/litsim/ego/route"].poses) == len(mission.route) > 1
    assert mission.goal == pytest.approx(again.goal) and mission.route == pytest.approx(again.route)
    assert mission.on_route.tolist() == again.on_route.tolist() and any(mission.on_route)
    assert mission.entered == pytest.approx(again.entered, nan_ok=True)
    assert json.loads((run.bag / "metrics.json").read_text())["mission"]["off_route_m"] == 0.0
    assert list(decoded["/litsim/run_info"].topics) == [
        *("/clock", "/litsim/agents", "/litsim/ego/state", "/litsim/forecasts", "/litsim/takeovers"),
        *("/litsim/controls", "/litsim/ego/control"),
    ]


def test_rosbags_reads_the_folder(recorded: Any) -> None:
    run = recorded("idm", "litsim")
    steps = defaultdict(list)
    with AnyReader([run.bag]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            again = bytes(reader.typestore.serialize_cdr(message, connection.msgtype))
            assert again.ljust(-4 * (-len(again) // 4), b"\0") == raw  # the writers' memory is not in the padding
            if connection.topic in BY_STEP_FIELD + BY_STAMP:
                steps[connection.topic].append(step_of(connection.topic, message))
        types = {connection.topic: connection.msgtype for connection in reader.connections}
    assert steps == dict.fromkeys(BY_STEP_FIELD + BY_STAMP, EVERY_STEP)
    assert types["/clock"] == "rosgraph_msgs/msg/Clock"
    assert types["/litsim/agents"] == "litsim_msgs/msg/AgentStates"
    assert types["/litsim/ego/state"] == "nav_msgs/msg/Odometry"


def test_the_metadata_tell_the_qos_and_the_type_of_every_topic(recorded: Any) -> None:
    run = recorded("idm", "litsim")
    information = yaml.safe_load((run.bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["duration"] == {"nanoseconds": 35 * STEP_NS}
    topics = {t["topic_metadata"]["name"]: t for t in information["topics_with_message_count"]}
    assert {name: topics[name]["message_count"] for name in BY_STEP_FIELD} == dict.fromkeys(BY_STEP_FIELD, 36)
    with find_mcap(run.bag).open("rb") as stream:
        channels = {c.topic: c for c in make_reader(stream).get_summary().channels.values()}
    for name, topic in topics.items():
        (offered,) = yaml.safe_load(channels[name].metadata["offered_qos_profiles"])
        assert offered["reliability"] == "reliable"
        latched = name.removeprefix("/litsim/") in LATCHED
        assert offered["durability"] == ("transient_local" if latched else "volatile")
        assert topic["topic_metadata"]["offered_qos_profiles"] == [offered]
        assert channels[name].metadata["topic_type_hash"] == topic["topic_metadata"]["type_description_hash"]
        assert channels[name].metadata["topic_type_hash"].startswith("RIHS01_")


def test_attachments_are_enough_to_run_it_again(recorded: Any, tmp_path: Path) -> None:
    run = recorded("idm", "litsim")
    reader = BagReader(run.bag)
    assert reader.attachments.keys() == {"scenario.yaml", "net.xml", "recording.parquet"}
    for name, data in reader.attachments.items():
        (tmp_path / name).write_bytes(data)
    fields = yaml.safe_load((tmp_path / "scenario.yaml").read_text())
    fields |= {"recording": "recording.parquet", "net": "net.xml"}
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(fields))
    again, original = Scenario.load(tmp_path / "scenario.yaml"), Scenario.load(run.scenario)
    assert again.recording.parquet == original.recording.parquet
    assert {"run_id", "seed", "ego", "versions", "configuration"} <= reader.metadata.keys()
    assert yaml.safe_load(reader.metadata["versions"]).keys() >= {"commit", "python", "numpy", "libsumo"}


def test_every_stage_tells_its_parameters(recorded: Any) -> None:
    run = read_run(recorded("idm", "litsim").bag)
    told = {status.stage: status.text for status in run.statuses if status.state == StageState.READY}
    assert told.keys() == set(run.info.stages)
    assert all(yaml.safe_load(told[stage]) for stage in ("predictor", "conflict", "policy", "ego"))


def test_killed_recorder_is_named_and_leaves_whole_chunks(graph: Any) -> None:
    bag = graph.folder / "run"
    launcher = graph.start_launch("--mode", "realtime", "--scenario", graph.scenario(simulation_s=24.0), "--out", bag)
    graph.wait_under_way(bag)
    graph.signal("recorder", signal.SIGKILL)
    done = graph.finish(launcher)
    assert done.returncode == 1
    assert f"error: node recorder was ended by {signal.SIGKILL.name}" in done.stderr
    assert "Traceback" not in done.stderr
    assert not graph.running()
    run = read_run(bag)
    assert not run.complete
    assert "cut short" in run.problem
    last = run.tables[-1].step
    assert 9 <= last < run.info.total_steps
    assert [table.step for table in run.tables] == list(range(last + 1))
    assert set(run.controls) == set(run.ego_commands) == set(range(last + 1))


def test_a_gap_fails_the_run(graph: Any) -> None:
    recorder = graph.start_script("deaf_recorder.py", "--ros-args", "-p", f"output:={graph.folder / 'run'}")
    graph.start_node("litsim_policy", "ego")
    arguments = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **arguments))
    done = graph.finish(recorder)
    gap = "/litsim/ego/state lacks 1 steps (7)"
    assert (bridge.returncode, done.returncode) == (1, 1), bridge.stderr + done.stderr
    assert f"error: recorder: {gap}" in bridge.stderr
    assert done.stderr.splitlines()[-1] == f"error: the recording has gaps: {gap}"
    run = read_run(graph.folder / "run")
    assert {topic: gaps.missing for topic, gaps in run.gaps.items() if gaps} == {"/litsim/ego/state": (7,)}
    assert "/litsim/ego/state: 1 steps missing (first 7)" in compute_metrics(run)["why"]


def test_full_disk_ends_the_run_with_the_name_of_the_file(graph: Any) -> None:
    recorder = graph.start_node("litsim_sim", "recorder", output=graph.folder / "run")
    resource.prlimit(recorder.pid, resource.RLIMIT_FSIZE, (40_000, 40_000))  # not enough for the run
    graph.start_node("litsim_policy", "ego")
    arguments = {"scenario": graph.scenario(), "policy": "replay", "progress": "none"}
    bridge = graph.finish(graph.start_node("litsim_sim", "bridge", **arguments))
    error = f"{graph.folder}/run/run_0.mcap: cannot write the recording: File too large"
    assert bridge.returncode == 1
    assert f"error: recorder: {error}" in bridge.stderr
    done = graph.finish(recorder)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == f"error: {error}"
    assert "Traceback" not in bridge.stderr + done.stderr
