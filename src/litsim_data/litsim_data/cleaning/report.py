"""Report on cleaning: figures of the tracks as published, of their raw positions, and of the cleaned table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from litsim_sim.core.geometry import overlapping_pairs, wrap_angle
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray

HARD_ACCELERATION = 3.0  # [m/s2]
HARD_JERK = 15.0  # [m/s3]
STANDSTILL = 0.05  # [m] per frame: half a metre per second
FLIP = 0.1  # [rad] per frame


class Roughness(NamedTuple):
    """Shares of implausible samples of an acceleration.

    Attributes:
        acceleration: share of samples beyond 3 m/s2 in magnitude.
        jerk: share of steps to the next frame beyond 15 m/s3 in magnitude.
    """

    acceleration: float
    jerk: float


@dataclass(frozen=True)
class CleaningReport:
    """Figures before and after cleaning.

    Attributes:
        rows, vehicles: numbers of cleaned rows and vehicles.
        published, raw, cleaned: roughness of the published acceleration (None if there is none), of second differences
            of the raw positions, and of the cleaned acceleration.
        displacement: median, 95th percentile and maximum distance of cleaned from raw front centres [m].
        overlaps: before and after, (pairs of vehicles with overlapping boxes, pairs times frames).
        created: pairs of vehicles that overlap only after cleaning.
        flips: before and after, frames in which a heading turns by more than 0.1 rad while its vehicle stands; before,
            of the published yaw or of the direction of raw steps.
        yaw_rate: maximum [rad/s].
        lateral_acceleration: maximum of speed times yaw rate [m/s2].
    """

    rows: int
    vehicles: int
    published: Roughness | None
    raw: Roughness
    cleaned: Roughness
    displacement: tuple[float, float, float]
    overlaps: tuple[tuple[int, int], tuple[int, int]]
    created: int
    flips: tuple[int, int]
    yaw_rate: float
    lateral_acceleration: float

    def table(self) -> str:
        """Returns the figures as text, one measure per line."""
        roughness = (self.published, self.raw, self.cleaned)
        accelerations = [f"{one.acceleration:.2%}" if one else "-" for one in roughness]
        jerks = [f"{one.jerk:.2%}" if one else "-" for one in roughness]
        rows: list[tuple[object, ...]] = [
            ("", "published", "positions", "cleaned"),
            (f"|acceleration| above {HARD_ACCELERATION:g} m/s2", *accelerations),
            (f"|jerk| above {HARD_JERK:g} m/s3", *jerks),
            ("", "", "before", "cleaned"),
            ("pairs of overlapping boxes", "", *(pairs for pairs, _ in self.overlaps)),
            ("  times frames", "", *(frames for _, frames in self.overlaps)),
            ("  pairs that did not overlap before", "", "", self.created),
            ("heading flips at standstill", "", *self.flips),
            ("greatest yaw rate, rad/s", "", "", f"{self.yaw_rate:.3f}"),
            ("greatest lateral acceleration, m/s2", "", "", f"{self.lateral_acceleration:.2f}"),
            ("", "median", "95 %", "greatest"),
            ("front centres moved by, m", *(f"{value:.3f}" for value in self.displacement)),
        ]
        lines = [f"{name!s:<44}" + "".join(f"{cell!s:>12}" for cell in cells) for name, *cells in rows]
        return "\n".join([f"{self.rows} rows of {self.vehicles} vehicles", *lines])


def measure(raw: pd.DataFrame, cleaned: pd.DataFrame) -> CleaningReport:
    """Compares front centres `raw` with the box centres `cleaned`, the same rows, sorted by vehicle and frame."""
    vehicle = raw["vehicle_id"].to_numpy()
    front = raw[["x", "y"]].to_numpy(np.float64)
    centre = cleaned[["x", "y"]].to_numpy()
    yaw, speed = cleaned["yaw"].to_numpy(), cleaned["speed"].to_numpy()
    half = 0.5 * raw["length"].to_numpy(np.float64)[:, None]
    moved = np.linalg.norm(centre + half * _heading(yaw) - front, axis=1)
    raw_yaw = raw["yaw"].to_numpy(np.float64) if "yaw" in raw else yaw
    raw_x, raw_y = (front - half * _heading(raw_yaw)).T
    before, after = overlaps(raw.assign(x=raw_x, y=raw_y, yaw=raw_yaw)), overlaps(cleaned)
    steps, next_same = np.diff(front, axis=0), _same(vehicle, 1)
    if "yaw" in raw:
        raw_turn = np.diff(raw_yaw)
    else:  # between successive steps; 0 for the last step of a vehicle
        turn = np.append(np.diff(np.arctan2(steps[:, 1], steps[:, 0])), 0.0)
        raw_turn = np.where(np.append(next_same[1:], False), turn, 0.0)
    raw_acceleration = np.append(np.diff(np.linalg.norm(steps, axis=1)), 0.0) / STEP_S**2
    yaw_rate = np.where(next_same, np.abs(wrap_angle(np.diff(yaw))) / STEP_S, 0.0)
    return CleaningReport(
        rows=len(raw),
        vehicles=len(np.unique(vehicle)),
        published=_roughness(raw["acceleration"].to_numpy(np.float64), vehicle, 0) if "acceleration" in raw else None,
        raw=_roughness(raw_acceleration, vehicle, 2),
        cleaned=_roughness(cleaned["acceleration"].to_numpy(), vehicle, 0),
        displacement=(float(np.median(moved)), float(np.quantile(moved, 0.95)), float(moved.max())),
        overlaps=((len(before), sum(before.values())), (len(after), sum(after.values()))),
        created=len(set(after) - set(before)),
        flips=(_flips(raw_turn, steps, next_same), _flips(np.diff(yaw), np.diff(centre, axis=0), next_same)),
        yaw_rate=float(yaw_rate.max(initial=0.0)),
        lateral_acceleration=float((yaw_rate * speed[1:]).max(initial=0.0)),
    )


def _heading(yaw: FloatArray) -> FloatArray:
    """Returns unit vectors (n, 2) that point along `yaw` (n,) [rad]."""
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=1)


def _same(vehicle: IntArray, ahead: int) -> BoolArray:
    """Returns the mask (n - ahead,) of rows of the same vehicle as the row `ahead` rows later."""
    return vehicle[ahead:] == vehicle[: len(vehicle) - ahead]


def _roughness(acceleration: FloatArray, vehicle: IntArray, reach: int) -> Roughness:
    """Returns the roughness of `acceleration` (n,), each entry of which depends on the `reach` following rows."""
    inner, pairs = _same(vehicle, reach), _same(vehicle, reach + 1)
    values = acceleration[: len(inner)][inner]
    jerk = np.diff(acceleration)[: len(pairs)][pairs] / STEP_S
    return Roughness(_share(np.abs(values) > HARD_ACCELERATION), _share(np.abs(jerk) > HARD_JERK))


def _share(of: BoolArray) -> float:
    return float(of.mean()) if len(of) else 0.0


def _flips(turn: FloatArray, steps: FloatArray, same: BoolArray) -> int:
    """Counts the large turns, of `turn` (n - 1,) [rad], in `steps` (n - 1, 2) [m] at standstill."""
    return int((same & (np.linalg.norm(steps, axis=1) < STANDSTILL) & (np.abs(wrap_angle(turn)) > FLIP)).sum())


def overlaps(table: pd.DataFrame) -> dict[tuple[int, int], int]:
    """Returns the number of frames in which boxes of a recording's `table` overlap, by ids, the lower one first."""
    x, y, yaw, length, width = (table[name].to_numpy() for name in ("x", "y", "yaw", "length", "width"))
    rows = overlapping_pairs(x, y, yaw, length, width, table["frame"].to_numpy().astype(np.int64))
    pairs, frames = np.unique(np.sort(table["vehicle_id"].to_numpy()[rows], axis=1), axis=0, return_counts=True)
    return {(int(a), int(b)): int(count) for (a, b), count in zip(pairs, frames, strict=True)}
