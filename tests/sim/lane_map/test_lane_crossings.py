"""Where lanes cross, on a few lanes and on the packaged nets."""

import numpy as np
import pytest

from litsim_sim.lane_map.lane_crossings import lane_crossings
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged
from made_lanes import lane_of


def test_lanes_cross_where_their_centre_lines_do() -> None:
    found = lane_crossings(
        [lane_of("a", [(-20, 0), (20, 0)]), lane_of("b", [(3, -20), (3, 20)]), lane_of("c", [(-20, 50), (20, 50)])]
    )
    assert found == pytest.approx(np.array([[3.0, 0.0]]))


def test_lanes_that_merge_or_meet_end_to_end_do_not_cross() -> None:
    through = lane_of("a", [(-20, 0), (20, 0)])
    assert not len(lane_crossings([through, lane_of("ramp", [(-20, -3), (20, 0.5)])])), "at a flat angle"
    assert not len(lane_crossings([through, lane_of("on", [(20, 0), (20, 20)])])), "one goes on from the other"


@pytest.mark.parametrize(("net", "crosses"), [("us101_like", False), ("us101", False), ("i80", False)])
def test_motorways_have_no_crossings(net: str, crosses: bool) -> None:
    assert bool(len(lane_crossings(LaneMap.from_net(packaged(f"nets/{net}.net.xml")).lanes))) is crosses


def test_crossings_of_a_street_are_in_its_junctions() -> None:
    found = lane_crossings(LaneMap.from_net(packaged("nets/urban_like.net.xml")).lanes)
    assert len(found) > 20
    assert (np.abs(np.abs(found[:, 0]) - 100.0) < 20.0).all(), "the junctions are at x = -100 and 100 m"
