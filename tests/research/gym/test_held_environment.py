"""The environment of all agents off their logs: PettingZoo's contract, and how agents come and go."""

import warnings

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from litsim_research.gym import held
from litsim_research.gym.held import HeldEnvironment
from litsim_sim.core.errors import InputError

STRAIGHT_ON = np.zeros(3, np.float32)


def test_pettingzoos_own_checker_has_nothing_to_say() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "No agents present but not all possible_agents")  # there are spare names
        parallel_api_test(HeldEnvironment(), num_cycles=60)


def test_agents_come_with_takeovers_and_go_by_their_own_ends() -> None:
    environment, names, ends = HeldEnvironment(), set(), []
    for seed in range(3):
        observations, infos = environment.reset(seed=seed)
        assert observations.keys() == infos.keys() == set(environment.agents) != set()
        while environment.agents:
            before = set(environment.agents)
            actions = dict.fromkeys(environment.agents, STRAIGHT_ON)
            observations, rewards, terminated, truncated, infos = environment.step(actions)
            assert before | set(environment.agents) == observations.keys() == rewards.keys() == infos.keys()
            assert all(terminated[name] != truncated[name] for name in before - set(environment.agents))
            names |= set(environment.agents)
            ends += [terminated[name] for name in before - set(environment.agents)]
    assert len(names) > 3 and {True, False} >= set(ends) != set()


def test_a_run_ends_when_names_run_out() -> None:
    environment = HeldEnvironment(takeovers=1)
    environment.reset(seed=0)
    steps = 0
    while environment.agents:
        _, _, terminated, truncated, _ = environment.step(dict.fromkeys(environment.agents, STRAIGHT_ON))
        steps += 1
    assert steps > 0 and (terminated | truncated).keys() == {"agent_0"}


def test_traffic_in_which_nobody_is_taken_over_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(held, "STARTS", 3)
    with pytest.raises(InputError, match="nobody is taken over at 3 starts"):
        HeldEnvironment(steps_max=1).reset(seed=0)
