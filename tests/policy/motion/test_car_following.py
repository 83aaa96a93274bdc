"""The Intelligent Driver Model against its closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.motion.car_following import GAP_MIN, IdmConfig, following, headway_kept, idm_acceleration

IDM = IdmConfig(desired_speed=20.0, headway=1.0, standstill_gap=2.0, acceleration=1.5, deceleration=2.0)
NOBODY = np.empty(0)


def behind(speed: float, gap: float, leader_speed: float, config: IdmConfig = IDM) -> float:
    return idm_acceleration(config, speed, config.desired_speed, np.array([gap]), np.array([leader_speed]))


def test_on_a_free_road_the_desired_speed_is_reached_and_kept() -> None:
    assert idm_acceleration(IDM, 0.0, 20.0, NOBODY, NOBODY) == pytest.approx(IDM.acceleration)
    assert idm_acceleration(IDM, 20.0, 20.0, NOBODY, NOBODY) == pytest.approx(0.0)
    assert idm_acceleration(IDM, 10.0, 20.0, NOBODY, NOBODY) == pytest.approx(1.5 * (1 - 0.5**4))
    assert idm_acceleration(IDM, 25.0, 20.0, NOBODY, NOBODY) < 0.0


@given(st.floats(0.0, 19.0))
def test_at_the_equilibrium_gap_nobody_accelerates(speed: float) -> None:
    gap = (IDM.standstill_gap + speed * IDM.headway) / np.sqrt(1.0 - (speed / IDM.desired_speed) ** 4)
    assert behind(speed, gap, speed) == pytest.approx(0.0, abs=1e-9)
    assert behind(speed, 1.1 * gap, speed) > 0.0 > behind(speed, 0.9 * gap, speed)


@pytest.mark.parametrize("leader_speed", [0.0, 5.0, 12.0])
def test_a_follower_settles_at_the_equilibrium_gap_without_touching(leader_speed: float) -> None:
    speed, gap = 15.0, 80.0
    gaps = []
    for _ in range(3000):
        acceleration = behind(speed, gap, leader_speed)
        faster = max(0.0, speed + 0.1 * acceleration)
        gap += 0.1 * (leader_speed - 0.5 * (speed + faster))
        speed = faster
        gaps.append(gap)
    assert min(gaps) > 1.0
    wanted = (IDM.standstill_gap + leader_speed * IDM.headway) / np.sqrt(1.0 - (leader_speed / 20.0) ** 4)
    assert gap == pytest.approx(wanted, abs=0.15) and speed == pytest.approx(leader_speed, abs=0.02)


def test_someone_too_close_is_braked_for_as_hard_as_the_cap_allows() -> None:
    assert behind(20.0, 1.0, 0.0) == -8.0
    assert behind(20.0, 1.0, 0.0, IdmConfig(braking_max=5.0)) == -5.0


@given(st.integers(0, 2**32))
def test_accelerations_of_many_are_the_formula_with_arrays(seed: int) -> None:
    random = np.random.default_rng(seed)
    speed, desired = random.uniform(0.0, 30.0, (2, 7))
    gap, leader_speed = random.uniform(-5.0, 80.0, (7, 9)), random.uniform(-5.0, 30.0, (7, 9))
    leads = random.random((7, 9)) < 0.4
    closing = speed[:, None] * (speed[:, None] - leader_speed) / (2.0 * np.sqrt(IDM.acceleration * IDM.deceleration))
    wanted = IDM.standstill_gap + np.maximum(0.0, speed[:, None] * IDM.headway + closing)
    interaction = np.where(leads, IDM.acceleration * (wanted / np.maximum(gap, GAP_MIN)) ** 2, 0.0).max(axis=1)
    free = IDM.acceleration * (1.0 - np.float_power(speed / np.maximum(desired, 0.1), 4))
    expected = np.clip(free - interaction, -IDM.braking_max, IDM.acceleration)
    assert (idm_acceleration(IDM, speed, desired, gap, leader_speed, leads) == expected).all()


@given(st.floats(2.0, 30.0), st.floats(2.0, 80.0), st.floats(0.0, 30.0))
def test_following_is_the_model_on_a_free_road_unless_that_brakes_more_than_it_takes(
    speed: float, gap: float, lead: float
) -> None:
    config = IdmConfig(desired_speed=1e6)
    plain = float(idm_acceleration(config, speed, 1e6, np.array([gap]), np.array([lead])))
    found = following(speed, gap, lead, 0.0, config.values)
    enough = -(max(speed - lead, 0.0) ** 2) / (2.0 * gap)
    assert found == pytest.approx(plain) if plain >= enough else plain <= found + 1e-9 and found < enough


def test_following_brakes_for_a_leader_that_brakes() -> None:
    model = IdmConfig().values
    assert following(15.0, 3.0, 15.0, -4.0, model) < following(15.0, 3.0, 15.0, 0.0, model) - 1.0


@given(st.floats(3.0, 30.0), st.floats(-3.0, 3.0), st.floats(0.3, 2.5))
def test_a_headway_comes_back_from_what_the_driver_does(speed: float, closing: float, headway: float) -> None:
    config, lead = IdmConfig(headway=headway), speed - max(closing, -2.0 * headway)
    gap = np.array([config.standstill_gap + 1.5 * headway * speed])
    acceleration = float(idm_acceleration(config, speed, 1e6, gap, np.array([lead])))
    if -2.0 < acceleration < 0.8 * config.acceleration:
        assert headway_kept(speed, acceleration, gap[0], lead, config.values) == pytest.approx(headway, abs=1e-6)
