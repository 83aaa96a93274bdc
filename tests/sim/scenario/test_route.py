"""The route of the ego: along the edges of its log, as far as its lane leads there."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest
import shapely

from litsim_sim.core.scene import STEP_S
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.recording import COLUMNS
from litsim_sim.scenario.route import ego_route
from litsim_sim.scenario.scenario import Scenario, packaged

STREET = LaneMap.from_net(packaged("nets/urban_like.net.xml"))
LEFT, RIGHT, STRAIGHT = ":A_3_0", ":A_0_0", ":A_11_0"


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
    route = shapely.LineString(ego_route(scenario, 1000.0))
    assert route.length == pytest.approx(1000.0, abs=0.1)
    way = turn.line.project(route.interpolate(0.0)) + np.arange(0.0, 80.0)
    assert shapely.distance(shapely.line_interpolate_point(turn.line, way), route).max() < 0.1


def test_the_route_is_that_of_the_lane_in_which_the_ego_is_free(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(1, x=100.0, yaw=0.07), history_steps=55)
    row, free = scenario.log.row(1), scenario.history_steps
    assert abs(scenario.log.y[row, free] - scenario.log.y[row, 0]) > 3.0, "it changes lanes in the history"
    route = ego_route(scenario, 1000.0)
    assert route[0] == pytest.approx([scenario.log.x[row, free], scenario.log.y[row, free]], abs=1.75)
    straight = make_scenario(track(1, x=100.0, y=-5.49), history_steps=55)
    assert ego_route(straight, 1000.0)[0] == pytest.approx([100.0, -5.49], abs=0.05)
