"""Markers of scenes made by hand."""

from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Pose2D
from litsim_msgs.msg import JointForecast, Takeover, Takeovers
from rclpy.serialization import deserialize_message, serialize_message
from visualization_msgs.msg import Marker, MarkerArray

from litsim_sim.core.colours import COLOURS, Mode
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.ros.markers import POINTS_MAX, AgentLayer, ConflictLayer, ForecastLayer, modes_off_log

Make = Callable[..., Any]
BIG = 2**40  # an id that no marker can have


def by_key(markers: MarkerArray) -> dict[tuple[str, int], Marker]:
    """As a viewer gets them; ids are unique within a namespace."""
    received = deserialize_message(serialize_message(markers), MarkerArray).markers
    found = {(each.ns, each.id): each for each in received}
    assert len(found) == len(received)
    assert all(each.header.frame_id == "map" for each in received)
    assert all((each.lifetime.sec, each.lifetime.nanosec) == (0, 0) for each in received)
    return found


def of(markers: MarkerArray, namespace: str, action: int = Marker.ADD) -> list[Marker]:
    return [m for (ns, _), m in sorted(by_key(markers).items()) if ns == namespace and m.action == action]


def colour(marker: Marker) -> str:
    return "#" + "".join(f"{round(255 * getattr(marker.color, each)):02x}" for each in "rgb")


def test_agents_are_oriented_boxes_with_their_speed(agent_table: Make) -> None:
    rows = [
        {"id": 1, "controller": Controller.EGO, "x": 3.0, "y": 4.0, "yaw": np.pi / 2, "speed": 12.34},
        {"id": 2, "controller": Controller.POLICY},
        {"id": 3, "controller": Controller.POLICY},
        {"id": 4, "controller": Controller.LOG, "length": 12.0, "width": 2.5},
        {"id": BIG},
    ]
    markers = AgentLayer().draw(agent_table(25, *rows), {2: Mode.OWN_INTENT, 3: Mode.HANDBACK, 4: Mode.HANDBACK})
    boxes, labels = of(markers, "agents"), of(markers, "speed")
    modes = (Mode.EGO, Mode.OWN_INTENT, Mode.HANDBACK, Mode.LOG, Mode.LOG)
    assert [colour(box) for box in boxes] == [COLOURS[mode][0] for mode in modes]
    ego = boxes[0]
    assert (ego.type, ego.header.stamp.sec, ego.header.stamp.nanosec) == (Marker.CUBE, 2, 500_000_000)
    assert (ego.pose.position.x, ego.pose.position.y) == (3.0, 4.0)
    assert ego.pose.position.z == 0.5 * ego.scale.z
    assert (ego.pose.orientation.z, ego.pose.orientation.w) == pytest.approx((0.5**0.5, 0.5**0.5))
    assert (boxes[3].scale.x, boxes[3].scale.y) == (12.0, 2.5)
    assert {label.type for label in labels} == {Marker.TEXT_VIEW_FACING}
    assert labels[0].text == "12.3"
    assert labels[0].pose.position.z > ego.scale.z


def test_pedestrians_are_cylinders(agent_table: Make) -> None:
    walker = {"id": 2, "kind": Kind.PEDESTRIAN, "length": 0.5, "width": 0.6}
    car, other = of(AgentLayer().draw(agent_table(1, {"id": 1}, walker)), "agents")
    assert (car.type, other.type) == (Marker.CUBE, Marker.CYLINDER)
    assert (other.scale.x, other.scale.y) == (0.5, 0.6)


def test_an_agent_of_the_next_run_is_drawn_as_its_own_kind(agent_table: Make) -> None:
    layer = AgentLayer()
    before = by_key(layer.draw(agent_table(30, {"id": 1}, {"id": 2})))
    after = by_key(layer.draw(agent_table(0, {"id": 1, "kind": Kind.PEDESTRIAN}, {"id": 2})))
    assert after.keys() == before.keys()
    assert [after["agents", number].type for number in (0, 1)] == [Marker.CYLINDER, Marker.CUBE]


def test_who_has_vanished_is_deleted_once_and_can_come_back(agent_table: Make) -> None:
    layer = AgentLayer()
    first = by_key(layer.draw(agent_table(0, {"id": 1}, {"id": BIG})))
    gone = layer.draw(agent_table(1, {"id": 1}))
    assert {key for key, m in by_key(gone).items() if m.action == Marker.DELETE} == {
        key for key in first if key[1] == of(gone, "agents", Marker.DELETE)[0].id
    }
    assert len(of(gone, "agents")) == len(of(gone, "speed", Marker.DELETE)) == 1
    still = layer.draw(agent_table(2, {"id": 1}))
    assert not of(still, "agents", Marker.DELETE)
    again = layer.draw(agent_table(3, {"id": 1, "x": 7.0}, {"id": BIG}))
    assert by_key(again).keys() == first.keys()
    assert of(again, "agents")[0].pose.position.x == 7.0
    assert len(by_key(layer.draw(agent_table(4)))) == 4


def test_states_that_are_not_finite_are_not_drawn(agent_table: Make) -> None:
    assert len(of(AgentLayer().draw(agent_table(0, {"id": 1, "x": np.nan}, {"id": 2})), "agents")) == 1


def forecast(step: int, *agents: int, points: int = 50, valid: list[bool] | None = None) -> JointForecast:
    mean = np.array([[[agent + 0.1 * k, 2.0] for k in range(points)] for agent in agents])
    return JointForecast(
        step=step,
        dt=0.1,
        horizon=0.1 * points,
        id=list(agents),
        mean=array("d", mean.ravel()),
        valid=valid or [True] * len(agents),
    )


def test_forecasts_are_line_strips_to_their_last_point() -> None:
    layer = ForecastLayer()
    lines = of(layer.draw(forecast(3, 5, 9, 12, valid=[True, True, False])), "forecasts")
    assert [line.type for line in lines] == [Marker.LINE_STRIP] * 2
    assert [len(line.points) for line in lines] == [POINTS_MAX] * 2
    xs = [point.x for point in lines[0].points]
    assert xs == sorted(xs)
    assert xs[-1] == pytest.approx(5 + 4.9)
    assert len(of(layer.draw(forecast(4, 9, points=4)), "forecasts")[0].points) == 4
    assert len(of(layer.draw(JointForecast(step=5)), "forecasts", Marker.DELETE)) == 1
    broken = forecast(6, 9)
    broken.mean[3] = np.inf
    assert not of(layer.draw(broken), "forecasts")


def takeover(agent: int, opponent: int, state: int) -> Takeover:
    return Takeover(
        agent=agent,
        opponent=opponent,
        state=state,
        conflict_pose=Pose2D(x=10.0, y=1.0, theta=0.0),
        goal_pose=Pose2D(x=30.0, y=2.0),
        reference_path=array("d", [0.0, 0.0, 10.0, 1.0, 30.0, 2.0]),
    )


def test_conflicts_say_who_meets_whom_where_and_where_to(agent_table: Make) -> None:
    table = agent_table(7, {"id": 1, "x": 50.0}, {"id": 2, "x": 40.0, "length": 9.0})
    states = {2: Takeover.HELD, 3: Takeover.HANDBACK, 4: Takeover.OWN_INTENT}
    message = Takeovers(step=7, takeovers=[takeover(agent, 1, state) for agent, state in states.items()])
    layer = ConflictLayer()
    markers = layer.draw(message, table)
    (box,), (line,), (path,), (goal,) = (of(markers, ns) for ns in ("conflicts", "opponents", "paths", "goals"))
    assert (box.pose.position.x, box.scale.x) == (10.0, 9.0)
    assert [point.x for point in line.points] == [40.0, 50.0]
    assert [(point.x, point.y) for point in path.points] == [(0.0, 0.0), (10.0, 1.0), (30.0, 2.0)]
    assert colour(path) == COLOURS[Mode.POLICY][0]
    assert (goal.pose.position.x, goal.pose.position.y) == (30.0, 2.0)
    assert modes_off_log(message) == {2: Mode.POLICY, 3: Mode.HANDBACK, 4: Mode.OWN_INTENT}
    cleared = by_key(layer.draw(Takeovers(step=8), table)).values()
    assert [each.action for each in cleared] == [Marker.DELETE] * 4


def test_an_opponent_that_has_left_has_no_line(agent_table: Make) -> None:
    message = Takeovers(step=7, takeovers=[takeover(2, 1, Takeover.HELD)])
    for table in (agent_table(7, {"id": 2}), None):
        markers = ConflictLayer().draw(message, table)
        assert not of(markers, "opponents")
        assert len(of(markers, "conflicts")) == 1
