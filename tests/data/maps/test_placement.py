"""How positions lie on lanes, and which are the worst misses."""

import numpy as np
import pytest

from litsim_data.maps.placement import WORST, placement
from litsim_sim.lane_map.lane_map import LaneMap
from made_lanes import made_lane, rows

LANES = LaneMap([made_lane("a_0", (0, -5.25), (100, -5.25)), made_lane("a_1", (0, -1.75), (100, -1.75))])


def test_vehicles_on_lanes_and_on_the_lane_that_is_named() -> None:
    table = rows(50.0, [-1.0, -3.0, -6.0, -9.0], lane=[1, 2, 2, 2])
    found = placement(LANES, table)
    assert (found.rows, found.named) == (4, 4)
    assert found.inside == pytest.approx(0.75)  # the last is off the road
    assert found.inside_named == pytest.approx(0.5)  # the second is on lane 1
    assert found.agreement == pytest.approx(0.75)
    unnamed = placement(LANES, table.assign(lane=-1))
    assert unnamed.named == 0 and np.isnan(unnamed.agreement)


def test_vehicles_on_lanes_that_lead_the_other_way() -> None:
    table = rows(50.0, [-1.0, -3.0, -6.0, -9.0])
    assert placement(LANES, table).against == 0.0
    assert placement(LANES, table.assign(yaw=[0.1, 3.0, 3.1, 3.1])).against == 0.5  # the last is off the road


def test_the_worst_miss_of_each_vehicle_has_its_place_and_time() -> None:
    found = placement(LANES, rows([50, 60, 105, 70], [1.0, 2.5, -5.25, -1.0], vehicle_id=[4, 4, 9, 9]))
    assert (found.missing, found.past_end) == (2, pytest.approx(1 / 3))
    far, near = found.worst
    assert (far.vehicle, far.x, far.y, far.frame, far.time_s) == (9, 105.0, -5.25, 2, pytest.approx(0.2))
    assert (far.lane, far.past_end, far.beyond) == ("a_0", True, pytest.approx(5.0 - 1.75))
    assert (near.vehicle, near.frame, near.y, near.lane, near.past_end) == (4, 1, 2.5, "a_1", False)
    assert near.beyond == pytest.approx(2.5)
    assert placement(LANES, rows([1.0], [-1.0])).worst == ()


def test_only_so_many_are_told() -> None:
    found = placement(LANES, rows(50.0, 10.0 + np.arange(15.0), vehicle_id=np.arange(15)))
    assert found.missing == 15 and [miss.vehicle for miss in found.worst] == list(range(14, 14 - WORST, -1))
