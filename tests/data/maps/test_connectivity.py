"""Lanes that lead nowhere, lanes that nothing leads to, and edges that cross."""

from dataclasses import replace

import pytest

from litsim_data.maps.connectivity import Connectivity, connectivity
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.scenario import packaged
from made_lanes import made_lane


def test_lanes_that_lead_nowhere_and_that_nothing_leads_to() -> None:
    lanes = [
        made_lane("a_0", (0, -5.25), (100, -5.25), left="a_1"),
        made_lane("a_1", (0, -1.75), (100, -1.75), ("b_0",), right="a_0"),
        made_lane("b_0", (100, -1.75), (200, -1.75), ("c_0",)),
        made_lane("c_0", (200, -1.75), (300, -1.75), ("b_0",)),  # round and round
        made_lane("d_0", (0, 40), (100, 40), ("e_0",)),
        made_lane("e_0", (100, 40), (200, 40), ("d_0",)),  # and nobody comes in
    ]
    found = connectivity(LaneMap(lanes))
    assert found.stuck == ("a_0", "a_1") and found.ending == ("a_0",)
    assert found.unreached == ("d_0", "e_0")
    assert "lane a_1 leads to no exit" in found.failures
    assert "lane e_0 cannot be reached from where vehicles come in" in found.failures


def test_a_closed_net_has_no_way_in_and_lacks_nothing() -> None:
    there, back = made_lane("a_0", (0, 0), (100, 0), ("b_0",)), made_lane("b_0", (100, 5), (0, 5), ("a_0",))
    assert connectivity(LaneMap([there, back])) == Connectivity()


def test_junctions_without_lanes_inside_are_told() -> None:
    lanes = [
        made_lane("a_0", (0, 0), (100, 0), ("b_0", "c_0")),
        made_lane("b_0", (112, 0), (200, 0)),
        made_lane("c_0", (106, 6), (106, 100)),
    ]
    found = connectivity(LaneMap(lanes))
    assert found.apart == (("a_0", "b_0"), ("a_0", "c_0"))
    (said,) = found.failures
    assert said.startswith("2 lanes lead to one that begins more than 6 m away, such as a_0 to b_0")


def test_lanes_beside_those_that_turn_around_at_the_ends_of_a_net_lack_nothing() -> None:
    lanes = [
        made_lane("a_0", (0, -5), (100, -5), ("b_0",), left="a_1"),
        made_lane("a_1", (0, -2), (100, -2), ("b_1",), right="a_0"),
        made_lane("b_0", (100, -5), (200, -5), left="b_1"),
        made_lane("b_1", (100, -2), (200, -2), ("c_0",), right="b_0"),
        made_lane("c_0", (200, 2), (0, 2), ("a_1",)),
    ]
    found = connectivity(LaneMap(lanes))
    assert (found.beginning, found.ending, found.failures) == (("a_0",), ("b_0",), [])
    assert connectivity(LaneMap([*lanes, made_lane("d_0", (100, 60), (100, 2), ("c_0",))])).stuck == ("d_0",)


def test_a_lane_that_begins_late_is_changed_onto() -> None:
    lanes = [
        made_lane("a_0", (0, -5.25), (100, -5.25), ("b_0",)),
        made_lane("b_0", (100, -5.25), (200, -5.25), left="b_1"),
        made_lane("b_1", (100, -1.75), (200, -1.75), right="b_0"),
    ]
    found = connectivity(LaneMap(lanes))
    assert found.beginning == ("b_1",) and found.failures == []
    alone = [lanes[0], replace(lanes[1], left=None), replace(lanes[2], right=None)]
    assert connectivity(LaneMap(alone)).unreached == ("b_1",)


@pytest.mark.parametrize(("apart", "turn", "found"), [(0.5, 0.0, True), (4.0, 0.0, False), (0.5, 100.0, False)])
def test_a_link_that_was_forgotten(apart: float, turn: float, found: bool) -> None:
    lanes = [
        made_lane("a_0", (0, 0), (100, 0), ("b_0",)),
        made_lane("b_0", (100, 0), (200, 0)),
        made_lane("c_0", (200 + apart, 0), (300, turn * 2)),  # straight on, or to the side
    ]
    gaps = connectivity(LaneMap(lanes)).gaps
    assert [(gap.before, gap.lane, gap.x) for gap in gaps] == ([("b_0", "c_0", 200 + apart)] if found else [])


def test_edges_that_cross() -> None:
    across = made_lane("c_0", (50, -50), (60, 50))
    lanes = [
        made_lane("a_0", (0, -1.75), (100, -1.75), left="a_1"),
        made_lane("a_1", (0, 1.75), (100, 1.75), right="a_0"),
        across,
        made_lane("d_0", (0, -30), (100, 30)),
        made_lane(":j_0", (10, -20), (10, 20)),  # inside a junction lanes cross
        made_lane("e_0", (0, -2.0), (100, -1.5)),  # merges
    ]
    found = connectivity(LaneMap(lanes))
    assert {each.one + each.other for each in found.crossings} == {"ac", "ad", "cd", "ce", "de"}
    (first,) = (each for each in found.crossings if (each.one, each.other) == ("a", "c"))
    assert (first.x, first.y) == (pytest.approx(54.825), pytest.approx(-1.75))
    assert any("edges a and c cross at (54.8, -1.8) without a junction" in said for said in found.failures)


@pytest.mark.parametrize("net", ["us101", "us101_like", "i80", "urban_like"])
def test_packaged_nets_lack_nothing(net: str) -> None:
    assert connectivity(LaneMap.from_net(packaged(f"nets/{net}.net.xml"))).failures == []
