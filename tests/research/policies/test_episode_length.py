"""Episodes end when their time is up, however long the recording goes on."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_research.policies.environment import EMPTY, EnvironmentConfig, PolicyEnvironment


@pytest.mark.parametrize("steps_max", [7, 12])
def test_an_episode_is_as_long_as_it_is_told_to_be(make_scenario, track, lane_centres, steps_max: int) -> None:
    tracks = [track(1 + k, x=60.0 + 40.0 * k, y=lane_centres[1 + k % 2], last=80) for k in range(4)]
    scenario = make_scenario(*tracks)
    environment = PolicyEnvironment([scenario], EnvironmentConfig(steps_max=steps_max, slots=2, drafted=3))
    _, info = environment.reset(seed=0)
    assert 0 < (info["agents"] != EMPTY).sum() <= 2
    truncated = False
    while not truncated:
        _, _, terminated, truncated, info = environment.step(np.zeros((2, 3)))
        assert not terminated
    assert info["step"] == scenario.history_steps + steps_max < scenario.total_steps
    assert EnvironmentConfig().steps_max == 300, "the paper's"
