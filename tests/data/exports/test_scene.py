"""The record as a scene: a reader that knows nothing of LitSim finds frames, boxes, objects and lights in it."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from command_line import refusal
from litsim_data.cli import main
from litsim_data.exports.reading import opened
from litsim_data.exports.scene import Scene
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.record.run import read_run
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals

NET = packaged("nets/urban_like.net.xml")
DELETE_ALL = 3


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Log times in steps and messages by topic, by the field's own decoder."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for each in reader.iter_decoded_messages(log_time_order=False):
            found[each.channel.topic].append((each.message.log_time // 100_000_000, each.decoded_message))
    return found


@pytest.fixture
def bag(
    tmp_path: Path, table: Callable[..., Any], make_run: Callable[..., Any], write_run: Callable[..., Path]
) -> Path:
    """The ego heads north, a truck that is taken over stands, and a car is there for two of three steps."""
    tables = [
        table(
            k,
            {"id": 1, "x": 5.0, "y": 10.0 + k, "yaw": 0.5 * np.pi, "controller": Controller.EGO},
            {"id": 2, "x": 40.0, "y": -2.0, "kind": Kind.TRUCK, "controller": Controller.POLICY, "length": 11.0},
            *([{"id": 3, "x": 60.0 + k, "y": -2.0}] if k < 2 else []),
        )
        for k in range(3)
    ]
    return write_run(make_run(tables, net_xml=NET.read_bytes()), tmp_path / "bag")


def test_boxes_frames_and_objects_of_every_step(bag: Path, tmp_path: Path, capsys: Any) -> None:
    main(["export", str(bag), str(tmp_path / "scene.mcap")])
    told = capsys.readouterr().out
    assert "scene.mcap: 10 messages on /tf_static, /tf, /litsim/objects, /litsim/markers/agents" in told
    found = decoded(tmp_path / "scene.mcap")
    assert [step for step, _ in found["/litsim/markers/agents"]] == [0, 1, 2]
    boxes = [message.markers for _, message in found["/litsim/markers/agents"]]
    assert [len(each) for each in boxes] == [4, 4, 3] and {each[0].action for each in boxes} == {DELETE_ALL}
    ego, truck = boxes[1][1:3]
    assert (ego.header.frame_id, ego.pose.position.x, ego.pose.position.y) == ("map", 5.0, 11.0)
    assert ego.pose.orientation.z == pytest.approx(np.sqrt(0.5))
    assert (ego.scale.x, ego.scale.y, ego.text) == (4.0, 2.0, "1") and ego.color.r > 0.8 > ego.color.g
    assert (truck.scale.x, truck.scale.z) == (11.0, 3.2) and truck.color.g > 0.6 > truck.color.r
    step, last = found["/tf"][-1]
    (frame,) = last.transforms
    assert (step, frame.header.frame_id, frame.child_frame_id) == (2, "odom", "base_link")
    rear = frame.transform.translation
    assert (rear.x, rear.y) == pytest.approx((5.0, 12.0 - 0.29 * 4.0)), "the middle of the rear axle"
    assert found["/tf_static"][0][1].transforms[0].child_frame_id == "odom"
    clouds = [message for _, message in found["/litsim/objects"]]
    layout = {field.name: (" bBhHiIfd"[field.datatype], field.offset) for field in clouds[0].fields}
    points = [np.frombuffer(cloud.data, layout) for cloud in clouds]
    assert [each["id"].tolist() for each in points] == [[2, 3], [2, 3], [2]], "the ego is no object"
    assert points[1]["x"].tolist() == [40.0, 61.0] and points[1]["kind"].tolist() == [1, 0]


def test_the_record_is_still_that_of_the_run(bag: Path, tmp_path: Path) -> None:
    main(["export", str(bag), str(tmp_path / "scene.mcap")])
    run, scene = read_run(bag), read_run(tmp_path / "scene.mcap")
    assert scene.info == run.info and scene.net_xml == run.net_xml and len(scene.tables) == len(run.tables)
    assert all(np.array_equal(a.x, b.x) for a, b in zip(run.tables, scene.tables, strict=True))


def test_stop_lines_in_the_colour_that_is_shown(bag: Path, tmp_path: Path) -> None:
    links = read_links(NET)
    shown = np.full((1, 3), int(SignalState.RED), np.uint8)
    shown[0, 2] = int(SignalState.GREEN)
    signals = Signals(("all",), links, np.zeros(len(links), np.int64), shown)
    with opened(bag) as content:
        Scene().write(replace(content, signals=signals), tmp_path / "scene.mcap")
    lines = [message.markers[1:] for _, message in decoded(tmp_path / "scene.mcap")["/litsim/lights/markers"]]
    assert [len(each) for each in lines] == [len(links)] * 3
    assert lines[0][0].color.r > 0.8 > lines[0][0].color.g and lines[2][0].color.g > 0.7 > lines[2][0].color.r
    assert len(lines[0][0].points) == 2 and lines[0][0].text.endswith(" RED")


def test_a_scenario_has_no_record(tmp_path: Path, capsys: Any) -> None:
    assert "expected a run: the scene is added to its record" in refusal(
        capsys, main, "export", "demo", tmp_path / "scene.mcap"
    )
