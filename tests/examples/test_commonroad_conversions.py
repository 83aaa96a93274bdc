"""The example's conversions read what the bridge publishes and write what the port accepts; no planner is needed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.topic_names import Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import problem
from litsim_sim.ego_port.tracking import EgoState, Reference
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.ros import lane_clouds, messages, standard
from litsim_sim.ros.ego_port import from_path
from litsim_sim.scenario.mission import Mission
from litsim_sim.scenario.scenario import packaged
from programs import program

conversions = program("examples/commonroad_planner/conversions.py")


def test_objects_and_ego(agent_table: Callable[..., Any]) -> None:
    table = agent_table(
        7,
        {"id": 1, "x": 100.0, "y": -5.0, "yaw": 0.5, "speed": 12.0, "yaw_rate": 0.1},
        {"id": 2, "x": 120.0, "y": -1.5, "yaw": -0.25, "speed": 8.0, "length": 9.0, "width": 2.5, "kind": 1},
    )
    (other,) = conversions.objects_of(standard.objects(table, ego_id=1))
    assert (other["id"], other["kind"]) == (2, 1)
    assert [other[name] for name in ("x", "y", "yaw", "length", "width")] == pytest.approx([120, -1.5, -0.25, 9, 2.5])
    assert (other["vx"], other["vy"]) == pytest.approx((8.0 * np.cos(-0.25), 8.0 * np.sin(-0.25)))
    ego = conversions.ego_of(messages.ego_odometry(table, 1, 0.29))
    assert (ego.x, ego.y, ego.yaw, ego.speed, ego.yaw_rate) == pytest.approx((100.0, -5.0, 0.5, 12.0, 0.1))


def test_an_empty_road_has_no_objects(agent_table: Callable[..., Any]) -> None:
    assert len(conversions.objects_of(standard.objects(agent_table(0, {"id": 1}), ego_id=1))) == 0


def test_prediction_is_at_constant_velocity(agent_table: Callable[..., Any]) -> None:
    table = agent_table(0, {"id": 1}, {"id": 2, "x": 30.0, "y": 2.0, "yaw": np.pi / 2, "speed": 4.0})
    objects = conversions.objects_of(standard.objects(table, ego_id=1))
    assert conversions.predicted(objects, np.array([0.0, 0.5, 2.0]))[0] == pytest.approx(
        np.array([[30.0, 2.0], [30.0, 4.0], [30.0, 10.0]]), abs=1e-5
    )
    ego = conversions.Ego(30.0, 0.0, np.pi / 2, 5.0, 0.0)
    ahead, left = conversions.ahead_and_left(objects, ego)
    assert (ahead[0], left[0]) == pytest.approx((2.0, 0.0), abs=1e-5)


def test_lanes_have_their_borders_on_either_side() -> None:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    lanes = conversions.lanes_of(standard.lanes(lane_map))
    assert len(lanes) == len(lane_map.lanes)
    for (left, centre, right), lane in zip(lanes, lane_map.lanes, strict=True):
        assert centre == pytest.approx(lane.centerline)
        assert len(left) == len(centre) == len(right)
        along = centre[1] - centre[0]
        for border, sign in ((left, 1.0), (right, -1.0)):
            across = border[0] - centre[0]
            assert np.sign(along[0] * across[1] - along[1] * across[0]) == sign
            assert np.hypot(*across) == pytest.approx(0.5 * lane.width, rel=1e-6)


def test_a_line_is_lengthened_at_both_ends() -> None:
    line = np.array([[0.0, 0.0], [0.0, 0.0], [10.0, 0.0], [10.0, 5.0]])
    longer = conversions.lengthened(line, 3.0, 4.0)
    assert longer == pytest.approx(np.array([[-3.0, 0.0], [0.0, 0.0], [10.0, 0.0], [10.0, 5.0], [10.0, 9.0]]))


def test_a_line_is_sampled_evenly_from_end_to_end() -> None:
    line = np.array([[0.0, 0.0], [0.1, 0.0], [6.0, 0.0], [6.0, 3.0]])
    points = conversions.sampled(line, 2.0)
    assert points == pytest.approx(np.array([[0.0, 0.0], [1.8, 0.0], [3.6, 0.0], [5.4, 0.0], [6.0, 1.2], [6.0, 3.0]]))


def test_braking_stops_beside_the_line() -> None:
    ego = conversions.Ego(2.0, 0.5, 0.0, 6.0, 0.0)
    points = conversions.braking(np.array([[0.0, 0.0], [5.0, 0.0]]), ego, 6.0, 31)
    assert points[0] == pytest.approx((2.0, 0.5))
    assert points[10:] == pytest.approx(np.tile([5.0, 0.5], (21, 1)))  # v^2 / 2a = 3 m, within a second
    speed = np.diff(points[:, 0]) / 0.1
    assert np.diff(speed[:10]) == pytest.approx(np.full(9, -0.6))


def test_the_port_accepts_what_is_written() -> None:
    ego = EgoState(1.2, 50.0, -3.0, 0.0, 10.0, 4.5)
    points = np.stack([50.0 + np.arange(31), np.full(31, -3.0)], axis=1)
    answer = from_path(conversions.path_message(1_200_000_000, points))
    assert (answer.interface, answer.stamp_ns, problem(answer)) == (Interface.TRAJECTORY, 1_200_000_000, "")
    assert answer.target is not None
    assert answer.target.time == pytest.approx(1.2 + 0.1 * np.arange(31))
    assert Reference(answer.target, ego).problem(ego, VehicleModel()) == ""
    assert conversions.line_of(conversions.path_message(0, points)) == pytest.approx(points)


def test_the_lowest_limit_of_the_route() -> None:
    lane_map = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
    nowhere = np.full(len(lane_map.lanes), np.nan)
    for limit in sorted(set(lane_map.speed_limits.tolist())):
        mission = Mission(np.zeros((2, 2)), np.zeros(3), lane_map.speed_limits >= limit, nowhere)
        assert conversions.limit_of(lane_clouds.lane_table(lane_map, mission)) == pytest.approx(limit)
