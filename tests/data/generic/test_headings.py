"""Headings that a table lacks follow from the way of the point that it tracks."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import made_tables
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray

LENGTH, RADIUS, SPEED = 4.8, 12.0, 6.0
AHEAD = {"front_centre": 0.79, "box_centre": 0.29, "rear_axle": 0.0}  # of the rear axle, in lengths
FIELDS: dict[str, Any] = {
    "name": "made",
    "columns": {"vehicle_id": "id", "time": "t", "x": "x", "y": "y", "length": LENGTH, "width": 1.9},
}


def driven(straight: float, side: float) -> pd.DataFrame:
    """Rear axle of a car that goes `straight` metres, heading almost to -x, then turns by 90 degrees; at 25 Hz.

    It stands for 4 s in the middle of the turn. Columns t, x, y, yaw.
    """
    t = np.arange(0.0, 12.0, 0.04)
    way = SPEED * np.where(t < 5.0, t, np.maximum(t - 4.0, 5.0))
    turned = np.clip(way - straight, 0.0, 0.5 * np.pi * RADIUS) / RADIUS
    yaw = 3.0 + side * turned
    x, y = (np.r_[0.0, np.cumsum(np.diff(way) * part(0.5 * (yaw[1:] + yaw[:-1])))] for part in (np.cos, np.sin))
    return pd.DataFrame({"t": t, "x": x, "y": y, "yaw": yaw})


def errors(folder: Path, axle: pd.DataFrame, reference: str, noise: FloatArray | float = 0.0) -> pd.DataFrame:
    """How far box centres [m] and headings [rad] of a conversion are off, at 10 Hz; by time."""
    cos, sin = np.cos(axle["yaw"]), np.sin(axle["yaw"])
    at = AHEAD[reference] * LENGTH
    table = pd.DataFrame({"id": 1, "t": axle["t"], "x": axle["x"] + at * cos, "y": axle["y"] + at * sin}) + noise
    fields = FIELDS | {"reference": reference, "clean": False}
    made = made_tables.converted(folder / "in.csv", table.assign(id=1), fields)[0].table
    t = made["frame"].to_numpy() * 0.1
    x, y, yaw = (np.interp(t, axle["t"], axle[name]) for name in ("x", "y", "yaw"))
    centre = 0.29 * LENGTH
    off = np.hypot(made["x"] - x - centre * np.cos(yaw), made["y"] - y - centre * np.sin(yaw))
    return pd.DataFrame({"centre": off, "yaw": np.abs(wrap_angle(made["yaw"].to_numpy() - yaw))}, index=t)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("reference", AHEAD)
def test_headings_in_a_turn(tmp_path: Path, reference: str, side: float) -> None:
    off = errors(tmp_path, driven(18.0, side), reference)
    assert off["yaw"].max() < 0.13 and off["yaw"].mean() < 0.03  # the direction of the front's motion is 0.30 off
    assert off["centre"].max() < 0.32 and off["centre"].mean() < 0.08  # and the box then lies 0.7 m beside


@pytest.mark.parametrize("reference", ["front_centre", "box_centre"])
def test_a_track_that_begins_in_a_turn(tmp_path: Path, reference: str) -> None:
    off = errors(tmp_path, driven(0.0, 1.0), reference)
    assert off["yaw"].loc[:1.5].max() < 0.12


def test_noise_does_not_turn_a_vehicle_that_waits_in_a_turn(tmp_path: Path) -> None:
    axle = driven(18.0, 1.0)
    noise = np.random.default_rng(1).normal(0.0, 0.03, (len(axle), 1)) * [0.0, 0.0, 1.0, 1.0]
    waiting = errors(tmp_path, axle, "front_centre", noise).loc[5.5:8.5, "yaw"]
    assert waiting.max() < 0.13 and np.ptp(waiting) < 1e-9
