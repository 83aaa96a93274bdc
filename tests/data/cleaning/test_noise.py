"""Noise of recorded motion: what makes a recording one to clean."""

import numpy as np
import pandas as pd
import pytest

from litsim_data.cleaning.noise import Noise


def drive(noise: float = 0.0, acceleration: float = 0.0, beside: float = 5.0) -> pd.DataFrame:
    """Two vehicles side by side; of the first, positions have `noise` [m] and a sixth of rows this acceleration."""
    rng, x = np.random.default_rng(0), np.arange(100.0)
    one = pd.DataFrame({"vehicle_id": 1, "frame": np.arange(100), "x": x + rng.normal(0.0, noise, 100), "y": 0.0})
    table = pd.concat([one, one.assign(vehicle_id=2, x=x, y=beside)], ignore_index=True)
    harsh = np.where((table["frame"] % 6 == 0) & (table["vehicle_id"] == 1), acceleration, 0.0)
    return table.assign(yaw=0.0, length=4.0, width=2.0, acceleration=harsh)


@pytest.mark.parametrize(
    ("motion", "noisy"), [({}, False), ({"noise": 0.03}, False), ({"noise": 0.2}, True), ({"acceleration": -6.0}, True)]
)
def test_jitter_and_impossible_accelerations_need_cleaning(motion: dict[str, float], noisy: bool) -> None:
    assert Noise.of(drive(**motion)).needs_cleaning == noisy


def test_boxes_that_overlap_are_counted_but_not_a_reason() -> None:
    noise = Noise.of(drive(beside=1.5))
    assert noise.overlaps == 1 and not noise.needs_cleaning
