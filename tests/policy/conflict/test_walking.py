"""The ways of walkers and cyclists: who is in them, and who is expected to brake."""

import numpy as np
import pytest

from litsim_policy.conflict.walking import GAPS, WaysAhead
from litsim_sim.core.scene import Kind

EGO, WALKER = 1, 9
SPEED, LENGTH, AHEAD = 1.4, 0.5, 2.0  # of the walker, whose box is [m] from the lane of a car at step 0


@pytest.fixture
def ways(make_scenario, track, placed, lane_centres):
    """The walker's way at step 0, with the ego `at` x [m] and as fast as stated; in its log it stands far behind."""
    y = lane_centres[1]
    ego = track(EGO, x=100.0, y=y, speed=0.0)
    start = {"x": 300.0, "y": y - 1.0 - AHEAD - 0.5 * LENGTH, "yaw": 0.5 * np.pi, "speed": SPEED}
    scenario = make_scenario(ego, track(WALKER, kind=Kind.PEDESTRIAN, length=LENGTH, width=0.6, **start))

    def look(at: float, speed: float = 0.0) -> WaysAhead:
        table = placed(scenario.log.table(0), EGO, x=at, speed=speed)
        return WaysAhead.of(scenario.log, table, np.array([table.row(WALKER)]), np.zeros(1, np.int64))

    return look


def test_who_stands_in_the_way_blocks_it_up_to_the_gap(ways) -> None:
    way = ways(300.0)
    assert way.blocker.tolist() == [0] and way.time[0] == pytest.approx(
        (AHEAD - GAPS[Kind.PEDESTRIAN]) / SPEED, abs=0.1
    )
    assert AHEAD - GAPS[Kind.PEDESTRIAN] - 0.1 * SPEED <= way.room[0] <= AHEAD - GAPS[Kind.PEDESTRIAN]


@pytest.mark.parametrize(("at", "blocks"), [(297.4, True), (297.3, False), (302.6, True), (302.7, False)])
def test_who_stands_beside_the_way_does_not_block_it(ways, at: float, blocks: bool) -> None:
    assert (ways(at).blocker[0] >= 0) == blocks


@pytest.mark.parametrize(("braking", "blocks"), [(2.5, False), (5.0, True)])
def test_a_vehicle_is_in_the_way_only_if_it_cannot_brake(ways, braking: float, blocks: bool) -> None:
    speed = 8.0
    to_box = speed**2 / (2.0 * braking) + 0.5 * 4.5 + 0.4  # [m] with the halves of both boxes and the gap at the side
    way = ways(300.0 - to_box, speed)
    assert (way.blocker[0] >= 0) == blocks
    assert not blocks or AHEAD - GAPS[Kind.PEDESTRIAN] - 0.1 * SPEED <= way.room[0] <= AHEAD - GAPS[Kind.PEDESTRIAN]


def test_a_vehicle_where_it_was_recorded_is_in_nobodys_way(make_scenario, track) -> None:
    over = {"x": 300.0, "y": track(EGO, x=0.0).y - 3.0, "yaw": 0.5 * np.pi, "speed": SPEED}
    scenario = make_scenario(track(EGO, x=300.0, speed=0.0), track(WALKER, kind=Kind.PEDESTRIAN, **over))
    table = scenario.log.table(0)
    assert WaysAhead.of(scenario.log, table, np.array([1]), np.zeros(1, np.int64)).blocker.tolist() == [-1]
