"""The safety layer by single steps: every limit and every guard alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.driving.safety.comfort import ACCELERATION_MAX, YAW_ACCELERATION_MAX
from litsim_policy.driving.safety.config import SafetyConfig
from litsim_policy.driving.safety.following import WIDENING, following_cap
from litsim_policy.driving.safety.layer import GUARDS, SafeCommands, SafetyLayer
from litsim_policy.driving.task import DrivingTask
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import lane_path
from litsim_sim.core.scene import STEP_S, AgentTable

SAFE = SafetyConfig()
SWITCHES = GUARDS[1:]
TWIST = YAW_ACCELERATION_MAX * STEP_S  # [rad/s] by which a yaw rate may change in a step


def only(*on: str, **config: float) -> SafetyConfig:
    """With these guards and no others."""
    return SafetyConfig(**{name: name in on for name in SWITCHES}, **config)


@pytest.fixture(scope="module")
def lane_map(make_scenario, track):
    return make_scenario(track(1, x=100.0)).lane_map


@pytest.fixture(scope="module")
def ask(lane_map, agent_table, lane_centres):
    """What agent 2, at x = 100 in lane 1 at 10 m/s if not told otherwise, may do among others."""

    def ask(
        config: SafetyConfig,
        asked: tuple[float, float],
        *others: dict[str, Any],
        layer: SafetyLayer | None = None,
        **mine: float,
    ) -> SafeCommands:
        own = {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 10.0} | mine
        table: AgentTable = agent_table(5, own, *({"y": lane_centres[1]} | other for other in others))
        path = lane_path(lane_map, 100.0, lane_centres[1], 0.0)
        task = DrivingTask(2, path, path.points[-1], 0)
        layer = layer or SafetyLayer(lane_map, config)
        return layer.apply(table, [task], np.array([asked[0]]), np.array([asked[1]]))

    return ask


def command(found: SafeCommands) -> tuple[float, float]:
    return float(found.acceleration[0]), float(found.yaw_rate[0])


# Limits


@given(st.floats(-5.0, 5.0), st.floats(-0.1, 0.1), st.floats(0.0, 40.0))
def test_a_turn_begins_and_ends_no_faster_than_is_comfortable(ask, asked: float, before: float, speed: float) -> None:
    _, yaw_rate = command(ask(only(), (0.0, asked), speed=speed, yaw_rate=before))
    assert abs(yaw_rate - before) <= TWIST + 1e-9


def test_a_turn_that_a_guard_asks_for_begins_no_faster_either(ask, lane_centres) -> None:
    beside = {"id": 1, "x": 101.0, "y": lane_centres[0], "speed": 10.0}
    found = ask(SAFE, (0.0, 0.0), beside, yaw=0.2)
    assert found.changed[0, GUARDS.index("contact")]
    assert command(found)[1] == pytest.approx(-TWIST)


@pytest.mark.parametrize(("before", "asked", "then"), [(-8.0, 2.0, -4.05 + 0.413), (5.0, -2.0, 2.40 - 0.837)])
def test_what_was_out_of_bounds_comes_back_from_the_bound(ask, before: float, asked: float, then: float) -> None:
    assert command(ask(only(), (asked, 0.0), acceleration=before))[0] == pytest.approx(then)


def test_limits_are_counted_whatever_is_switched_off(ask, lane_map) -> None:
    layer = SafetyLayer(lane_map, only())
    for k in (1, 2):
        found = ask(only(), (-50.0, 0.0), layer=layer)
        assert found.changed[0].tolist() == [True, False, False, False] and not found.guarded[0]
        assert layer.interventions == {"limits": k, "following": 0, "contact": 0, "road": 0} and layer.agent_steps == k


# Guards, each alone in each scene


def scene(name: str, lane_centres: tuple[float, ...]) -> tuple[tuple[float, float], list[dict], dict[str, float]]:
    """What is asked for, the others, and agent 2, where the guard `name` and no other is needed."""
    return {
        # 33 m behind one that stands, at 20 m/s: not to be touched within the look ahead, but no more time to lose
        "following": ((0.0, 0.0), [{"id": 1, "x": 137.5, "speed": 0.0}], {"speed": 20.0}),
        "contact": ((0.0, 0.0), [{"id": 1, "x": 101.0, "y": lane_centres[0], "speed": 10.0}], {"yaw": 0.15}),
        "road": ((0.0, 0.0), [], {"y": lane_centres[0] + 0.3, "yaw": 0.15}),
    }[name]


@pytest.mark.parametrize("needed", SWITCHES)
@pytest.mark.parametrize("on", SWITCHES)
def test_a_guard_does_what_it_is_for_and_nothing_else(ask, lane_centres, needed: str, on: str) -> None:
    asked, others, mine = scene(needed, lane_centres)
    found = ask(only(on), asked, *others, **mine)
    assert [name for name, changed in zip(GUARDS, found.changed[0], strict=True) if changed] == [on] * (on == needed)
    assert (command(found) != asked) == (on == needed) == bool(found.guarded[0])


@pytest.mark.parametrize("needed", SWITCHES)
def test_interventions_are_counted_by_guard(ask, lane_map, lane_centres, needed: str) -> None:
    asked, others, mine = scene(needed, lane_centres)
    layer = SafetyLayer(lane_map, only(needed))
    for _ in range(3):
        ask(only(needed), asked, *others, layer=layer, **mine)
    assert layer.interventions == dict.fromkeys(GUARDS, 0) | {needed: 3} and layer.agent_steps == 3


def test_the_road_alone_is_kept_to_whoever_is_beside(ask, lane_centres) -> None:
    """Turning back touches the one beside; with that guard off, it is the least change all the same."""
    mine = {"y": -1.3, "yaw": 0.05}
    beside = {"id": 1, "x": 100.0, "y": -3.62, "speed": 10.0}
    acceleration, yaw_rate = command(ask(only("road"), (0.0, 0.0), beside, **mine))
    assert (acceleration, yaw_rate) == (0.0, pytest.approx(-TWIST))
    assert command(ask(only("road", "contact"), (0.0, 0.0), beside, **mine)) != (acceleration, yaw_rate)


# Following


@pytest.mark.parametrize(
    ("leader", "braking"),
    [
        # 31 m behind a bumper, of which 1 m is kept, at 20 m/s: braking later would do, but not as gently
        ({"x": 135.5, "speed": 0.0}, 20.0**2 / (2.0 * 30.0)),
        # 41 m: 5 m/s2 would do; the network may brake by 4 itself, and there is time for what that lacks
        ({"x": 145.5, "speed": 0.0}, None),
        # 21 m; the leader, at 10 m/s, stops within 12.5 m
        ({"x": 125.5, "speed": 10.0, "acceleration": -4.0}, 20.0**2 / (2.0 * 32.5)),
        # 31 m; the leader, at 10 m/s, goes on: 1.7 m/s2 would do, and there is time
        ({"x": 135.5, "speed": 10.0}, None),
    ],
)
def test_what_an_approach_needs_is_braked_for_at_once_where_it_is_much(ask, leader: dict, braking) -> None:
    found = ask(only("following"), (0.0, 0.0), {"id": 1} | leader, speed=20.0)
    assert found.guarded[0] == (braking is not None)
    assert command(found)[0] == pytest.approx(-(braking or 0.0))


@pytest.mark.parametrize(("gap", "leader_speed", "braking"), [(6.0, 15.0, 2.5), (6.0, 12.0, 8.0**2 / (2.0 * 5.0))])
def test_a_gap_that_is_merely_too_short_is_widened_gently(ask, gap: float, leader_speed: float, braking: float) -> None:
    """At 20 m/s. By the safe speed alone it would brake by 3.8 and 6.2 m/s2; the second is an emergency."""
    found = ask(only("following"), (0.0, 0.0), {"id": 1, "x": 104.5 + gap, "speed": leader_speed}, speed=20.0)
    assert found.guarded[0] and command(found)[0] == pytest.approx(-braking)


@pytest.mark.parametrize(("gap", "braked"), [(-0.3, True), (-2.0, True), (-2.6, False)])
def test_one_that_reaches_into_who_is_ahead_brakes_as_hard_as_it_can(ask, gap: float, *, braked: bool) -> None:
    """Up to where they are side by side rather than one behind the other."""
    found = ask(only("following"), (0.0, 0.0), {"id": 1, "x": 104.5 + gap, "speed": 4.0})
    assert command(found)[0] == (-SAFE.braking_max if braked else 0.0)


# What the look ahead takes into account


def test_who_touches_already_is_no_reason_to_do_anything(ask, lane_centres) -> None:
    """Where boxes overlap, no command of the next second can help it."""
    touching = {"id": 1, "x": 101.0, "y": lane_centres[1] + 1.5, "speed": 10.0}
    assert not ask(only("contact"), (0.0, 0.0), touching).changed.any()


def test_others_that_brake_are_expected_to_go_on(ask, lane_centres) -> None:
    """Without its braking, the one ahead would still be 5 m away after 1.2 s."""
    ahead = {"id": 1, "x": 109.5, "speed": 10.0}
    assert not ask(only("contact"), (0.0, 0.0), ahead).changed.any()
    assert ask(only("contact"), (0.0, 0.0), ahead | {"acceleration": -7.0}).changed[0, GUARDS.index("contact")]


def test_where_nothing_helps_what_touches_last_and_brakes_hardest_is_done(ask) -> None:
    """A wall of standing vehicles 2 m ahead, at 20 m/s."""
    wall = [{"id": 10 + k, "x": 106.5, "y": -2.2 * k, "speed": 0.0} for k in range(9)]
    acceleration, _ = command(ask(only("contact"), (0.0, 0.0), *wall, speed=20.0))
    assert acceleration == -SAFE.braking_max


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_who_is_cut_in_on_from_beside_swerves_where_braking_comes_too_late(ask, lane_centres, side: float) -> None:
    """The other, beside it, comes over by 0.7 m/s; both drive at 12 m/s. A third one leaves no room to swerve."""
    y = lane_centres[1] + side * 2.5
    beside = {"id": 1, "x": 101.0, "y": y, "yaw": -side * 0.06, "speed": 12.0}
    found = ask(only("contact"), (0.0, 0.0), beside, speed=12.0)
    assert command(found)[1] == pytest.approx(-side * TWIST) and found.changed[0, GUARDS.index("contact")]
    on_the_other_side = {"id": 3, "x": 100.0, "y": lane_centres[1] - side * 2.3, "speed": 12.0}
    assert command(ask(only("contact"), (0.0, 0.0), beside, on_the_other_side, speed=12.0))[1] != command(found)[1]


def test_no_agent_swerves_where_braking_suffices(ask, lane_centres) -> None:
    """The other is ahead of it, and moves over to behind whom it can fall."""
    ahead = {"id": 1, "x": 108.0, "y": lane_centres[0] - 0.8, "yaw": -0.12, "speed": 10.0}
    acceleration, yaw_rate = command(ask(only("contact"), (0.0, 0.0), ahead, speed=14.0))
    assert acceleration < 0.0 and yaw_rate == pytest.approx(0.0, abs=1e-3)


def test_who_is_off_the_road_already_may_come_back(ask, lane_centres) -> None:
    """No command of the next second brings it back, and none is worse than the one that is asked for."""
    assert command(ask(only("road"), (0.3, 0.0), y=lane_centres[0] + 6.0)) == (0.3, 0.0)


@pytest.mark.parametrize("seed", range(8))
def test_the_cap_is_the_least_of_those_behind_each_leader(lane_map, agent_table, lane_centres, seed: int) -> None:
    random, config = np.random.default_rng(seed), SafetyConfig(relax=0.7, leader_brakes=0.05)
    x = 100.0 + np.cumsum(3.0 + 12.0 * random.random(8))
    drivers = random.normal([8.0, -1.0], [4.0, 2.0], (8, 2))
    columns = ({"id": k, "x": x[k], "speed": abs(v), "acceleration": a} for k, (v, a) in enumerate(drivers.tolist()))
    table: AgentTable = agent_table(5, *({"y": lane_centres[1]} | agent for agent in columns))
    paths = PathBatch([lane_path(lane_map, 90.0, lane_centres[1], 0.0).points] * 6)
    agents = PathFollowers(lane_map, table, np.arange(6), paths)
    found = following_cap(config, agents)
    for i in range(6):
        caps = [ACCELERATION_MAX]
        for j in range(i + 1, 8):
            gap, speed, lead = table.x[j] - table.x[i] - 4.5, table.speed[i], table.speed[j]
            if gap <= -2.25:
                continue
            room, lag = gap - config.standstill_gap, config.own_braking * STEP_S
            stop = 2.0 * config.own_braking * max(room, 0.0) + lead**2 * config.own_braking / config.leader_braking
            cap = max((np.sqrt(lag**2 + stop) - lag - speed) / config.relax, -WIDENING)
            needed = max(speed - lead, 0.0) ** 2 / (2.0 * max(room, 0.1))
            braking = max(-table.acceleration[j], 0.1)
            needed = max(needed, speed**2 / (2.0 * max(room + lead**2 / (2.0 * braking), 0.1)))
            caps.append(min(cap, -needed) if needed > config.imminent else cap)
        assert found[i] == pytest.approx(max(min(caps), -config.braking_max))
