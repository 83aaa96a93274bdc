"""Policy litsim behind others: distance is kept to whoever leads, by comfortable braking where that is enough."""

import numpy as np
import pytest

from litsim_policy.driving.handback import COMFORTABLE as IDM
from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.safety.comfort import BRAKING_JERK_MAX
from litsim_policy.driving.safety.layer import SafetyConfig
from litsim_policy.driving.yielding_rules import (
    COURTESY_DECELERATION,
    FOLLOWING_TIME,
    LEADER_BRAKING,
    OWN_BRAKING,
    RELAX,
    keep_distance,
)
from litsim_policy.motion.car_following import Leaders, safe_speed
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.takeover import TakeoverTable
from made_agents import takeover

LENGTH = 4.5  # [m]
SAFE = OWN_BRAKING, LEADER_BRAKING, RELAX
STANDS, COMFORTABLE, COURTESY = IDM.standstill_gap, IDM.deceleration, COURTESY_DECELERATION


def kept(wanted: float, speed: float, gap: float, lead: float, braking: float = 0.0, *, leads: bool = True) -> float:
    """What an agent does behind one other, `gap` ahead at speed `lead`."""
    first, acceleration = np.zeros(1, np.int64), np.array([-braking])
    leader = Leaders(np.array([[gap]]), np.array([[lead]]), np.array([[leads]]), first, acceleration)
    own = np.array([wanted]), np.array([speed]), np.array([LENGTH])
    return float(keep_distance(*own, leader, IDM.values)[0])


@pytest.mark.parametrize("wanted", [2.0, 0.0, -1.5, -2.9])
def test_where_comfortable_braking_is_enough_it_drives_as_it_wants(wanted: float) -> None:
    assert kept(wanted, 12.0, 25.0, 9.0) == wanted
    assert kept(wanted, 12.0, 4.0, 9.0, leads=False) == wanted, "whoever is beside the path is no leader"
    assert kept(wanted, 12.0, -0.6 * LENGTH, 9.0) == wanted, "nor who is alongside"


def test_it_does_not_brake_hard_for_what_takes_less() -> None:
    assert kept(-4.0, 12.0, 20.0, 9.0) == -COURTESY
    assert kept(-4.0, 12.0, 20.0, 9.0, leads=False) == -4.0, "behind nobody that is another matter"


@pytest.mark.parametrize("wanted", [2.0, 0.0, -4.0])
def test_it_brakes_constantly_by_what_the_approach_takes(wanted: float) -> None:
    assert kept(wanted, 12.0, STANDS + 9.0, 5.0) == pytest.approx(
        -(7.0**2) / (2 * 9.0) if wanted > -COURTESY else -COURTESY
    )
    gap = STANDS / 4 + 5.0
    assert kept(wanted, 12.0, gap, 5.0) == pytest.approx(-(7.0**2) / (2 * 5.0))
    stops = 5.0**2 / (2 * 4.0)  # a leader who brakes is taken to stop
    assert kept(wanted, 12.0, gap + 7.0, 5.0, braking=4.0) == pytest.approx(-(12.0**2) / (2 * (12.0 + stops)))


def test_nearer_than_vehicles_stand_it_comes_down_to_the_speed_of_the_leader() -> None:
    assert kept(0.5, 0.0, 0.6 * STANDS, 0.0) == 0.0
    assert kept(0.5, 0.2, 0.9 * STANDS, 0.0) == pytest.approx(-0.2 / FOLLOWING_TIME)
    assert kept(-1.0, 6.0, 0.6 * STANDS, 6.0) == -1.0, "it may fall back faster"
    assert kept(0.5, 6.0, 0.6 * STANDS, 6.0) < 0.0, "as fast as a leader who drives is too fast there"


@pytest.mark.parametrize("speed", [1.0, 3.0, 8.0, 15.0])
@pytest.mark.parametrize("wanted", [0.1, -1.0, 2.0])
def test_who_approaches_somebody_who_stands_stops_behind_him_without_braking_hard(speed: float, wanted: float) -> None:
    gap, hardest = 70.0, 0.0
    for _ in range(600):
        acceleration = kept(wanted, speed, gap, 0.0)
        hardest = min(hardest, acceleration)
        after = max(speed + acceleration * STEP_S, 0.0)
        gap, speed = gap - 0.5 * (speed + after) * STEP_S, after
    assert hardest >= -COURTESY
    if wanted > 0.0:
        assert speed < 0.05 and STANDS / 2 < gap < STANDS + 1.0


def test_it_comes_down_comfortably_to_a_speed_that_is_safe_should_the_leader_brake() -> None:
    """As fast as the leader, but so near that it could not stop in time if he braked as hard as he can."""
    own, his, _ = SAFE
    speed, gap = 14.0, STANDS + 1.0
    safe = safe_speed(gap - STANDS, speed, own, his)
    stops = (safe + own * STEP_S) ** 2 / (2.0 * own) - 0.5 * own * STEP_S**2
    assert stops == pytest.approx(gap - STANDS + speed**2 / (2.0 * his)), "that of Krauss, who reacts within a step"
    assert kept(1.0, speed, gap, speed) == pytest.approx(safe - speed)
    assert -COMFORTABLE < safe - speed < 0.0
    assert kept(1.0, speed + 4.0, gap + 35.0, speed) == 1.0, "farther away, that is no question"


@pytest.mark.parametrize("gap", [-0.4 * LENGTH, 0.0])
def test_who_stands_with_somebody_across_its_front_stays_there(gap: float) -> None:
    """The rear of one who crosses may lie behind the front bumper."""
    assert kept(0.3, 0.0, gap, 0.0) == 0.0


def test_of_several_leaders_the_most_demanding_one_counts() -> None:
    gaps, leads = np.array([[30.0, 6.0, 3.0]]), np.array([[True, True, False]])
    leaders = Leaders(gaps, np.array([[9.0, 5.0, 0.0]]), leads, np.zeros(1, np.int64), np.zeros(3))
    own = np.array([0.0]), np.array([12.0]), np.array([LENGTH])
    found = keep_distance(*own, leaders, IDM.values)
    assert found[0] == kept(0.0, 12.0, 6.0, 5.0) < -COMFORTABLE


@pytest.mark.parametrize("rules", [True, False])
def test_who_drives_on_along_its_log_needs_no_guard_behind_somebody_who_stands(
    make_scenario, track, lane_centres, *, rules: bool
) -> None:
    """It brakes as hard as its bounds allow, with the guard off."""
    y = lane_centres[2]
    scenario = make_scenario(track(1, x=110.0, y=y, speed=0.0), track(2, x=100.0, y=y, speed=5.0))
    config = PolicyCConfig(rules=rules, drivers="none", safety=SafetyConfig(contact=False))
    path = np.array([[90.0, y], [300.0, y]])
    held = TakeoverTable(0, (takeover(2, reference_path=path),))
    controls = PolicyC(scenario, config).act(scenario.log.table(0), held)
    assert controls.acceleration[0] == pytest.approx(-BRAKING_JERK_MAX * STEP_S if rules else 0.0)
