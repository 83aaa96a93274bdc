"""Report on cleaning: figures of the tracks as published, of their raw positions, and of the cleaned table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import STEP_S, FloatArray

HARD_ACCELERATION = 3.0  # [m/s2]


@dataclass(frozen=True)
class CleaningReport:
    """Figures before and after cleaning.

    Attributes:
        rows, vehicles: numbers of cleaned rows and vehicles.
        published, raw, cleaned: share of hard accelerations: of the published ones (None if there are none), of second
            differences of the raw positions, and of the cleaned ones.
        displacement: median, 95th percentile and maximum distance of cleaned from raw front centres [m].
        overlaps: before and after, (pairs of vehicles with overlapping boxes, pairs times frames).
    """

    rows: int
    vehicles: int
    published: float | None
    raw: float
    cleaned: float
    displacement: tuple[float, float, float]
    overlaps: tuple[tuple[int, int], tuple[int, int]]

    def table(self) -> str:
        """Returns the figures as text, one measure per line."""
        shares = ("-" if share is None else f"{share:.2%}" for share in (self.published, self.raw, self.cleaned))
        rows: list[tuple[object, ...]] = [
            ("", "published", "positions", "cleaned"),
            (f"|acceleration| above {HARD_ACCELERATION:g} m/s2", *shares),
            ("pairs of overlapping boxes", "", *(pairs for pairs, _ in self.overlaps)),
            ("  times frames", "", *(frames for _, frames in self.overlaps)),
            ("", "median", "95 %", "greatest"),
            ("front centres moved by, m", *(f"{value:.3f}" for value in self.displacement)),
        ]
        lines = [f"{name!s:<44}" + "".join(f"{cell!s:>12}" for cell in cells) for name, *cells in rows]
        return "\n".join([f"{self.rows} rows of {self.vehicles} vehicles", *lines])


def measure(raw: pd.DataFrame, cleaned: pd.DataFrame) -> CleaningReport:
    """Compares front centres `raw` with the box centres `cleaned`, the same rows, sorted by vehicle and frame."""
    vehicle = raw["vehicle_id"].to_numpy()
    front = raw[["x", "y"]].to_numpy(np.float64)
    half = 0.5 * raw["length"].to_numpy(np.float64)[:, None]
    yaw = cleaned["yaw"].to_numpy()
    moved = np.linalg.norm(cleaned[["x", "y"]].to_numpy() + half * _heading(yaw) - front, axis=1)
    raw_yaw = raw["yaw"].to_numpy(np.float64) if "yaw" in raw else yaw
    raw_x, raw_y = (front - half * _heading(raw_yaw)).T
    both = (overlaps(table) for table in (raw.assign(x=raw_x, y=raw_y, yaw=raw_yaw), cleaned))
    before, after = ((len(pairs), sum(pairs.values())) for pairs in both)
    speeds = np.linalg.norm(np.diff(front, axis=0), axis=1) / STEP_S
    return CleaningReport(
        rows=len(raw),
        vehicles=len(np.unique(vehicle)),
        published=share(raw["acceleration"].to_numpy(np.float64), HARD_ACCELERATION) if "acceleration" in raw else None,
        raw=share((np.diff(speeds) / STEP_S)[vehicle[2:] == vehicle[:-2]], HARD_ACCELERATION),
        cleaned=share(cleaned["acceleration"].to_numpy(), HARD_ACCELERATION),
        displacement=(float(np.median(moved)), float(np.quantile(moved, 0.95)), float(moved.max())),
        overlaps=(before, after),
    )


def _heading(yaw: FloatArray) -> FloatArray:
    """Returns unit vectors (n, 2) that point along `yaw` (n,) [rad]."""
    return np.stack([np.cos(yaw), np.sin(yaw)], axis=1)


def share(values: FloatArray, limit: float) -> float:
    """Returns the share of `values` (n,) of a magnitude above `limit`; 0 of none."""
    return float((np.abs(values) > limit).mean()) if len(values) else 0.0


def overlaps(table: pd.DataFrame) -> dict[tuple[int, int], int]:
    """Returns the number of frames in which boxes of a recording's `table` overlap, by ids, the lower one first."""
    x, y, yaw, length, width = (table[name].to_numpy() for name in ("x", "y", "yaw", "length", "width"))
    rows = overlapping_pairs(x, y, yaw, length, width, table["frame"].to_numpy().astype(np.int64))
    pairs, frames = np.unique(np.sort(table["vehicle_id"].to_numpy()[rows], axis=1), axis=0, return_counts=True)
    return {(int(a), int(b)): int(count) for (a, b), count in zip(pairs, frames, strict=True)}
