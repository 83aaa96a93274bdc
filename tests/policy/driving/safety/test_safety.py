"""The safety layer: whatever a network says, limits hold and the guard prevents; without it it goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.driving.policy_c import executed, guarded
from litsim_policy.driving.safety.comfort import (
    ACCELERATION_MAX,
    BRAKING_JERK_MAX,
    DECELERATION_MAX,
    JERK_MAX,
    LATERAL_ACCELERATION_MAX,
    YAW_RATE_MAX,
)
from litsim_policy.driving.safety.layer import SafeCommands, SafetyConfig, SafetyLayer
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.reference_path import lane_path, logged_path
from litsim_sim.core.scene import STEP_S, AgentTable, ControlSource, EgoCommand, EgoMode
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.world import World

SAFE, LIMITS_ONLY = SafetyConfig(), SafetyConfig(contact=False)


def simulate(
    scenario: Scenario, config: SafetyConfig, longitudinal: float, lateral: float = 0.0
) -> tuple[World, set[int]]:
    """Agent 2 driven by the same actions in (-1, 1) at every step, everybody else on the log; and whose commands there
    were."""
    world, layer = World(scenario), SafetyLayer(config)
    path, action = logged_path(scenario.log, scenario.lane_map, 2), np.array([[longitudinal, lateral, lateral]])
    table, sources = world.reset(), set[int]()
    for _ in range(60):
        task = DrivingTask(2, path, path.points[-1], table.step + 30)
        scene = DrivingScene.of(scenario.lane_map, table, [task])
        controls = guarded(scene, *executed(scene, action), layer)
        sources |= set(controls.source.tolist())
        table = world.step(controls, EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG))
    return world, sources


def asked(
    scenario: Scenario, table: AgentTable, acceleration: float, yaw_rate: float, config: SafetyConfig = SAFE
) -> SafeCommands:
    """Commands of agent 2 along its lane."""
    row = table.row(2)
    path = lane_path(scenario.lane_map, table.x[row], table.y[row], table.yaw[row])
    scene = DrivingScene.of(scenario.lane_map, table, [DrivingTask(2, path, path.points[-1], 0)])
    return SafetyLayer(config).guard(scene, np.array([acceleration]), np.array([yaw_rate]))


@pytest.fixture(scope="module")
def alone(make_scenario, track) -> Scenario:
    return make_scenario(track(1, x=400.0), track(2, x=60.0, last=90))


@given(
    wanted=st.tuples(st.floats(-50.0, 50.0), st.floats(-5.0, 5.0)),
    speed=st.floats(0.0, 40.0),
    before=st.tuples(st.floats(-4.0, 2.4), st.floats(-0.1, 0.1)),
)
def test_limits_hold_whatever_is_asked_for(alone, agent_table, lane_centres, wanted, speed, before) -> None:
    table = agent_table(5, {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": speed, "acceleration": before[0]})
    table = replace(table, yaw_rate=np.array([before[1]]))
    for config in (SAFE, LIMITS_ONLY):
        got = asked(alone, table, *wanted, config)
        acceleration, yaw_rate = float(got.acceleration[0]), float(got.yaw_rate[0])
        assert -DECELERATION_MAX - 1e-9 <= acceleration <= ACCELERATION_MAX + 1e-9
        jerk = (acceleration - before[0]) / STEP_S
        assert -BRAKING_JERK_MAX - 1e-9 <= jerk <= JERK_MAX + 1e-9
        assert abs(yaw_rate) * speed <= LATERAL_ACCELERATION_MAX + 1e-9 and abs(yaw_rate) <= YAW_RATE_MAX


def test_braking_grows_faster_than_it_is_eased(alone, agent_table, lane_centres) -> None:
    table = agent_table(5, {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 12.0, "acceleration": -1.0})
    harder, softer = (asked(alone, table, wanted, 0.0, LIMITS_ONLY).acceleration[0] for wanted in (-4.0, 2.0))
    assert (harder, softer) == (pytest.approx(-1.837), pytest.approx(-0.587))


def test_what_is_reasonable_is_left_alone(alone, agent_table, lane_centres) -> None:
    table = agent_table(5, {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 12.0})
    got = asked(alone, table, 0.3, 0.01)
    assert (float(got.acceleration[0]), float(got.yaw_rate[0])) == (0.3, 0.01)
    assert not got.limited.any() and not got.guarded.any()


@pytest.mark.parametrize(("speed", "gap"), [(8.0, 4.0), (8.0, 25.0), (15.0, 6.0)])
def test_full_throttle_does_not_reach_who_brakes_ahead(make_scenario, track, speed: float, gap: float) -> None:
    braking = {"speed": speed, "acceleration": -speed / 6.05}
    leader = track(1, x=100.0 + 4.5 + gap, **braking)
    scenario = make_scenario(leader, track(2, x=100.0, speed=speed))
    world, sources = simulate(scenario, SAFE, 0.99)
    assert world.contacts == {} and ControlSource.GUARDED in sources
    unguarded, sources = simulate(scenario, LIMITS_ONLY, 0.99)
    assert (1, 2) in unguarded.contacts and sources == {ControlSource.POLICY}


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_does_not_steer_into_who_is_beside(make_scenario, track, lane_centres, side: float) -> None:
    beside = track(1, x=102.0, y=lane_centres[2] + side * 3.66)
    scenario = make_scenario(beside, track(2, x=100.0, y=lane_centres[2]))
    world, sources = simulate(scenario, SAFE, 0.0, side * 0.3)
    assert world.contacts == {} and ControlSource.GUARDED in sources
    assert (1, 2) in simulate(scenario, LIMITS_ONLY, 0.0, side * 0.3)[0].contacts


def test_who_is_cut_in_on_from_behind_drives_on_where_the_road_is_free(alone, agent_table, lane_centres) -> None:
    """Braking would bring the two together; a leader close ahead leaves nothing else."""
    mine = {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 15.0}
    cutting_in = {"id": 1, "x": 93.6, "y": lane_centres[0] - 0.4, "yaw": -0.12, "speed": 17.0}
    leader = {"id": 3, "x": 106.0, "y": lane_centres[1], "speed": 15.0}
    table, blocked = agent_table(5, cutting_in, mine), agent_table(5, cutting_in, mine, leader)
    free, behind = (asked(alone, t, 0.0, 0.0) for t in (table, blocked))
    assert float(free.acceleration[0]) == ACCELERATION_MAX and free.guarded.all()
    assert float(behind.acceleration[0]) <= 0.0 and behind.guarded.all()


def test_those_behind_do_not_push(alone, agent_table, lane_centres) -> None:
    """A follower that comes too fast is no reason to do anything."""
    table = agent_table(
        5,
        {"id": 2, "x": 100.0, "y": lane_centres[1], "speed": 10.0},
        {"id": 3, "x": 90.0, "y": lane_centres[1], "speed": 25.0},
    )
    got = asked(alone, table, 0.0, 0.0)
    assert not got.limited.any() and not got.guarded.any()


@pytest.mark.parametrize(("speed", "gap", "braking"), [(5.0, 4.0, 8.0), (10.0, 15.0, 8.0), (20.0, 8.0, 6.0)])
def test_shipped_policy_never_drives_into_an_ego_that_stops(
    make_scenario, track, drive, speed: float, gap: float, braking: float
) -> None:
    ego, follower = track(1, x=200.0, speed=speed, last=80), track(2, x=195.5 - gap, speed=speed, last=80)
    run = drive(make_scenario(ego, follower), lambda *_: (-braking, 0.0), policy="litsim")
    assert run.world.contacts == {}
