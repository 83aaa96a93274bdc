"""The mission of the ego: its route along the edges of its log or to a goal, with the lane changes that it takes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.mission import ego_mission
from litsim_sim.scenario.recording import COLUMNS
from litsim_sim.scenario.scenario import Scenario, packaged

STREET = LaneMap.from_net(packaged("nets/urban_like.net.xml"))
LEFT, RIGHT, STRAIGHT = ":A_3_0", ":A_0_0", ":A_11_0"
RIGHT_FROM_WA = ":A_10_0"


@dataclass(frozen=True)
class Turn:
    """A track at 5 m/s over a lane within a junction, from 40 m before it on, for `seconds`."""

    inside: str
    seconds: float
    id: int = 1

    @property
    def lanes(self) -> list[Lane]:
        """The lanes before, within and after the junction."""
        inside = STREET.lanes[STREET.row(self.inside)]
        before = next(each for each in STREET.lanes if self.inside in each.successors)
        return [before, inside, STREET.lanes[STREET.row(inside.successors[0])]]

    @property
    def line(self) -> shapely.LineString:
        """Their centre line."""
        return shapely.LineString(np.concatenate([lane.centerline for lane in self.lanes]))

    def rows(self) -> pd.DataFrame:
        """See :class:`Turn`."""
        way = self.lanes[0].length - 40.0 + 5.0 * STEP_S * np.arange(round(self.seconds / STEP_S) + 1)
        x, y = shapely.get_coordinates(shapely.line_interpolate_point(self.line, way)).T
        columns = {
            "frame": np.arange(len(way) - 1),
            "x": x[:-1],
            "y": y[:-1],
            "yaw": np.arctan2(np.diff(y), np.diff(x)),
        }
        same = {"vehicle_id": self.id, "speed": 5.0, "acceleration": 0.0, "length": 4.5, "width": 2.0}
        return pd.DataFrame(columns | same | {"kind": 0, "lane": 0})[list(COLUMNS)]


@pytest.mark.parametrize("inside", [LEFT, RIGHT, STRAIGHT])
@pytest.mark.parametrize("seconds", [15.0, 9.5])
def test_the_ego_is_led_as_its_log_turns_also_where_that_ends_in_the_junction(
    make_scenario: Callable[..., Scenario], inside: str, seconds: float
) -> None:
    turn = Turn(inside, seconds)
    scenario = make_scenario(turn, net="urban_like", simulation_s=20.0)
    route = shapely.LineString(ego_mission(scenario).route)
    assert route.length == pytest.approx(1000.0, abs=0.1)
    way = turn.line.project(route.interpolate(0.0)) + np.arange(0.0, 80.0)
    assert shapely.distance(shapely.line_interpolate_point(turn.line, way), route).max() < 0.1


def test_the_route_is_that_of_the_lane_in_which_the_ego_is_free(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(1, x=100.0, yaw=0.07), history_steps=55)
    row, free = scenario.log.row(1), scenario.history_steps
    assert abs(scenario.log.y[row, free] - scenario.log.y[row, 0]) > 3.0, "it changes lanes in the history"
    route = ego_mission(scenario).route
    assert route[0] == pytest.approx([scenario.log.x[row, free], scenario.log.y[row, free]], abs=1.75)
    straight = make_scenario(track(1, x=100.0, y=-5.49), history_steps=55)
    assert ego_mission(straight).route[0] == pytest.approx([100.0, -5.49], abs=0.05)


def test_the_route_changes_lanes_where_no_lane_leads_on_as_the_log(make_scenario: Callable[..., Scenario]) -> None:
    """The log turns right from the lane beside the one from which that is allowed."""
    turn, beside = Turn(RIGHT_FROM_WA, 15.0), STREET.lanes[STREET.row("WA_1")]
    rows, before = turn.rows(), turn.lanes[0]
    ahead = rows["x"] < before.centerline[-1, 0]
    rows.loc[ahead, "y"] += float(beside.centerline[0, 1] - before.centerline[0, 1])

    class Made:
        id, rows = 1, staticmethod(lambda: rows)

    scenario = make_scenario(Made(), net="urban_like", simulation_s=20.0)
    line = shapely.LineString(ego_mission(scenario).route)
    x, y, row = scenario.log.x, scenario.log.y, scenario.log.row(1)
    assert line.distance(shapely.Point(x[row, 3], y[row, 3])) < 0.3, "it begins on the lane of the ego"
    after = shapely.LineString(turn.lanes[2].centerline)
    assert line.intersection(after.buffer(0.3)).length > 50.0, "it turns as the log does"
    heading = np.unwrap(np.arctan2(*np.diff(shapely.get_coordinates(line), axis=0).T[::-1]))
    assert np.abs(np.diff(heading)).max() < 0.5, "without a corner"


def test_the_route_leads_to_a_goal_whatever_the_log_does(make_scenario: Callable[..., Scenario]) -> None:
    turn, other = Turn(STRAIGHT, 15.0), Turn(RIGHT_FROM_WA, 15.0)
    first, inside, last = other.lanes
    goal = pose_on(last, 60.0)
    mission = ego_mission(make_scenario(turn, net="urban_like", simulation_s=20.0, goal=goal))
    assert mission.goal.tolist() == goal
    assert shapely.LineString(mission.route).distance(shapely.Point(goal[:2])) < 0.1
    names = {lane.id for lane, on in zip(STREET.lanes, mission.on_route, strict=True) if on}
    assert {first.id, inside.id, last.id} <= names and STRAIGHT not in names
    used = np.argsort(mission.entered)[: int(np.isfinite(mission.entered).sum())]
    assert [STREET.lanes[row].id for row in used[:3]] == [first.id, inside.id, last.id]


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        ([0.0, 900.0, 0.0], "0, 900, 0 is on no lane in its direction, expected a pose on a lane"),
        ([-170.0, -8.25, 0.0], "-170, -8.25, 0: no way leads there from the ego at"),
        ([-170.0, -4.95, 0.0], "-170, -4.95, 0: no way leads there from the ego at"),  # on the lane beside
    ],
)
def test_a_goal_that_cannot_be_reached_is_refused(make_scenario: Any, goal: list[float], why: str) -> None:
    """Before anything starts: the scenario cannot be loaded, nor taken with an ego that cannot reach it."""
    with pytest.raises(InputError, match=rf"made\.yaml: field goal: {why}"):
        make_scenario(Turn(STRAIGHT, 15.0), net="urban_like", simulation_s=20.0, goal=goal)


def test_a_goal_that_another_ego_cannot_reach_is_refused(make_scenario: Any) -> None:
    goal = pose_on(Turn(RIGHT_FROM_WA, 15.0).lanes[-1], 60.0)
    both = Turn(STRAIGHT, 15.0), Turn(next(iter(STREET.lanes[STREET.row("AB_0")].successors)), 15.0, id=2)
    scenario = make_scenario(*both, net="urban_like", simulation_s=20.0, goal=goal)
    assert ego_mission(scenario).goal.tolist() == goal
    with pytest.raises(InputError, match=r"made: field goal: .* no way leads there from the ego at"):
        scenario.around(ego=2, seed=None)


def pose_on(lane: Lane, s: float) -> list[float]:
    """Returns a pose on a lane of the street, `s` [m] from where it begins."""
    return [float(part) for part in STREET.pose_at(STREET.row(lane.id), s)]


def test_poses_on_the_way_to_the_goal(make_scenario: Callable[..., Scenario]) -> None:
    """Of a way over both junctions of the street; edges of its begin and its end have none."""
    turn = Turn(STRAIGHT, 15.0)
    goal = pose_on(STREET.lanes[STREET.row("BE_1")], 30.0)
    mission = ego_mission(make_scenario(turn, net="urban_like", simulation_s=20.0, goal=goal))
    ((x, y, yaw),) = mission.waypoints(STREET)
    place = STREET.nearest(np.array([x]), np.array([y]), np.array([yaw]))
    assert STREET.lanes[place.lane[0]].edge_id == "AB" and yaw == pytest.approx(0.0, abs=0.01)
