"""`litsim/Takeover-v0` for many vehicles: what each is shown and gets, and who takes its place."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from litsim_research.gym import vector
from litsim_sim.core.errors import InputError

NAME = "litsim_research.gym:litsim/Takeover-v0"


def made(num_envs: int = 8, **options: Any) -> gymnasium.vector.VectorEnv:
    return gymnasium.make_vec(NAME, num_envs=num_envs, **options)


def test_a_vehicle_alone_has_the_same_episode_as_in_the_environment_for_one() -> None:
    vector, single = made(1, vehicles=1), gymnasium.make(NAME)
    seen, expected = vector.reset(seed=1)[0], single.reset(seed=1)[0]
    single.action_space.seed(0)
    over = False
    while not over:
        assert (seen[0] == expected).all()
        action = single.action_space.sample() * 0.3
        seen, rewards, terminated, truncated, _ = vector.step(action[None])
        expected, *results, _ = single.step(action)
        over = results[1] or results[2]
        assert [rewards[0], terminated[0], truncated[0]] == results


def test_others_take_the_places_of_vehicles_whose_episodes_are_over() -> None:
    environment, random, changed = made(16, steps_max=12), np.random.default_rng(0), 0
    seen, info = environment.reset(seed=0)
    for _ in range(40):
        agents, actions = info["agent"], random.uniform(-1.0, 1.0, (16, 3)).astype(np.float32)
        seen, _, terminated, truncated, info = environment.step(actions)
        over = terminated | truncated
        assert (info["_final_obs"] == over).all() and not (terminated & truncated).any()
        assert environment.observation_space.contains(seen)
        assert (info["final_obs"][~over] == seen[~over]).all()
        assert (info["agent"] == agents)[~over].all()
        changed += int((info["agent"] != agents)[over].sum()) if not over.all() else 0
        assert all(len(set(run)) == 8 for run in info["agent"].reshape(2, 8).tolist()), "each drives one vehicle"
    assert changed > 16


def test_equal_seeds_give_equal_steps() -> None:
    def rewards(seed: int) -> list[list[float]]:
        environment = made()
        environment.reset(seed=seed)
        return [environment.step(np.full((8, 3), 0.1, np.float32))[1].tolist() for _ in range(20)]

    assert rewards(3) == rewards(3) != rewards(4)


def test_all_begin_anew_when_a_run_is_over() -> None:
    environment = made(4, vehicles=2, steps_max=1000)
    environment.reset(seed=0)
    straight_on, steps = np.zeros((4, 3), np.float32), 1
    while not environment.step(straight_on)[3].all():
        steps += 1
    assert (
        steps > 50
        and environment.unwrapped._episodes.step_number == environment.unwrapped._episodes.batch.history_steps
    )


def test_what_cannot_be_driven_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector, "STARTS", 3)
    with pytest.raises(InputError, match=r"num_envs is 10, expected a multiple of vehicles \(8\)"):
        made(10)
    with pytest.raises(InputError, match="no 8 vehicles within 1 m of each ego at 3 starts"):
        made(radius=1.0).reset(seed=0)
