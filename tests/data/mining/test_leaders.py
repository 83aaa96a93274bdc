"""Leaders along lanes."""

import numpy as np
import pytest

from made_traffic import STREET, on_path, situation, straight

NONE = -1


def test_the_leader_is_the_nearest_ahead_in_the_lane() -> None:
    same = [straight(1, 0.0, 10.0, 2), straight(2, 50.0, 8.0, 2), straight(3, 30.0, 9.0, 2)]
    made = situation(*same, straight(4, 20.0, 9.0, 3))
    following = made.following
    assert following.leader[:, 0].tolist() == [2, NONE, 1, NONE]
    assert following.gap[:, 0].tolist() == pytest.approx([25.5, np.inf, 15.5, np.inf])
    assert following.closing[:, 0].tolist() == pytest.approx([1.0, 0.0, 1.0, 0.0])
    assert following.headway[:, 0].tolist() == pytest.approx([2.55, np.inf, 15.5 / 9.0, np.inf])
    assert following.time_to_leader[:, 0].tolist() == pytest.approx([25.5, np.inf, 15.5, np.inf])


def test_a_leader_is_seen_over_the_ends_of_lanes_up_to_a_hundred_metres() -> None:
    # At 176 m `upstream` becomes `weave`.
    made = situation(straight(1, 100.0, 10.0, 2), straight(2, 190.0, 10.0, 2), straight(3, 300.0, 10.0, 2))
    assert made.following.leader[:, 0].tolist() == [1, NONE, NONE]
    assert made.following.gap[0].tolist() == pytest.approx([85.5] * made.log.steps, abs=0.01)


def test_a_leader_whose_rear_is_near_is_seen_where_its_lane_begins_farther_away() -> None:
    made = situation(straight(1, 74.0, 10.0, 2), straight(2, 177.0, 10.0, 2))  # `weave` begins 102 m ahead of the first
    assert made.following.gap[0].tolist() == pytest.approx([98.5] * made.log.steps, abs=0.01)


def test_at_a_junction_the_leader_is_on_the_way_that_the_agent_takes() -> None:
    turning, ahead = on_path(1, ("WA_2", "AAN_0"), 100.0, 8.0), on_path(2, ("WA_2", "AAN_0"), 125.0, 8.0)
    other = on_path(3, ("WA_1", "AB_1"), 120.0, 8.0)
    made = situation(turning, ahead, other, lane_map=STREET)
    both = made.log.valid[1]
    assert (made.following.leader[0, both] == 1).all()
    gaps = made.following.gap[0, both].tolist()
    assert gaps == pytest.approx([20.5] * len(gaps), abs=1.0)  # lanes meet within a metre
    assert (made.following.leader[2] == NONE).all()


def test_nobody_leads_who_comes_the_other_way() -> None:
    ego, oncoming = on_path(1, ("WA_1", "AB_1"), 20.0, 8.0), on_path(2, ("BA_1", "AW_1"), 150.0, 8.0)
    assert (situation(ego, oncoming, lane_map=STREET).following.leader == NONE).all()
