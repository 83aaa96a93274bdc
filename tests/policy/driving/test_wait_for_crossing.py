"""Policy litsim before somebody who crosses its path: it brakes in time, no harder than drivers do for courtesy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.safety.layer import SafetyConfig
from litsim_policy.driving.yielding_rules import COURTESY_DECELERATION, EMERGENCIES, PEDALS, wait_for_crossing
from litsim_policy.motion.path_batch import PathBatch
from litsim_sim.core.scene import OBSTACLE_KINDS, Controller, Kind, is_obstacle
from litsim_sim.core.takeover import TakeoverTable
from made_agents import agent_arrays, takeover

CONFIG = PolicyCConfig(safety=SafetyConfig(contact=False))
LENGTH, WIDTH = 5.0, 2.0  # [m]
COURTESY = COURTESY_DECELERATION
PATH = np.array([[-50.0, 0.0], [200.0, 0.0]])


def waits(
    x: float,
    y: float,
    yaw: float,
    speed: float,
    *,
    own: float = 12.0,
    acceleration: float = 0.0,
    turn: float = 0.0,
    wanted: float = 0.5,
    off_log: bool = True,
    kind: Kind = Kind.CAR,
    path: np.ndarray = PATH,
) -> float:
    """What an agent at (0, 0) does, heading along x at speed `own`, with another one at (x, y)."""
    paths = PathBatch.of([path])
    agents = agent_arrays(
        2,
        x=[0.0, x],
        y=[0.0, y],
        yaw=[0.0, yaw],
        speed=[own, speed],
        acceleration=[0.0, acceleration],
        yaw_rate=[0.0, turn],
        length=LENGTH,
        width=WIDTH,
        kind=[Kind.CAR, kind],
        controller=[Controller.POLICY, Controller.POLICY if off_log else Controller.LOG],
    )
    own_s = paths.project(np.zeros(1, np.int64), np.zeros(1), np.zeros(1)).s
    others = (agents.controller != Controller.LOG) | is_obstacle(agents.kind)
    return float(wait_for_crossing(np.array([wanted]), paths, own_s, agents, np.zeros(1, np.int64), others)[0])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_brakes_by_as_little_as_lets_the_other_cross(side: float) -> None:
    """24 m ahead, 2 s away, somebody crosses from either side; the earlier it is over, the less braking it takes."""
    found = [waits(24.0, side * away, -side * np.pi / 2, 5.0) for away in (2.0, 5.0, 7.0, 9.0)]
    pedals = (-PEDALS).tolist()
    assert found[0] == 0.5, "over by then"
    assert all(pedal in pedals for pedal in found[1:])
    assert found == sorted(found, reverse=True) and found[-1] < found[1]


def test_it_brakes_no_harder_than_for_courtesy_and_goes_on_braking_if_it_does() -> None:
    assert waits(15.0, 3.0, -np.pi / 2, 1.0) == -COURTESY
    assert waits(15.0, 3.0, -np.pi / 2, 1.0, wanted=-3.5) == -3.5


def test_it_waits_for_who_turns_left_before_it() -> None:
    """One that comes towards it and only begins to turn: going straight on, it would stay beside the path."""
    oncoming = {"x": 30.0, "y": 3.5, "yaw": np.pi, "speed": 6.0}
    assert waits(**oncoming, own=8.0) == 0.5
    assert waits(**oncoming, own=8.0, turn=0.6) < -0.5


def test_it_counts_with_who_speeds_up_and_with_who_stops() -> None:
    late = {"x": 24.0, "y": 9.0, "yaw": -np.pi / 2}
    assert waits(**late, speed=1.0) == 0.5
    assert waits(**late, speed=1.0, acceleration=3.0) < -0.5
    assert waits(**late, speed=6.0) < -0.5
    assert waits(**late, speed=6.0, acceleration=-6.0) == 0.5


@pytest.mark.parametrize(
    "other",
    [
        {"x": 24.0, "y": 7.0, "yaw": -np.pi / 2, "speed": 5.0, "off_log": False},
        {"x": 24.0, "y": 7.0, "yaw": -0.5, "speed": 5.0},
        {"x": 24.0, "y": 7.0, "yaw": np.pi / 2, "speed": 5.0},
        {"x": 50.0, "y": 7.0, "yaw": -np.pi / 2, "speed": 3.0},
        {"x": -3.0, "y": 7.0, "yaw": -np.pi / 2, "speed": 5.0},
        {"x": 0.0, "y": 9.0, "yaw": -np.pi / 2, "speed": 8.0, "own": 2.0},
    ],
    ids=["on its log", "same way", "goes away", "later", "behind", "runs into its side"],
)
def test_it_waits_for_nobody_else(other: dict[str, float]) -> None:
    assert waits(**other) == 0.5


@pytest.mark.parametrize("kind", OBSTACLE_KINDS)
def test_it_waits_for_walkers_and_cyclists_on_their_logs(kind: Kind) -> None:
    """Vehicles on their logs are left to the conflict stage, which never takes over walkers and cyclists."""
    crosses = {"x": 24.0, "y": 5.0, "yaw": -np.pi / 2, "speed": 3.0, "off_log": False}
    assert waits(**crosses) == 0.5
    assert waits(**crosses, kind=kind) < -0.5


def test_it_brakes_as_hard_as_it_can_for_who_steps_onto_the_road() -> None:
    assert waits(12.0, 3.0, -np.pi / 2, 2.0, off_log=False, kind=Kind.PEDESTRIAN) == -max(EMERGENCIES)


def test_it_lets_a_cyclist_beside_it_go_straight_on_before_it_turns() -> None:
    turns = np.array([[-50.0, 0.0], [5.0, 0.0], [12.0, -7.0], [12.0, -60.0]])
    beside = {"x": 2.0, "y": -2.5, "yaw": 0.0, "speed": 5.0, "own": 5.0, "kind": Kind.BICYCLE, "off_log": False}
    assert waits(**beside) == 0.5
    assert waits(**beside, path=turns) < 0.5


def test_it_passes_who_stands_beside_its_path() -> None:
    kerb = {"x": 20.0, "y": 2.3, "yaw": -np.pi / 2, "off_log": False, "kind": Kind.PEDESTRIAN}
    assert waits(**kerb, speed=0.0) == 0.5
    assert waits(**kerb, speed=1.4) < 0.5


def test_only_where_its_path_leads_counts() -> None:
    """The same two, of whom the agent turns away before they would meet."""
    bends = np.array([[-50.0, 0.0], [5.0, 0.0], [15.0, -30.0], [40.0, -150.0]])
    crosses = {"x": 24.0, "y": 7.0, "yaw": -np.pi / 2, "speed": 5.0}
    assert waits(**crosses) < 0.5
    assert waits(**crosses, path=bends) == 0.5


def test_policy_litsim_waits_for_the_ego_that_crosses(make_scenario, track, placed, lane_centres) -> None:
    """The ego comes out of its lane across the road; the network of agent 2 asks for nothing."""
    y = lane_centres[2]
    scenario = make_scenario(track(1, x=130.0, y=lane_centres[0]), track(2, x=100.0, y=y, speed=12.0))
    away = np.sign(lane_centres[0] - y)
    ego = {"x": 124.0, "y": y + 7.0 * away, "yaw": -away * np.pi / 2, "speed": 5.0, "controller": Controller.EGO}
    table = placed(scenario.log.table(0), 1, **ego)
    says = SimpleNamespace(observation=ObservationConfig(), mean=lambda seen: np.zeros((len(seen), 3)))
    path = np.array([[90.0, y], [300.0, y]])
    held = TakeoverTable(0, (takeover(2, reference_path=path),))

    def does(config: PolicyCConfig) -> float:
        policy = PolicyC(scenario, config, says)
        return float(policy.act(table, held).acceleration[0])

    assert does(CONFIG) < -0.5
    assert does(replace(CONFIG, rules=False)) == 0.0
