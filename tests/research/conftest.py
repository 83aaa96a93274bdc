"""Scenarios on which policies are trained in tests."""

from collections.abc import Callable
from typing import Any

import pytest

from litsim_sim.scenario.scenario import Scenario

Data = dict[str, list[str]]


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
