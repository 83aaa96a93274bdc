"""Likelihood under the log's histograms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from litsim_sim.analysis.realism import FEATURES, realism

Make = Callable[..., Any]


def traffic(table: Make, speed: float = 10.0, second: float = 20.0) -> list[Any]:
    """Three vehicles in a column, those behind at distances of `second`."""
    return [
        table(k, *({"id": a, "x": 0.1 * speed * k - second * a, "y": 0.0, "speed": speed} for a in (1, 2, 3)))
        for k in range(40)
    ]


def test_the_log_itself_is_as_likely_as_the_log(table: Make) -> None:
    log = traffic(table)
    found = realism(log, log, {1, 2, 3}, None, 0.1)
    assert found is not None
    assert found.score == pytest.approx(1.0)
    assert set(found.features) == set(FEATURES) - {"distance_to_road_edge", "off_road"}


def test_what_the_log_never_does_is_unlikely(table: Make) -> None:
    log = traffic(table)
    fast = realism(traffic(table, speed=30.0), log, {2}, None, 0.1)
    touching = realism(traffic(table, second=3.0), log, {2}, None, 0.1)
    assert fast is not None
    assert touching is not None
    assert fast.features["linear_speed"] < 0.1
    assert fast.features["collision"] == pytest.approx(1.0)
    assert touching.features["collision"] < 0.1
    assert touching.score < fast.score < 1.0


def test_nobody_under_control_is_nothing_to_judge(table: Make) -> None:
    log = traffic(table)
    assert realism(log, log, set(), None, 0.1) is None
