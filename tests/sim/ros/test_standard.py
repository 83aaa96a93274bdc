"""The scene in standard types, and answers in standard types, each read back by their definitions."""

import struct

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from litsim_msgs.msg import EgoControl
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker

from litsim_sim.core.scene import AgentTable, EgoCommand, EgoMode
from litsim_sim.core.topic_names import Interface
from litsim_sim.ego_port.tracking import Trajectory, TwistTarget
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.ros import ego_port, messages, standard
from litsim_sim.scenario.scenario import packaged
from litsim_sim.scenario.signals import Signals

CODES = {2: "B", 6: "I", 7: "f", 8: "d"}  # of sensor_msgs/PointField


def table(ids: list[int]) -> AgentTable:
    rng = np.random.default_rng(3)
    n = len(ids)
    floats = [rng.uniform(0.5, 20.0, n) for _ in range(8)]
    return AgentTable(12, np.array(ids, np.int64), np.arange(n, dtype=np.uint8), np.zeros(n, np.uint8), *floats)


def test_objects_are_read_field_by_field() -> None:
    agents = table([3, 7, 2**31 + 5, 2**32 + 9])
    cloud = standard.objects(agents, ego_id=7)
    assert (cloud.header.frame_id, messages.stamp(12)) == ("map", cloud.header.stamp)
    assert (cloud.height, cloud.width, cloud.is_bigendian, cloud.row_step) == (1, 3, False, 3 * cloud.point_step)
    assert len(cloud.data) == cloud.row_step
    names = [field.name for field in cloud.fields]
    assert {"id", "x", "y", "z", "yaw", "speed", "vx", "vy", "length", "width", "kind", "x64", "y64"} == set(names)
    for point, row in enumerate([0, 2, 3]):
        read = {
            f.name: struct.unpack_from("<" + CODES[f.datatype], bytes(cloud.data), point * cloud.point_step + f.offset)[
                0
            ]
            for f in cloud.fields
        }
        assert read["id"] == agents.id[row] % 2**32
        assert read["kind"] == agents.kind[row]
        for name in ("x", "y", "yaw", "speed", "length", "width"):
            assert read[name] == pytest.approx(getattr(agents, name)[row], rel=1e-6)
        along = agents.speed[row] * np.exp(1j * agents.yaw[row])
        assert complex(read["vx"], read["vy"]) == pytest.approx(along, rel=1e-5)
        assert read["z"] == 0.0
        assert (read["x64"], read["y64"]) == (agents.x[row], agents.y[row])


@pytest.mark.parametrize("ids", [[], [7]])
def test_no_objects(ids: list[int]) -> None:
    cloud = standard.objects(table(ids), ego_id=7)
    assert (cloud.width, len(cloud.data)) == (0, 0)


@pytest.mark.parametrize(
    ("north", "said"), [(0.0, ""), (1e5, ""), (4.1e6, "4100020 m, where x and y are rounded to 0.25 m")]
)
def test_that_positions_are_too_far_for_single_precision_is_said(north: float, said: str) -> None:
    agents = table([3, 7])
    agents.y[:] = north + 20.0
    assert said in (text := standard.rounding(agents))
    assert bool(text) == bool(said)


def test_lanes_are_centre_lines_with_a_boundary_half_a_width_to_each_side() -> None:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    markers = standard.lanes(lane_map).markers
    keys = {(m.ns, m.id): m for m in markers}
    assert len(keys) == len(markers) == 3 * len(lane_map.lanes)
    for row, lane in enumerate(lane_map.lanes):
        lines = [keys["centre", row], keys["boundary", 2 * row], keys["boundary", 2 * row + 1]]
        assert all(
            (m.type, m.action, m.text, m.header.frame_id) == (Marker.LINE_STRIP, 0, lane.id, "map") for m in lines
        )
        centre, left, right = (np.array([(p.x, p.y) for p in m.points]) for m in lines)
        assert centre == pytest.approx(lane.centerline)
        for border, side in ((left, 0.5), (right, -0.5)):
            middle = 0.5 * (border[:-1] + border[1:])
            step = np.diff(lane.centerline, axis=0) / np.hypot(*np.diff(lane.centerline, axis=0).T)[:, None]
            away = middle - lane.centerline[:-1]
            across = step[:, 0] * away[:, 1] - step[:, 1] * away[:, 0]
            assert across == pytest.approx(side * lane.width, abs=0.05)


def test_answers_of_every_type() -> None:
    control = messages.ego_to_message(EgoCommand(9, -1.0, 0.1, EgoMode.CONTROL), "run")
    answer = ego_port.from_control(control)
    assert (answer.interface, answer.step, answer.run_id) == (Interface.CONTROL, 9, "run")
    assert answer.target == EgoCommand(9, -1.0, 0.1)
    unknown = ego_port.from_control(EgoControl(mode=7))
    assert (unknown.target, unknown.fault) == (None, "mode is 7, expected 0 (CONTROL) or 1 (FOLLOW_LOG)")

    twist = TwistStamped(header=messages.header(9))
    twist.twist.linear.x, twist.twist.angular.z = 11.0, 0.2
    answer = ego_port.from_twist(twist)
    assert (answer.target, answer.stamp_ns, answer.frame) == (TwistTarget(11.0, 0.2), 900_000_000, "map")

    path = Path(header=messages.header(9))
    for step in (10, 11):
        pose = PoseStamped(header=messages.header(step))
        pose.pose.position.x, pose.pose.position.y = 1.0 * step, -2.0 * step
        path.poses.append(pose)
    answer = ego_port.from_path(path)
    assert (answer.stamp_ns, answer.frame) == (900_000_000, "map")
    assert isinstance(answer.target, Trajectory)
    assert answer.target.time == pytest.approx([1.0, 1.1])
    assert (answer.target.x.tolist(), answer.target.y.tolist()) == ([10.0, 11.0], [-20.0, -22.0])
    path.poses[1].header.frame_id = "odom"
    assert ego_port.from_path(path).frame == "odom"
    path.poses[1].header.frame_id = ""
    assert ego_port.from_path(path).frame == "map"
    assert len(ego_port.from_path(Path()).target.time) == 0  # type: ignore[union-attr]


def test_lights_are_read_field_by_field_and_drawn_as_stop_lines() -> None:
    net = packaged("nets/urban_like.net.xml")
    lane_map, links = LaneMap.from_net(net), read_links(net)
    group = np.arange(len(links)) % 2
    signals = Signals(("a", "b"), links, group, np.array([[3, 6], [8, 8]], np.uint8))
    cloud = standard.Lights(signals, lane_map).cloud(1)
    assert (cloud.width, cloud.header.stamp) == (len(links), messages.stamp(1))
    layout = {f.name: ("<" + CODES[f.datatype], f.offset) for f in cloud.fields}
    lights = np.frombuffer(cloud.data, layout)  # as the examples read it
    names = [lane.id for lane in lane_map.lanes]
    markers = standard.light_markers(1, signals).markers
    for row, (light, marker, link) in enumerate(zip(lights, markers, links, strict=True)):
        assert light["state"] == (6, 8)[row % 2]
        assert (names[light["lane"]], names[light["to_lane"]]) == (link.from_lane, link.to_lane)
        assert (light["x64"], light["y64"]) == pytest.approx(link.stop)
        assert (light["exit_x64"], light["exit_y64"]) == pytest.approx(link.exit)
        assert (light["yaw"], light["width"]) == pytest.approx((link.heading, link.width))
        assert marker.text == f"{link.name} {('GREEN', 'AMBER')[row % 2]}" and marker.type == Marker.LINE_STRIP
        ends = np.array([(p.x, p.y) for p in marker.points])
        away = np.abs((ends - link.stop) @ [np.cos(link.heading), np.sin(link.heading)])
        assert away == pytest.approx(0.0, abs=1e-6) and np.hypot(*np.diff(ends, axis=0)[0]) <= link.width
    assert (markers[0].color.g, markers[1].color.g) == pytest.approx((0.8, 0.7))


def test_without_signals_the_cloud_of_lights_is_empty() -> None:
    cloud = standard.Lights(None, LaneMap.from_net(packaged("nets/us101_like.net.xml"))).cloud(4)
    assert (cloud.width, len(cloud.data), len(cloud.fields)) == (0, 0, 12)
    assert len(np.frombuffer(cloud.data, {f.name: ("<" + CODES[f.datatype], f.offset) for f in cloud.fields})) == 0
    assert standard.light_markers(4, None).markers == []
