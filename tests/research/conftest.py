"""Scenarios on which policies are trained in tests, and tracks for predictors."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_sim.scenario.scenario import Scenario

Data = dict[str, list[str]]

if find_spec("torch") is not None:
    import torch

    torch.set_num_threads(1)  # the scenes of tests are small


@pytest.fixture(scope="session")
def training_data(
    make_scenario: Callable[..., Scenario],
    track: Callable[..., Any],
    lane_centres: tuple[float, ...],
    tmp_path_factory: pytest.TempPathFactory,
) -> Data:
    """Section `data` of a configuration: nine vehicles in three lanes, of 9, 10 and 11 m/s, and as many to validate."""
    tracks = [
        track(1 + 3 * lane + k, x=60.0 + 20.0 * k, y=lane_centres[lane + 1], speed=9.0 + lane, last=45)
        for lane in range(3)
        for k in range(3)
    ]
    folder = tmp_path_factory.mktemp("training_data")
    parts = ("scenarios", "validation")
    for part in parts:
        (folder / f"{part}.yaml").write_text(make_scenario(*tracks).to_yaml())
    return {part: [str(folder / f"{part}.yaml")] for part in parts}


def table(*vehicles: tuple[int, float, float, float], frames: int = 90, yaw: float = 0.0) -> pd.DataFrame:
    """Vehicles (id, x, y, speed) that drive straight on along `yaw`."""
    t = 0.1 * np.arange(frames)
    rows = [
        pd.DataFrame(
            {
                "vehicle_id": number,
                "frame": np.arange(frames),
                "x": x + speed * t * np.cos(yaw),
                "y": y + speed * t * np.sin(yaw),
                "yaw": yaw,
                "speed": speed,
                "length": 4.5,
                "width": 2.0,
            }
        )
        for number, x, y, speed in vehicles
    ]
    return pd.concat(rows, ignore_index=True)


@pytest.fixture(scope="session")
def straight() -> Callable[..., pd.DataFrame]:
    """See :func:`table`."""
    return table
