"""Agents alongside whose paths meet: the one behind falls back in time, no harder than drivers do for courtesy."""

import numpy as np
import pytest

from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.safety.layer import SafetyConfig
from litsim_policy.driving.yielding_rules import COURTESY_DECELERATION, FALLING_BACK, SIDE_GAP, make_room
from litsim_policy.motion.path_batch import PathBatch
from litsim_sim.core.takeover import TakeoverTable
from made_agents import agent_arrays, takeover

LENGTH, WIDTH, LANE = 5.0, 2.0, 3.5  # [m]
STRAIGHT = [[-50.0, 0.0], [300.0, 0.0]]


def room(
    ahead: float, *, left: float = LANE, faster: float = 0.0, meets_at: float = 60.0, scene: int = 0
) -> list[float]:
    """What two agents do at 15 m/s, the second of which comes over to the lane of the first at x = `meets_at`."""
    merging = [[-50.0, left], [meets_at - 20.0, left], [meets_at, 0.0], [300.0, 0.0]]
    paths = PathBatch.of([np.array(STRAIGHT), np.array(merging)])
    x, y, rows = np.array([0.0, ahead]), np.array([0.0, left]), np.arange(2)
    agents = agent_arrays(
        2, x=x, y=y, speed=[15.0, 15.0 + faster], length=LENGTH, width=WIDTH, scene=np.array([0, scene])
    )
    return make_room(np.full(2, 0.5), paths, paths.project(rows, x, y).s, agents, rows).tolist()


@pytest.mark.parametrize("left", [LANE, -LANE])
def test_the_one_behind_falls_back_whoever_of_them_merges(left: float) -> None:
    expected = -2.0 * (LENGTH + SIDE_GAP - 1.0) / FALLING_BACK**2
    assert room(1.0, left=left) == pytest.approx([expected, 0.5])
    assert room(-1.0, left=left) == pytest.approx([0.5, expected])


def test_who_falls_back_already_brakes_less_and_nobody_harder_than_for_courtesy() -> None:
    assert room(1.0)[0] < room(1.0, faster=0.5)[0] < 0.0
    assert room(1.0, faster=3.0) == [0.5, 0.5], "it is behind by then"
    assert room(1.0, faster=-9.0, meets_at=20.0)[0] == -COURTESY_DECELERATION


@pytest.mark.parametrize(
    "other",
    [
        {"ahead": 7.0},
        {"ahead": 1.0, "left": 0.9 * WIDTH},
        {"ahead": 1.0, "meets_at": 150.0},
        {"ahead": 1.0, "scene": 1},
    ],
    ids=["is ahead", "is in the lane", "merges later", "is in another scene"],
)
def test_nobody_falls_back_where_none_needs_room(other: dict[str, float]) -> None:
    assert room(**other) == [0.5, 0.5]


@pytest.mark.parametrize("rules", [True, False])
def test_policy_litsim_makes_room(rules: bool, make_scenario, track, lane_centres) -> None:
    """Agent 1 merges half a length ahead of agent 2, which would go on as in its log."""
    scenario = make_scenario(
        track(1, x=101.0, y=lane_centres[1], speed=12.0), track(2, x=100.0, y=lane_centres[2], speed=12.0)
    )
    straight = np.array([[90.0, lane_centres[2]], [130.0, lane_centres[2]], [300.0, lane_centres[2]]])
    merging = np.vstack([[[90.0, lane_centres[1]], [110.0, lane_centres[1]]], straight[1:]])
    held = tuple(takeover(k + 1, reference_path=path) for k, path in enumerate((merging, straight)))
    policy = PolicyC(scenario, PolicyCConfig(rules=rules, safety=SafetyConfig(contact=False)))
    controls = policy.act(scenario.log.table(0), TakeoverTable(0, held))
    assert (controls.acceleration[1] < -0.5) == rules
