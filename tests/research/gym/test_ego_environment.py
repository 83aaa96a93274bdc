"""The environment `litsim/Ego-v0`: Gymnasium's contract, the ends of an episode, and its reward."""

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from litsim_sim.scenario.scenario import Scenario

NAME = "litsim_research.gym:litsim/Ego-v0"
FASTER, ON, BRAKE, TURN = (np.array(action, np.float32) for action in ([1, 0], [0, 0], [-1, 0], [0, 1]))
Made = Callable[..., Any]
Steps = list[tuple[np.ndarray, float, bool, bool, dict[str, Any]]]


def episode(environment: gymnasium.Env, action: np.ndarray) -> Steps:
    environment.reset(seed=0)
    steps: Steps = [environment.step(action)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(environment.step(action))
    return steps


@pytest.fixture(scope="module")
def queue(make_scenario: Made, track: Made) -> Scenario:
    """The ego 20 m behind another vehicle, both for 8 s; the net ends far ahead."""
    return make_scenario(track(1, x=80.0, last=80), track(2, x=100.0, last=80))


@pytest.mark.parametrize("name", [NAME, "litsim_research.gym:litsim/Takeover-v0"])
def test_gymnasiums_own_checker_has_nothing_to_say(name: str) -> None:
    environment = gymnasium.make(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(environment.unwrapped, skip_render_check=True)


def test_contact_ends_an_episode_and_costs(queue: Scenario) -> None:
    *before, (_, reward, terminated, truncated, info) = episode(gymnasium.make(NAME, scenario=queue), FASTER)
    assert terminated and not truncated and reward < -15.0 and info["agent"] == 1
    assert 20 < len(before) < 40, "some 15 m at 4 m/s2"


def test_who_brakes_comes_to_the_end_of_the_scenario(queue: Scenario) -> None:
    steps = episode(gymnasium.make(NAME, scenario=queue, progress=1.0), BRAKE)
    assert steps[-1][2:4] == (False, True) and steps[-1][4]["step"] == queue.total_steps
    assert steps[0][1] == pytest.approx(1.0, abs=0.4) and steps[-1][1] == 0.0, "metres in a step"


def test_leaving_the_road_ends_an_episode(queue: Scenario) -> None:
    *_, (_, reward, terminated, _, _) = episode(gymnasium.make(NAME, scenario=queue), TURN)
    assert terminated and reward < -15.0


def test_leaving_the_net_is_no_failure(make_scenario: Made, track: Made) -> None:
    scenario = make_scenario(track(1, x=600.0, speed=15.0, last=4), track(2, x=100.0, last=60))
    *before, (seen, reward, terminated, truncated, _) = episode(gymnasium.make(NAME, scenario=scenario), ON)
    assert (terminated, truncated) == (False, True) and reward > 0.0
    assert (seen == before[-1][0]).all(), "the last observation that there is"


def test_seeds_draw_egos_of_which_others_take_note() -> None:
    environment = gymnasium.make(NAME, policy="yield")
    egos = {environment.reset(seed=seed)[1]["agent"] for seed in range(4)}
    assert len(egos) > 1
    steps = episode(environment, BRAKE)
    assert environment.unwrapped._simulation.table.of_policy.any() and not any(step[2] for step in steps[:30])
