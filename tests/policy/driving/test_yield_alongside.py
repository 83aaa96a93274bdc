"""The rule-based policy where boxes touch or overlap along the path: there is no gap left to follow at."""

import numpy as np
import pytest

from litsim_policy.driving.handback import COMFORTABLE
from litsim_policy.driving.yield_policy import YieldPolicy
from litsim_policy.driving.yielding_rules import COURTESY_DECELERATION
from litsim_policy.motion.car_following import GAP_MIN, IdmConfig, idm_acceleration
from litsim_policy.motion.reference_path import logged_path
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.takeover import TakeoverState, TakeoverTable
from litsim_sim.scenario.scenario import Scenario
from made_agents import takeover

LENGTH = 4.5  # [m] of everybody
OPPONENT, STRANGER = 1, 3
GAPS = (0.0, -1e-9, -4.4)  # [m] bumper to bumper; the centre of the other one is ahead still


@pytest.fixture(scope="module")
def scene(make_scenario, track) -> Scenario:
    """Agent 2 at 10 m/s along lane 1; an opponent and a stranger far away, to be put elsewhere."""
    return make_scenario(track(1, x=300.0), track(2, x=100.0), track(3, x=350.0))


@pytest.fixture
def act(scene: Scenario, placed, lane_centres):
    """Acceleration of agent 2 with somebody `gap` [m] ahead of its bumper, in its lane if not told otherwise."""
    policy = YieldPolicy(scene)

    def act(
        who: int, gap: float, state: TakeoverState = TakeoverState.HELD, own: float = 10.0, **other: float
    ) -> float:
        table: AgentTable = placed(scene.log.table(5), 2, speed=own)
        x = float(table.x[table.row(2)]) + LENGTH + gap
        table = placed(table, who, **({"x": x, "y": lane_centres[1], "speed": 4.0} | other))
        path = logged_path(scene.log, scene.lane_map, 2).points
        taken = takeover(2, OPPONENT, state=state, reference_path=path)
        controls = policy.act(table, TakeoverTable(table.step, (taken,)))
        assert controls.id.tolist() == [2]
        return float(controls.acceleration[0])

    return act


@pytest.mark.parametrize("gap", [0.0, -1e-9, -0.3, -4.4, -500.0])
@pytest.mark.parametrize(("speed", "leader_speed"), [(0.0, 0.0), (10.0, 4.0), (10.0, 10.0), (10.0, 12.0)])
def test_without_a_gap_the_model_brakes_as_at_its_smallest_one(gap: float, speed: float, leader_speed: float) -> None:
    """It has a pole at zero, and beyond it would pull the other way."""
    config = IdmConfig(braking_max=7.0)
    found = idm_acceleration(config, speed, 20.0, np.array([gap]), np.array([leader_speed]))
    assert found == idm_acceleration(config, speed, 20.0, np.array([GAP_MIN]), np.array([leader_speed])) == -7.0


@pytest.mark.parametrize("state", [TakeoverState.HELD, TakeoverState.HANDBACK])
@pytest.mark.parametrize("gap", GAPS)
@pytest.mark.parametrize("who", [OPPONENT, STRANGER])
def test_one_that_reaches_into_a_slower_one_ahead_brakes_as_hard_as_it_can(
    act, who: int, gap: float, state: TakeoverState
) -> None:
    assert act(who, gap, state) == -COMFORTABLE.braking_max


@pytest.mark.parametrize("who", [OPPONENT, STRANGER])
def test_one_that_stands_in_a_standing_one_ahead_does_not_start(act, who: int) -> None:
    assert act(who, -0.5, own=0.0, speed=0.0) < 0.0


@pytest.mark.parametrize("gap", GAPS[1:])
@pytest.mark.parametrize("who", [OPPONENT, STRANGER])
def test_for_one_that_drives_away_it_brakes_no_harder_than_for_a_courtesy(act, who: int, gap: float) -> None:
    assert act(who, gap, speed=12.0) == -COURTESY_DECELERATION


def test_an_opponent_that_is_just_behind_is_not_waited_for(act) -> None:
    assert act(OPPONENT, -LENGTH - 0.1) > 0.0 > act(OPPONENT, -LENGTH + 0.1)


def test_beside_its_path_an_opponent_that_is_ahead_is_waited_for_and_a_stranger_is_not(act, lane_centres) -> None:
    assert act(OPPONENT, -2.0, y=lane_centres[0]) == -COURTESY_DECELERATION
    assert act(STRANGER, -2.0, y=lane_centres[0]) > 0.0
