"""Scenarios on which policies are trained in tests, and tracks for predictors."""

from collections.abc import Callable
from importlib.util import find_spec
from itertools import product
from typing import Any

import pandas as pd
import pytest

from litsim_sim.scenario.scenario import Scenario

Data = dict[str, list[str]]

if find_spec("torch") is not None:
    import torch

    torch.set_num_threads(1)  # the scenes of tests are small


@pytest.fixture(scope="session")
def three_lanes(
    make_scenario: Callable[..., Scenario], track: Callable[..., Any], lane_centres: tuple[float, ...]
) -> Callable[[float], Scenario]:
    """Makes a scenario of nine vehicles in three lanes, the leftmost as fast as given, the next ones 1 m/s faster."""

    def made(speed: float) -> Scenario:
        places = product(range(3), range(3))
        return make_scenario(
            *(
                track(1 + 3 * lane + k, x=60.0 + 20.0 * k, y=lane_centres[lane + 1], speed=speed + lane, last=45)
                for lane, k in places
            )
        )

    return made


@pytest.fixture(scope="session")
def training_data(three_lanes: Callable[[float], Scenario], tmp_path_factory: pytest.TempPathFactory) -> Data:
    """Section `data` of a configuration: nine vehicles in three lanes, of 9, 10 and 11 m/s, and as many to validate."""
    folder = tmp_path_factory.mktemp("training_data")
    parts = ("scenarios", "validation")
    for part in parts:
        (folder / f"{part}.yaml").write_text(three_lanes(9.0).to_yaml())
    return {part: [str(folder / f"{part}.yaml")] for part in parts}


@pytest.fixture(scope="session")
def straight(track: Callable[..., Any]) -> Callable[..., pd.DataFrame]:
    """Makes recordings of vehicles (id, x, y, speed) that drive straight on along `yaw`."""

    def table(*vehicles: tuple[int, float, float, float], frames: int = 90, yaw: float = 0.0) -> pd.DataFrame:
        tracks = [track(k, x=x, y=y, speed=speed, yaw=yaw, last=frames - 1) for k, x, y, speed in vehicles]
        return pd.concat([one.rows() for one in tracks], ignore_index=True)

    return table
