"""The egos that come with LitSim."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_policy.car_following import IdmConfig
from litsim_policy.ego import CAREFUL, IdmEgo, LogEgo, make_ego
from litsim_sim.errors import InputError
from litsim_sim.scene import EgoMode


def test_egos_have_names(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0))
    assert isinstance(make_ego("log", scenario), LogEgo)
    assert isinstance(make_ego("idm", scenario), IdmEgo)
    with pytest.raises(InputError, match="chauffeur"):
        make_ego("chauffeur", scenario)


# log


def test_the_log_ego_asks_to_follow_the_log_at_every_step(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0))
    commands = [LogEgo().plan(scenario.log.table(step)) for step in range(20)]
    assert [c.step for c in commands] == list(range(20))
    assert {c.mode for c in commands} == {EgoMode.FOLLOW_LOG}


def test_the_log_ego_is_where_its_log_has_it(make_scenario, track, drive) -> None:
    scenario = make_scenario(track(1, x=100.0, yaw=-0.03, acceleration=0.5), track(2, x=85.0))
    run = drive(scenario, "log")
    assert max(run.from_log(1, step) for step in range(scenario.total_steps + 1)) < 1e-9


# idm


def test_during_the_history_and_off_the_road_the_idm_ego_says_nothing(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0, speed=6.0, last=30), track(2, x=60.0), history_steps=10)
    ego = make_ego("idm", scenario)
    for step in (0, 9, 31, 40):
        command = ego.plan(scenario.log.table(step))
        assert (command.step, command.acceleration, command.yaw_rate) == (step, 0.0, 0.0)
    assert ego.plan(scenario.log.table(10)).acceleration > 0.5


@pytest.mark.parametrize("left", [-1.2, 0.0, 1.2])
def test_the_idm_ego_comes_onto_the_centre_of_its_lane_and_keeps_it(
    make_scenario, track, drive, lane_centres, left: float
) -> None:
    run = drive(make_scenario(track(1, x=100.0, y=lane_centres[2] + left, last=200)), "idm")
    offset = run.series(1, "y") - lane_centres[2]
    assert np.abs(offset).max() < abs(left) + 0.05
    assert np.abs(offset[80:]).max() < 0.02 and np.abs(run.series(1, "yaw")[80:]).max() < 0.01


def test_the_lane_is_chosen_once(make_scenario, track, drive, lane_centres) -> None:
    """When its history is over, the ego is about to cross into the next lane; it does so a little, and comes back."""
    scenario = make_scenario(track(1, x=100.0, y=lane_centres[2] + 1.15, yaw=0.2, last=36), track(2, x=20.0, last=100))
    run = drive(scenario, "idm")
    offset = run.series(1, "y") - lane_centres[2]
    assert offset.max() > 1.85 and abs(offset[-1]) < 0.05


def test_the_idm_ego_keeps_its_lane_where_its_log_leaves_it(make_scenario, track, drive, lane_centres) -> None:
    scenario = make_scenario(track(1, x=100.0, y=lane_centres[1], yaw=-0.05, last=100))
    run = drive(scenario, "idm")
    assert np.abs(run.series(1, "y")[60:] - lane_centres[1]).max() < 0.1
    assert run.from_log(1, 100) > 3.0


@pytest.mark.parametrize(("logged", "least"), [(16.0, 20.0), (6.0, 10.0)])
def test_on_a_free_road_the_idm_ego_drives_at_its_desired_speed_and_not_at_its_log(
    make_scenario, track, drive, logged: float, least: float
) -> None:
    run = drive(make_scenario(track(1, x=20.0, speed=logged, last=200)), "idm")
    assert run.series(1, "speed")[-1] == pytest.approx(CAREFUL.desired_speed, abs=0.5)
    assert run.from_log(1, 200) > least


@pytest.mark.parametrize(("speed", "away"), [(10.0, 40.0), (20.0, 70.0)])
def test_the_idm_ego_stops_behind_a_standing_leader_without_contact(
    make_scenario, track, drive, speed: float, away: float
) -> None:
    standing = track(2, x=100.0 + away, speed=0.0, last=250)
    run = drive(make_scenario(track(1, x=100.0, speed=speed, last=60), standing), "idm", policy="replay")
    gap = 100.0 + away - run.series(1, "x") - 4.5
    assert run.world.contacts == {} or gap.min() > 0.0
    assert gap.min() > 0.5
    assert gap[-1] == pytest.approx(CAREFUL.standstill_gap, abs=0.5) and run.series(1, "speed")[-1] < 0.1


def test_the_idm_ego_drives_past_one_that_stands_in_the_next_lane(make_scenario, track, drive, lane_centres) -> None:
    beside = track(2, x=140.0, y=lane_centres[0], speed=0.0, last=100)
    run = drive(make_scenario(track(1, x=100.0, last=100), beside), "idm", policy="replay")
    assert run.series(1, "speed").min() > 9.0


def test_the_parameters_of_the_idm_ego_count(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0), track(2, x=120.0))
    near, far = (make_ego("idm", scenario, IdmConfig(headway=headway)) for headway in (0.5, 3.0))
    table = scenario.log.table(5)
    assert near.plan(table).acceleration > 0.0 > far.plan(table).acceleration
