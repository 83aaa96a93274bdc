"""Who is near whom, against plain numpy."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.nearby import around


@pytest.mark.parametrize("agents", [0, 1, 7, 15])
@pytest.mark.parametrize("radius", [0.0, 20.0])
def test_who_is_around_the_centres_of_his_scene(table: Callable[..., Any], agents: int, radius: float) -> None:
    random = np.random.default_rng(agents)
    x, y = random.normal(0.0, 30.0, (2, agents))
    scene = np.sort(random.integers(0, 3, agents))
    centres = random.random(agents) < 0.5
    agents_of_scenes = table(0, *({"id": k, "x": x[k], "y": y[k]} for k in range(agents)))
    agents_of_scenes.scene = scene
    found = around(agents_of_scenes, centres, radius)
    within = (np.hypot(x[:, None] - x, y[:, None] - y) <= radius) & (scene[:, None] == scene)
    assert found.tolist() == (centres | (within & centres[:, None]).any(axis=0)).tolist()
