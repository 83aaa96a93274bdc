"""Policy litsim beside somebody who comes over: it drops back in time, no harder than drivers do for courtesy."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from agent_arrays import agent_arrays
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.yielding_rules import COURTESY_DECELERATION, SIDE_GAP, make_room
from litsim_sim.core.takeover import TakeoverTable
from takeovers import takeover

CONFIG = PolicyCConfig(guards=False)
LENGTH, WIDTH, LANE = 5.0, 2.0, 3.5  # [m]


def room(
    ahead: float,
    over: float,
    *,
    faster: float = 0.0,
    left: float = LANE,
    braking: float = 0.0,
    wanted: float = 0.5,
    own_turn: float = 0.0,
    lane: float = 0.0,
) -> float:
    """What an agent does in a lane that heads `lane`, at 15 m/s, beside one that comes over at `over` [m/s]."""
    speed = np.array([15.0, np.hypot(15.0 + faster, over)])
    yaw = lane + np.array([own_turn, np.arctan2(-np.sign(left) * over, 15.0 + faster)])
    cos, sin = np.cos(lane), np.sin(lane)
    x, y = np.array([0.0, ahead * cos - left * sin]), np.array([0.0, ahead * sin + left * cos])
    motion = {"x": x, "y": y, "yaw": yaw, "speed": speed, "acceleration": [0.0, -braking]}
    agents = agent_arrays(2, **motion, length=LENGTH, width=WIDTH)
    return float(make_room(np.array([wanted]), agents, np.zeros(1, np.int64), np.array([lane]), CONFIG.room_horizon)[0])


@pytest.mark.parametrize("left", [LANE, -LANE])
@pytest.mark.parametrize("lane", [0.0, 2.0])
def test_it_brakes_by_what_it_takes_to_be_behind_by_then(left: float, lane: float) -> None:
    time = (LANE - WIDTH) / 1.0
    expected = -2.0 * (LENGTH + SIDE_GAP - 4.0) / time**2
    assert expected > -COURTESY_DECELERATION
    assert room(4.0, 1.0, left=left, lane=lane) == pytest.approx(expected)
    assert room(4.0, 1.0, left=left, lane=lane, wanted=-2.9) == -2.9, "who brakes harder already goes on"
    assert room(3.0, 1.0, faster=1.0 / time, left=left, lane=lane) == pytest.approx(expected), "it is on its way ahead"
    slows = 0.5 * 0.8 * time**2
    assert room(4.0 + slows, 1.0, braking=0.8, left=left, lane=lane) == pytest.approx(expected)
    turn = np.arcsin(np.sign(left) * 0.5 / 15.0)
    nearer = room(4.0, 0.5, left=left, lane=lane, own_turn=turn)
    assert nearer == pytest.approx(expected, abs=0.05), "both come nearer"


def test_it_brakes_no_harder_than_for_courtesy() -> None:
    assert room(1.0, 2.0) == -COURTESY_DECELERATION


@pytest.mark.parametrize(
    "other",
    [
        {"ahead": 1.0, "over": 0.0},
        {"ahead": 1.0, "over": -1.0},
        {"ahead": 1.0, "over": 0.5},
        {"ahead": -0.5, "over": 1.0},
        {"ahead": 7.0, "over": 1.0},
        {"ahead": 4.0, "over": 1.0, "faster": 2.0},
        {"ahead": 1.0, "over": 1.0, "left": 0.9 * WIDTH},
    ],
    ids=["goes straight on", "goes away", "takes longer", "is behind", "is ahead", "will be ahead", "is in the lane"],
)
def test_it_makes_no_room_where_none_is_needed(other: dict[str, float]) -> None:
    assert room(**other) == 0.5


def test_policy_litsim_makes_room(make_scenario, track, lane_centres) -> None:
    """Agent 1 moves over from the left, half a length ahead of agent 2, whose network asks for nothing."""
    beside = track(1, x=103.0, y=lane_centres[1], speed=12.0, yaw=np.sign(lane_centres[2] - lane_centres[1]) * 0.08)
    scenario = make_scenario(beside, track(2, x=100.0, y=lane_centres[2], speed=12.0))
    says = SimpleNamespace(observation=ObservationConfig(), mean=lambda seen: np.zeros((len(seen), 3)))
    path = np.array([[90.0, lane_centres[2]], [300.0, lane_centres[2]]])
    table, held = scenario.log.table(0), TakeoverTable(0, (takeover(2, reference_path=path),))

    def does(config: PolicyCConfig) -> float:
        policy = PolicyC(scenario, says, config)
        return float(policy.act(table, held).acceleration[0])

    assert does(CONFIG) < -0.5
    assert does(replace(CONFIG, room_horizon=0.0)) > does(CONFIG) + 0.5
