"""The environment `litsim/Takeover-v0`: what an episode is."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from campaigns import scenario_file
from litsim_research.gym import takeover
from litsim_sim.core.errors import InputError

NAME = "litsim_research.gym:litsim/Takeover-v0"
STRAIGHT_ON, BRAKE = np.zeros(3, np.float32), np.array([-1.0, 0.0, 0.0], np.float32)


def episode(environment: gymnasium.Env, seed: int, action: np.ndarray) -> list[tuple]:
    environment.reset(seed=seed)
    steps = [environment.step(action)]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(environment.step(action))
    return steps


def test_the_agent_stays_the_same_and_ends_by_its_own_fault_or_in_time() -> None:
    environment = gymnasium.make(NAME, steps_max=90)
    ends = []
    for seed in range(6):
        steps = episode(environment, seed, STRAIGHT_ON)
        assert len({info["agent"] for *_, info in steps}) == 1
        ends.append(steps[-1])
        assert len(steps) == 90 if steps[-1][3] else len(steps) < 90
    assert {(terminated, truncated) for _, _, terminated, truncated, _ in ends} == {(True, False), (False, True)}
    assert all(reward < -10.0 for _, reward, terminated, _, _ in ends if terminated)


def test_who_stands_earns_nothing() -> None:
    environment = gymnasium.make(NAME, progress=1.0)
    *_, last = (reward for _, reward, *_ in episode(environment, 5, BRAKE))
    first = episode(environment, 5, STRAIGHT_ON)[0][1]
    assert 0.3 < first < 3.0, "metres in a step of 0.1 s"
    assert last <= 0.0


def test_scenarios_are_drawn_from_names_and_files(tmp_path: Path) -> None:
    own = Path(scenario_file(tmp_path))
    own.write_text(own.read_text().replace("name: demo", "name: own"))
    environment = gymnasium.make(NAME, scenario=["demo", str(own)])
    assert {environment.reset(seed=seed)[1]["scenario"] for seed in range(8)} == {"demo", "own"}


def test_an_ego_alone_on_the_road_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(takeover, "STARTS", 3)
    environment = gymnasium.make(NAME, radius=0.0)
    with pytest.raises(InputError, match="nobody to drive at 3 starts"):
        environment.reset(seed=0)
