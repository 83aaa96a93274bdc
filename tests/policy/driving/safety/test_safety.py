"""The safety layer: whatever a network says, limits hold and the guard prevents; without it it goes wrong."""

import numpy as np
import pytest

from litsim_policy.driving.policy_c import executed, guarded
from litsim_policy.driving.safety.layer import SafetyConfig, SafetyLayer
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.reference_path import logged_path
from litsim_sim.core.scene import ControlSource, EgoCommand, EgoMode
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


@pytest.mark.parametrize(("speed", "gap", "braking"), [(5.0, 4.0, 8.0), (10.0, 15.0, 8.0), (20.0, 8.0, 6.0)])
def test_shipped_policy_never_drives_into_an_ego_that_stops(
    make_scenario, track, drive, speed: float, gap: float, braking: float
) -> None:
    ego, follower = track(1, x=200.0, speed=speed, last=80), track(2, x=195.5 - gap, speed=speed, last=80)
    run = drive(make_scenario(ego, follower), lambda *_: (-braking, 0.0), policy="litsim")
    assert run.world.contacts == {}
