"""Comfort bounds, kept and broken one at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.analysis.comfort import BOUNDS, comfort, motion_values

Make = Callable[..., Any]


def ride(table: Make, accelerations: list[float]) -> list[Any]:
    return [table(k, {"id": 1, "x": 1.0 * k, "y": 0.0, "acceleration": a}) for k, a in enumerate(accelerations)]


def test_a_steady_ride_is_comfortable(table: Make) -> None:
    found = comfort(ride(table, [0.0] * 10), 1, 0.1)
    assert found is not None
    assert found.comfortable
    assert found.within == dict.fromkeys(BOUNDS, 1.0)
    assert found.hard_brakes == 0


def test_braking_beyond_the_bound(table: Make) -> None:
    found = comfort(ride(table, [0.0, 0.0, -5.0, -5.0, 0.0, 0.0, -3.5, 0.0, 0.0, 0.0]), 1, 0.1)
    assert found is not None
    assert not found.comfortable
    assert found.within["longitudinal_acceleration"] == pytest.approx(0.8)  # -3.5 is within
    assert found.within["longitudinal_jerk"] == pytest.approx(5 / 9)
    assert found.hard_brakes == 2


def test_values_of_a_turn() -> None:
    values = motion_values(np.full(3, 10.0), np.zeros(3), np.array([0.2, 0.4, 0.4]), 0.1)
    assert values["lateral_acceleration"].tolist() == [2.0, 4.0, 4.0]
    assert values["yaw_acceleration"].tolist() == pytest.approx([2.0, 0.0])
    assert values["jerk"].tolist() == pytest.approx([20.0, 0.0])


def test_nothing_to_judge(table: Make) -> None:
    assert comfort(ride(table, [0.0, 0.0]), 1, 0.1) is None
    assert comfort(ride(table, [0.0] * 5), 2, 0.1) is None
