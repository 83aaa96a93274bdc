"""The egos that come with LitSim."""

import numpy as np
import pytest

from litsim_policy.ego.idm import CAREFUL, IdmEgo
from litsim_policy.ego.log import LogEgo
from litsim_policy.ego.perturbed import PerturbedConfig, PerturbedEgo
from litsim_policy.motion.car_following import IdmConfig
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.scene import EgoMode
from litsim_sim.scenario.scenario import Scenario

# log


def test_the_log_ego_asks_to_follow_the_log_at_every_step(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0))
    commands = [LogEgo(scenario).plan(scenario.log.table(step)) for step in range(20)]
    assert [c.step for c in commands] == list(range(20))
    assert {c.mode for c in commands} == {EgoMode.FOLLOW_LOG}


# idm


def test_during_the_history_and_off_the_road_the_idm_ego_says_nothing(make_scenario, track) -> None:
    scenario = make_scenario(track(1, x=100.0, speed=6.0, last=30), track(2, x=60.0), history_steps=10)
    ego = IdmEgo(scenario)
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
    near, far = (IdmEgo(scenario, IdmConfig(headway=headway)) for headway in (0.5, 3.0))
    table = scenario.log.table(5)
    assert near.plan(table).acceleration > 0.0 > far.plan(table).acceleration


# perturbed


@pytest.fixture
def perturbed(drive):
    """Runs a scenario, by replay if not told otherwise, with a perturbed ego; returns the run and such an ego."""

    def run(scenario: Scenario, policy: str = "replay", **config):
        ego = PerturbedEgo(scenario, PerturbedConfig(**config))
        return drive(scenario, "perturbed", policy=policy, parameters={"ego": config}), ego

    return run


def test_up_to_the_perturbation_the_log_is_followed_exactly(make_scenario, track, perturbed) -> None:
    run, ego = perturbed(make_scenario(track(1, x=100.0, yaw=-0.02, last=150)), kind="brake", time=(2.0, 2.0))
    assert ego.first_step == 23
    assert max(run.from_log(1, step) for step in range(24)) < 1e-9
    assert run.series(1, "acceleration")[24:49] == pytest.approx(-2.0)


def test_it_brakes_as_long_as_it_should_and_then_returns_to_the_logged_speed_but_stays_behind(
    make_scenario, track, perturbed
) -> None:
    run, _ = perturbed(make_scenario(track(1, x=100.0, last=150)), kind="brake", time=(0.0, 0.0))
    speed = run.series(1, "speed")
    assert speed[28] == pytest.approx(5.0) and speed[27] > 5.1 and speed[29] > 5.0
    assert speed[120] == pytest.approx(10.0, abs=0.02)
    assert run.from_log(1, 150) == pytest.approx(run.from_log(1, 120), abs=0.1) and run.from_log(1, 150) > 8.0
    y = run.series(1, "y")
    assert np.abs(y - y[0]).max() < 0.05


def test_it_keeps_its_speed_whoever_is_ahead(make_scenario, track, perturbed) -> None:
    scenario = make_scenario(track(1, x=100.0, speed=12.0, last=150), track(2, x=130.0, speed=8.0, last=150))
    run, ego = perturbed(scenario, kind="keep_speed", time=(1.0, 1.0))
    assert (ego.kind, ego.first_step) == ("keep_speed", 13)
    contact = run.world.contacts[(1, 2)]
    assert run.series(1, "speed")[13:contact] == pytest.approx(12.0)
    assert run.series(1, "x")[contact] == pytest.approx(100.0 + 1.2 * contact, abs=0.2)


def test_it_changes_to_the_next_lane_and_keeps_to_it(make_scenario, track, perturbed, lane_centres) -> None:
    scenario = make_scenario(track(1, x=100.0, y=lane_centres[2], last=150))
    run, ego = perturbed(scenario, kind="lane_change", time=(1.0, 1.0))
    y = run.series(1, "y")
    target = lane_centres[1 if ego._left_first else 3]
    assert np.abs(y[:13] - lane_centres[2]).max() < 1e-6
    assert y[60:] == pytest.approx(target, abs=0.1)
    assert run.series(1, "speed")[-1] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("lane", [0, 4])
def test_at_the_edge_of_the_road_there_is_one_way_only(make_scenario, track, perturbed, lane_centres, lane) -> None:
    run, _ = perturbed(make_scenario(track(1, x=100.0, y=lane_centres[lane], last=150)), kind="lane_change")
    assert run.series(1, "y")[-1] == pytest.approx(lane_centres[1 if lane == 0 else 3], abs=0.1)


def test_it_does_not_change_into_whoever_is_alongside_and_brakes_after_a_while(
    make_scenario, track, perturbed, lane_centres
) -> None:
    walls = [track(2 + i, x=100.0 + 1.0 * i, y=lane_centres[2 * i], last=150) for i in range(2)]
    scenario = make_scenario(track(1, x=100.0, y=lane_centres[1], last=150), *walls)
    run, _ = perturbed(scenario, kind="lane_change", time=(0.0, 0.0))
    assert run.world.contacts == {} and np.abs(run.series(1, "y") - lane_centres[1]).max() < 0.1
    assert max(run.from_log(1, step) for step in range(43)) < 1e-9 and run.series(1, "speed").min() < 5.5


def test_after_the_perturbation_it_does_not_run_into_its_leader(make_scenario, track, perturbed) -> None:
    stops = track(2, x=140.0, acceleration=-1.0, last=99)
    run, _ = perturbed(make_scenario(track(1, x=100.0, last=99), stops), kind="brake", time=(0.0, 0.0))
    assert run.world.contacts == {}


def test_the_seed_and_the_ego_decide_what_and_when(make_scenario, track) -> None:
    def drawn(seed: int, ego: int) -> tuple[int, str, bool]:
        scenario = make_scenario(track(ego, x=100.0), seed=seed)
        found = PerturbedEgo(scenario)
        return found.first_step, found.kind, found._left_first

    assert drawn(5, 1) == drawn(5, 1)
    several = {drawn(seed, ego) for seed in range(4) for ego in (1, 2, 3)}
    assert len(several) >= 10 and {kind for _, kind, _ in several} == {"brake", "lane_change"}
    assert all(3 <= step <= 43 for step, *_ in several)


@pytest.mark.parametrize(
    "config",
    [{"kind": "swerve"}, {"time": (2.0, 1.0)}, {"time": (1.0,)}, {"duration": -1.0}, {"lane_change_time": 0.0}],
)
def test_perturbations_that_cannot_be_are_input_errors(config) -> None:
    with pytest.raises(InputError, match=next(iter(config))):
        ParameterOverrides("ego", config)(PerturbedConfig())


def test_yielding_copes_with_perturbed_egos_where_replay_does_not(make_scenario, track, perturbed) -> None:
    scenario = make_scenario(*(track(i, x=115.0 - 12.0 * i, last=200) for i in (1, 2, 3)))
    replay, _ = perturbed(scenario, kind="brake", duration=4.0)
    mended, _ = perturbed(scenario, policy="yield", kind="brake", duration=4.0)
    assert (1, 2) in replay.world.contacts and mended.world.contacts == {}
