"""Lanes that follow each other."""

import pytest

from litsim_sim.lane_map.lane_graph import directly_linked, of_streets, straightest_successors
from litsim_sim.lane_map.net_lanes import read_lanes
from litsim_sim.scenario.scenario import packaged
from made_lanes import lane_of

FORK = [
    lane_of("a", [(-10, -10), (0, 0), (10, 0)], "left", "on", "right"),
    lane_of("left", [(10, 0), (20, 5)]),
    lane_of("on", [(10, 0), (20, 1), (20, 9)]),
    lane_of("right", [(10, 0), (20, -5)]),
]


def test_the_straightest_goes_on_from_the_end_of_a_lane() -> None:
    assert straightest_successors(FORK) == [2, None, None, None]


@pytest.mark.parametrize(
    ("net", "streets"), [("us101", False), ("us101_like", False), ("i80", False), ("urban_like", True)]
)
def test_lanes_turn_in_junctions_of_streets_alone(net: str, streets: bool) -> None:
    assert of_streets(read_lanes(packaged(f"nets/{net}.net.xml"))) == streets


def test_of_equally_straight_ones_the_first_by_id() -> None:
    ends = [lane_of("c", [(10, 0), (20, 2)]), lane_of("b", [(10, 0), (20, -2.0001)])]
    assert straightest_successors([lane_of("a", [(0, 0), (10, 0)], "c", "b"), *ends])[0] == 2


def test_a_turn_across_the_jump_of_angles_is_small() -> None:
    ends = [lane_of("back", [(0, 0), (10, 0)]), lane_of("on", [(0, 0), (-10, -0.5)])]
    assert straightest_successors([lane_of("a", [(10, 0.5), (0, 0)], "back", "on"), *ends])[0] == 2


def test_links_hold_both_ways_and_for_the_lane_itself() -> None:
    linked = directly_linked(FORK)
    assert linked.tolist() == [
        [True, True, True, True],
        [True, True, False, False],
        [True, False, True, False],
        [True, False, False, True],
    ]
