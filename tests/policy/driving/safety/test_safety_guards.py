"""The safety layer by single steps: every limit, and the guard."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.driving.safety.comfort import (
    ACCELERATION_MAX,
    BRAKING_JERK_MAX,
    DECELERATION_MAX,
    JERK_MAX,
    LATERAL_ACCELERATION_MAX,
    YAW_ACCELERATION_MAX,
    YAW_RATE_MAX,
)
from litsim_policy.driving.safety.following import (
    BRAKING_MAX,
    IMMINENT,
    LEADER_BRAKING,
    OWN_BRAKING,
    RELAX,
    STANDSTILL_GAP,
    WIDENING,
    following_cap,
)
from litsim_policy.driving.safety.layer import SafeCommands, SafetyConfig, SafetyLayer
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.car_following import LEADER_BRAKES
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import lane_path
from litsim_sim.core.scene import STEP_S, AgentTable

SAFE, LIMITS_ONLY = SafetyConfig(), SafetyConfig(contact=False)
TWIST = YAW_ACCELERATION_MAX * STEP_S  # [rad/s] by which a yaw rate may change in a step


@pytest.fixture(scope="module")
def lane_map(make_scenario, track):
    return make_scenario(track(1, x=100.0)).lane_map


@pytest.fixture(scope="module")
def ask(lane_map, agent_table, lane_centres):
    """What agent 2, at x = 100 in lane 1 at 10 m/s if not told otherwise, may do among others."""

    def ask(config: SafetyConfig, asked: tuple[float, float], *others: dict[str, Any], **mine: float) -> SafeCommands:
        own = {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 10.0} | mine
        table: AgentTable = agent_table(5, own, *({"y": lane_centres[1]} | other for other in others))
        path = lane_path(lane_map, 100.0, lane_centres[1], 0.0)
        scene = DrivingScene.of(lane_map, table, [DrivingTask(2, path, path.points[-1], 0)])
        return SafetyLayer(config).guard(scene, np.array([asked[0]]), np.array([asked[1]]))

    return ask


def command(found: SafeCommands) -> tuple[float, float]:
    return float(found.acceleration[0]), float(found.yaw_rate[0])


# Limits


@given(
    wanted=st.tuples(st.floats(-50.0, 50.0), st.floats(-5.0, 5.0)),
    speed=st.floats(0.0, 40.0),
    before=st.tuples(st.floats(-4.0, 2.4), st.floats(-0.1, 0.1)),
)
def test_limits_hold_whatever_is_asked_for(ask, wanted, speed, before) -> None:
    for config in (SAFE, LIMITS_ONLY):
        acceleration, yaw_rate = command(ask(config, wanted, speed=speed, acceleration=before[0], yaw_rate=before[1]))
        assert -DECELERATION_MAX - 1e-9 <= acceleration <= ACCELERATION_MAX + 1e-9
        jerk = (acceleration - before[0]) / STEP_S
        assert -BRAKING_JERK_MAX - 1e-9 <= jerk <= JERK_MAX + 1e-9
        assert abs(yaw_rate) * speed <= LATERAL_ACCELERATION_MAX + 1e-9 and abs(yaw_rate) <= YAW_RATE_MAX


def test_braking_grows_faster_than_it_is_eased(ask) -> None:
    harder, softer = (command(ask(LIMITS_ONLY, (to, 0.0), speed=12.0, acceleration=-1.0))[0] for to in (-4.0, 2.0))
    assert (harder, softer) == (pytest.approx(-1.837), pytest.approx(-0.587))


def test_what_is_reasonable_is_left_alone(ask) -> None:
    got = ask(SAFE, (0.3, 0.01), speed=12.0)
    assert command(got) == (0.3, 0.01) and not got.guarded.any()


@given(st.floats(-5.0, 5.0), st.floats(-0.1, 0.1), st.floats(0.0, 40.0))
def test_a_turn_begins_and_ends_no_faster_than_is_comfortable(ask, asked: float, before: float, speed: float) -> None:
    _, yaw_rate = command(ask(LIMITS_ONLY, (0.0, asked), speed=speed, yaw_rate=before))
    assert abs(yaw_rate - before) <= TWIST + 1e-9


def test_a_turn_that_a_guard_asks_for_begins_no_faster_either(ask, lane_centres) -> None:
    beside = {"id": 1, "x": 101.0, "y": lane_centres[0], "speed": 10.0}
    found = ask(SAFE, (0.0, 0.0), beside, yaw=0.2)
    assert found.guarded[0] and command(found)[1] == pytest.approx(-TWIST)


@pytest.mark.parametrize(("before", "asked", "then"), [(-8.0, 2.0, -4.05 + 0.413), (5.0, -2.0, 2.40 - 0.837)])
def test_what_was_out_of_bounds_comes_back_from_the_bound(ask, before: float, asked: float, then: float) -> None:
    assert command(ask(LIMITS_ONLY, (asked, 0.0), acceleration=before))[0] == pytest.approx(then)


def test_with_the_guard_off_nothing_is_guarded(ask, lane_centres) -> None:
    beside = {"id": 1, "x": 101.0, "y": lane_centres[0], "speed": 10.0}
    assert ask(SAFE, (0.0, 0.0), beside, yaw=0.15).guarded[0]
    assert command(ask(LIMITS_ONLY, (0.0, 0.0), beside, yaw=0.15)) == (0.0, 0.0)


# What the look ahead takes into account


def test_who_is_cut_in_on_from_behind_drives_on_where_the_road_is_free(ask, lane_centres) -> None:
    """Braking would bring the two together; a leader close ahead leaves nothing else."""
    cutting_in = {"id": 1, "x": 93.6, "y": lane_centres[0] - 0.4, "yaw": -0.12, "speed": 17.0}
    free = ask(SAFE, (0.0, 0.0), cutting_in, speed=15.0)
    behind = ask(SAFE, (0.0, 0.0), cutting_in, {"id": 3, "x": 106.0, "speed": 15.0}, speed=15.0)
    assert command(free)[0] == ACCELERATION_MAX and free.guarded.all()
    assert command(behind)[0] <= 0.0 and behind.guarded.all()


def test_those_behind_do_not_push(ask) -> None:
    """A follower that comes too fast is no reason to do anything."""
    got = ask(SAFE, (0.0, 0.0), {"id": 3, "x": 90.0, "speed": 25.0})
    assert command(got) == (0.0, 0.0) and not got.guarded.any()


def test_who_touches_already_is_no_reason_to_do_anything(ask, lane_centres) -> None:
    """Where boxes overlap, no command of the next second can help it."""
    touching = {"id": 1, "x": 101.0, "y": lane_centres[1] + 1.5, "speed": 10.0}
    assert not ask(SAFE, (0.0, 0.0), touching).guarded.any()


def test_others_that_brake_are_expected_to_go_on(ask, lane_centres) -> None:
    """Without its braking, the one ahead would still be 5 m away after 1.2 s."""
    ahead = {"id": 1, "x": 109.5, "speed": 10.0}
    assert not ask(SAFE, (0.0, 0.0), ahead).guarded.any()
    assert ask(SAFE, (0.0, 0.0), ahead | {"acceleration": -7.0}).guarded[0]


def test_where_nothing_helps_what_touches_last_and_brakes_hardest_is_done(ask) -> None:
    """A wall of standing vehicles 2 m ahead, at 20 m/s."""
    wall = [{"id": 10 + k, "x": 106.5, "y": -2.2 * k, "speed": 0.0} for k in range(9)]
    acceleration, _ = command(ask(SAFE, (0.0, 0.0), *wall, speed=20.0))
    assert acceleration == -SAFE.braking_max


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_who_is_cut_in_on_from_beside_swerves_where_braking_comes_too_late(ask, lane_centres, side: float) -> None:
    """The other, beside it, comes over by 0.7 m/s; both drive at 12 m/s. A third one leaves no room to swerve."""
    y = lane_centres[1] + side * 2.5
    beside = {"id": 1, "x": 101.0, "y": y, "yaw": -side * 0.06, "speed": 12.0}
    found = ask(SAFE, (0.0, 0.0), beside, speed=12.0)
    assert command(found)[1] == pytest.approx(-side * TWIST) and found.guarded[0]
    on_the_other_side = {"id": 3, "x": 100.0, "y": lane_centres[1] - side * 2.3, "speed": 12.0}
    assert command(ask(SAFE, (0.0, 0.0), beside, on_the_other_side, speed=12.0))[1] != command(found)[1]


def test_no_agent_swerves_where_braking_suffices(ask, lane_centres) -> None:
    """The other is ahead of it, and moves over to behind whom it can fall."""
    ahead = {"id": 1, "x": 108.0, "y": lane_centres[0] - 0.8, "yaw": -0.12, "speed": 10.0}
    acceleration, yaw_rate = command(ask(SAFE, (0.0, 0.0), ahead, speed=14.0))
    assert acceleration < 0.0 and yaw_rate == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_the_cap_is_the_least_of_those_behind_each_leader(lane_map, agent_table, lane_centres, seed: int) -> None:
    random = np.random.default_rng(seed)
    x = 100.0 + np.cumsum(3.0 + 12.0 * random.random(8))
    drivers = random.normal([8.0, -1.0], [4.0, 2.0], (8, 2))
    columns = ({"id": k, "x": x[k], "speed": abs(v), "acceleration": a} for k, (v, a) in enumerate(drivers.tolist()))
    table: AgentTable = agent_table(5, *({"y": lane_centres[1]} | agent for agent in columns))
    paths = PathBatch.of([lane_path(lane_map, 90.0, lane_centres[1], 0.0).points] * 6)
    agents = PathFollowers(lane_map, table, np.arange(6), paths)
    found = following_cap(agents)
    for i in range(6):
        caps = [ACCELERATION_MAX]
        for j in range(i + 1, 8):
            gap, speed, lead = table.x[j] - table.x[i] - 4.5, table.speed[i], table.speed[j]
            if gap <= -2.25:
                continue
            room, lag = gap - STANDSTILL_GAP, OWN_BRAKING * STEP_S
            stop = 2.0 * OWN_BRAKING * max(room, 0.0) + lead**2 * OWN_BRAKING / LEADER_BRAKING
            cap = max((np.sqrt(lag**2 + stop) - lag - speed) / RELAX, -WIDENING)
            needed = max(speed - lead, 0.0) ** 2 / (2.0 * max(room, 0.1))
            if (braking := -table.acceleration[j]) > LEADER_BRAKES:
                needed = max(needed, speed**2 / (2.0 * max(room + lead**2 / (2.0 * braking), 0.1)))
            caps.append(min(cap, -needed) if needed > IMMINENT else cap)
        assert found[i] == pytest.approx(max(min(caps), -BRAKING_MAX))
