"""Where a net ends, on roads of a few lanes."""

import pytest

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_ends import BEYOND_MAX, NetEnds
from litsim_sim.scenario.scenario import packaged
from made_lanes import lane_of

ROAD = [lane_of("in_0", [(0, 0), (50, 0)], "out_0"), lane_of("out_0", [(50, 0), (100, 0)])]


@pytest.mark.parametrize(
    ("x", "y", "found"),
    [
        (100.5, 0.0, "out_0"),
        (104.0, 2.5, "out_0"),  # beside the lane, but by this end
        (99.5, 2.0, None),  # off the road, but not past its end
        (100.5, 8.0, None),  # through the fields
        (101.0 + BEYOND_MAX, 0.0, None),  # long gone, or never there
        (-0.5, 0.0, None),  # where the net begins nobody leaves it
    ],
)
def test_who_is_past_an_end_has_left_by_its_lane(x: float, y: float, found: str | None) -> None:
    assert NetEnds(ROAD).passed(x, y) == found


def test_a_lane_that_is_dropped_is_no_end() -> None:
    """An acceleration lane of an edge of its own ends beside the road that goes on."""
    ramp = lane_of("ramp_0", [(20, -3.5), (60, -3.5)])
    assert NetEnds([*ROAD, ramp]).passed(60.5, -3.5) is None
    assert NetEnds([*ROAD, ramp]).passed(100.5, 0.0) == "out_0"
    wide = [lane_of("in_0", [(0, 0), (50, 0)], "out_0"), lane_of("in_1", [(0, 3), (50, 3)]), ROAD[1]]
    assert NetEnds(wide).passed(50.5, 5.0) is None, "a lane of an edge that goes on"


def test_the_other_direction_of_a_street_does_not_go_on() -> None:
    back = lane_of("back_0", [(100, 3), (0, 3)])
    assert NetEnds([*ROAD, back]).passed(100.5, 0.0) == "out_0"
    assert NetEnds([*ROAD, back]).passed(-0.5, 3.0) == "back_0"


def test_a_ring_has_no_end() -> None:
    ring = [lane_of("a_0", [(0, 0), (10, 0)], "b_0"), lane_of("b_0", [(10, 0), (0, 0)], "a_0")]
    assert NetEnds(ring).passed(11, 0) is None


@pytest.mark.parametrize(("net", "ends"), [("us101_like", 6), ("urban_like", 8)])
def test_packaged_nets_are_left_by_every_lane_that_leads_out(net: str, ends: int) -> None:
    lane_map = LaneMap.from_net(packaged(f"nets/{net}.net.xml"))
    leaves = set()
    for row, each in enumerate(lane_map.lanes):
        x, y, _ = lane_map.pose_at(row, each.length + 2.5)
        if not lane_map.inside_road(x, y)[0] and (by := lane_map.ends.passed(float(x), float(y))) is not None:
            assert by == each.id
            leaves.add(by)
    assert len(leaves) == ends
