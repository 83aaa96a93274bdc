"""Leaders on the way of a log: straight on, around a bend, beside it and about to enter it."""

import numpy as np
import pytest

from litsim_policy.motion.along_path import corridor_of
from litsim_policy.motion.log_leaders import (
    VERTICES,
    Vehicle,
    columns_of,
    gap_ahead,
    lay_way,
    leader_now,
    logged_leader,
    place_on,
)
from litsim_sim.core.scene import AgentTable
from litsim_sim.scenario.log import Log

LENGTH, WIDTH = 4.5, 2.0


@pytest.fixture
def follow(make_scenario, track, agent_table):
    """The leader now of agent 1, which drives along y = 0 at 10 m/s from x = 100, among other agents."""

    def leader(*others: dict[str, float]):
        log = make_scenario(track(1, x=100.0, y=0.0), track(9, x=300.0), coverage_min=0.0, ego=9).log
        table = agent_table(0, {"id": 1, "x": 100.0}, *others)
        way = np.zeros((VERTICES, 5))
        return leader_now(way, lay_way(columns_of(log), 0, 0, way), table.arrays, 0, np.arange(len(table)))

    return leader


def test_the_nearest_ahead_leads(follow) -> None:
    leader = follow({"id": 2, "x": 140.0, "speed": 3.0}, {"id": 3, "x": 120.0, "speed": 7.0}, {"id": 4, "x": 90.0})
    assert (leader.row, leader.gap, leader.speed) == (2, pytest.approx(20.0 - LENGTH), pytest.approx(7.0))


def test_nobody_leads_from_the_next_lane_or_out_of_sight(follow) -> None:
    leader = follow({"id": 2, "x": 120.0, "y": 3.6}, {"id": 3, "x": 170.0})
    assert leader.row == -1 and np.isinf(leader.gap)


@pytest.mark.parametrize(("turn", "leads"), [(-0.25, True), (0.0, False), (0.25, False)])
def test_who_is_about_to_move_over_leads_already(follow, turn: float, leads: bool) -> None:
    assert (follow({"id": 2, "x": 120.0, "y": 3.6, "yaw": turn}).row >= 0) == leads


def test_who_crosses_is_slow_along_the_way(follow) -> None:
    leader = follow({"id": 2, "x": 120.0, "y": -3.0, "yaw": np.pi / 2, "speed": 6.0})
    assert leader.row == 1 and leader.speed == pytest.approx(0.0, abs=1e-9)
    assert leader.gap == pytest.approx(20.0 - 0.5 * LENGTH - 0.5 * WIDTH)


def bend(log: Log) -> Log:
    """The log of one agent around a quarter circle of 20 m."""
    angle = np.linspace(0.0, np.pi / 2, log.steps)
    log.x[0], log.y[0], log.yaw[0] = 20.0 * np.sin(angle), 20.0 * (1.0 - np.cos(angle)), angle
    return log


def test_the_way_follows_the_log_around_a_bend_and_goes_straight_on_after_it(make_scenario, track) -> None:
    log = bend(make_scenario(track(1, x=0.0, y=0.0), track(9, x=300.0), coverage_min=0.0, ego=9).log)
    way = np.zeros((VERTICES, 5))
    count = lay_way(columns_of(log), 0, 0, way)
    s, d, _, _ = place_on(way, count, 20.0, 30.0)
    assert s == pytest.approx(20.0 * np.pi / 2 + 10.0, abs=0.2) and d == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("wide", [0.0, 0.02, 0.3, 1.5])
def test_who_is_passed_over_beside_a_way_would_not_lead(make_scenario, track, wide: float) -> None:
    log = make_scenario(track(1, x=0.0, y=0.0), track(9, x=300.0), coverage_min=0.0, ego=9).log
    random, way = np.random.default_rng(5), np.zeros((VERTICES, 5))
    leads = 0
    for _ in range(20):
        turns = random.uniform(-wide, wide, log.steps).cumsum()
        log.x[0], log.y[0] = np.cumsum(random.uniform(0.0, 1.5, log.steps) * (np.cos(turns), np.sin(turns)), axis=1)
        log.yaw[0] = turns
        count = lay_way(columns_of(log), 0, 0, way)
        corridor, own = corridor_of(way, count), Vehicle(0.0, 0.0, 0.0, 8.0, LENGTH, WIDTH)
        everywhere = corridor._replace(turn=0.0)
        for x, y, yaw, speed in random.uniform((-20.0, -15.0, -4.0, 0.0), (60.0, 15.0, 4.0, 12.0), (200, 4)).tolist():
            other = Vehicle(x, y, yaw, speed, LENGTH, WIDTH)
            gap = gap_ahead(way, count, everywhere, own, (0.5, 0.2), other)
            assert gap_ahead(way, count, corridor, own, (0.5, 0.2), other) == gap
            leads += np.isfinite(gap[0])
    assert leads > 100


def test_the_leader_of_the_record_has_its_speed_and_acceleration(make_scenario, track) -> None:
    log = make_scenario(track(1, x=100.0), track(2, x=130.0, acceleration=-1.0), coverage_min=0.0).log
    way = np.zeros((VERTICES, 5))
    leader = logged_leader(way, lay_way(columns_of(log), 0, 20, way), columns_of(log), 0, 20)
    assert leader.row == 1 and leader.gap == pytest.approx(28.0 - LENGTH)
    assert (leader.speed, leader.acceleration) == (pytest.approx(8.0), pytest.approx(-1.0))


def test_agents_of_other_scenes_do_not_lead(make_scenario, track) -> None:
    from litsim_sim.scenario.batched import BatchedLog

    one = make_scenario(track(1, x=100.0), track(9, x=400.0), coverage_min=0.0, ego=9).log
    other = make_scenario(track(1, x=120.0), track(9, x=400.0), coverage_min=0.0, ego=9).log
    columns, way = columns_of(BatchedLog.of([one, other])), np.zeros((VERTICES, 5))
    assert logged_leader(way, lay_way(columns, 0, 0, way), columns, 0, 0).row == -1
    assert isinstance(one.table(0), AgentTable)
