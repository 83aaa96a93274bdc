"""The careful driver of R157 in scenes that he can and cannot manage."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from litsim_sim.analysis.careful_driver import BRAKE_MAX, REACTION_S, careful_driver

Make = Callable[..., Any]


def approach(table: Make, distance: float, speed: float = 20.0, steps: int = 100) -> list[Any]:
    """Ego 1 drives at constant speed into agent 2, which stands with its centre `distance` ahead."""
    return [
        table(
            k,
            {"id": 1, "x": 0.1 * speed * k, "y": 0.0, "speed": speed},
            {"id": 2, "x": distance, "y": 0.0, "speed": 0.0},
        )
        for k in range(steps)
    ]


def contact(tables: list[Any], distance: float) -> int:
    return next(t.step for t in tables if distance - t.x[0] < 4.0)


def test_a_standing_vehicle_seen_in_time_is_avoided(table: Make) -> None:
    speed = 10.0
    tables = approach(table, 80.0, speed)
    found = careful_driver(tables, 1, 2, contact(tables, 80.0), 0.1, None)
    # time to collision 2 s: 20 m; he needs 10 * 0.75 + 100 / (2 * 7.6) + build-up, about 16 m
    assert speed * REACTION_S + speed**2 / (2 * BRAKE_MAX) < 20.0
    assert found.avoided
    assert found.speed_at_contact == 0.0


def test_one_that_is_too_fast_to_stop_is_hit_but_slower(table: Make) -> None:
    tables = approach(table, 150.0, 30.0)
    found = careful_driver(tables, 1, 2, contact(tables, 150.0), 0.1, None)
    # he sees it 60 m ahead and would need 22 + 59 m
    assert not found.avoided
    assert 5.0 < found.speed_at_contact < 25.0


def test_one_that_appears_right_ahead_cannot_be_avoided(table: Make) -> None:
    tables = [
        table(k, {"id": 1, "x": 1.0 * k, "y": 0.0}, {"id": 2, "x": 56.0, "y": 0.0 if k >= 48 else 20.0, "speed": 0.0})
        for k in range(80)
    ]
    found = careful_driver(tables, 1, 2, contact([t for t in tables if t.step >= 48], 56.0), 0.1, None)
    assert found.perceived_step == 48
    assert not found.avoided
    assert found.speed_at_contact == pytest.approx(10.0)  # still reacting
