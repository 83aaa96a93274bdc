"""Report on cleaning: figures of the tracks as published, of their raw positions, and of the cleaned table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_data.cleaning.track_fit import CleaningConfig
from litsim_sim.core.geometry import overlapping_pairs, wrap_angle
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray

HARD_ACCELERATION = 3.0  # [m/s2]
HARD_JERK = 15.0  # [m/s3]
STANDSTILL = 0.05  # [m] per frame: half a metre per second
FLIP = 0.1  # [rad] per frame


@dataclass(frozen=True)
class Roughness:
    """Shares of the samples of an acceleration that are implausible.

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
        axle_slip: maximum difference between the rear axle's velocity, from positions in the table, and speed along
            the heading [m/s]: x' - v cos yaw and y' - v sin yaw.
        centre_slip: the same for the box centre, which swings out in bends.
        reversing: frames in which a box centre moves backwards by more than a millimetre.
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
    axle_slip: float
    centre_slip: float
    reversing: int

    def table(self) -> str:
        """The figures as text, one measure per line."""

        def line(name: str, *cells: str) -> str:
            return f"{name:<44}" + "".join(f"{cell:>12}" for cell in cells)

        published = self.published
        (pairs, pair_frames), (pairs_after, pair_frames_after) = self.overlaps
        return "\n".join(
            [
                f"{self.rows} rows of {self.vehicles} vehicles",
                line("", "published", "positions", "cleaned"),
                line(
                    f"|acceleration| above {HARD_ACCELERATION:g} m/s2",
                    f"{published.acceleration:.2%}" if published else "-",
                    f"{self.raw.acceleration:.2%}",
                    f"{self.cleaned.acceleration:.2%}",
                ),
                line(
                    f"|jerk| above {HARD_JERK:g} m/s3",
                    f"{published.jerk:.2%}" if published else "-",
                    f"{self.raw.jerk:.2%}",
                    f"{self.cleaned.jerk:.2%}",
                ),
                line("", "", "before", "cleaned"),
                line("pairs of overlapping boxes", "", f"{pairs}", f"{pairs_after}"),
                line("  times frames", "", f"{pair_frames}", f"{pair_frames_after}"),
                line("  pairs that did not overlap before", "", "", f"{self.created}"),
                line("heading flips at standstill", "", f"{self.flips[0]}", f"{self.flips[1]}"),
                line("frames of reversing", "", "", f"{self.reversing}"),
                line("greatest yaw rate, rad/s", "", "", f"{self.yaw_rate:.3f}"),
                line("greatest lateral acceleration, m/s2", "", "", f"{self.lateral_acceleration:.2f}"),
                line("velocity off the heading, rear axle, m/s", "", "", f"{self.axle_slip:.4f}"),
                line("velocity off the heading, box centre, m/s", "", "", f"{self.centre_slip:.4f}"),
                line("", "median", "95 %", "greatest"),
                line("front centres moved by, m", *(f"{value:.3f}" for value in self.displacement)),
            ]
        )


def measure(raw: pd.DataFrame, cleaned: pd.DataFrame, yaw_rate: FloatArray, config: CleaningConfig) -> CleaningReport:
    """The report on two tables with the same rows, sorted by vehicle and frame.

    Args:
        raw: input of :func:`litsim_data.cleaning.cleaning.clean`: front centres.
        cleaned: its output, but for the order of the rows: box centres.
        yaw_rate: (n,) yaw rates of the cleaned rows [rad/s].
        config: configuration of the cleaning.
    """
    vehicle = raw["vehicle_id"].to_numpy()
    front = raw[["x", "y"]].to_numpy(np.float64)
    centre = cleaned[["x", "y"]].to_numpy()
    yaw, speed = cleaned["yaw"].to_numpy(), cleaned["speed"].to_numpy()
    length = raw["length"].to_numpy(np.float64)
    heading = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    next_same = vehicle[1:] == vehicle[:-1]
    moved = np.linalg.norm(centre + 0.5 * length[:, None] * heading - front, axis=1)
    raw_yaw = raw["yaw"].to_numpy(np.float64) if "yaw" in raw else yaw
    raw_centre = front - 0.5 * length[:, None] * np.stack([np.cos(raw_yaw), np.sin(raw_yaw)], axis=1)
    before, after = _overlaps(raw, raw_centre, raw_yaw), _overlaps(raw, centre, yaw)
    steps = np.diff(front, axis=0)
    if "yaw" in raw:
        raw_turn = np.diff(raw["yaw"])
    else:  # between successive steps; 0 for the last step of a vehicle
        turn = np.append(np.diff(np.arctan2(steps[:, 1], steps[:, 0])), 0.0)
        raw_turn = np.where(np.append(next_same[1:], False), turn, 0.0)
    raw_acceleration = np.append(np.diff(np.linalg.norm(steps, axis=1)), 0.0) / STEP_S**2
    along = (np.diff(centre, axis=0) * (heading[1:] + heading[:-1])).sum(axis=1) / 2.0
    axle = centre - config.rear_axle * length[:, None] * heading
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
        yaw_rate=float(np.abs(yaw_rate).max()),
        lateral_acceleration=float(np.abs(yaw_rate * speed).max()),
        axle_slip=_slip(axle, speed[:, None] * heading, vehicle),
        centre_slip=_slip(centre, speed[:, None] * heading, vehicle),
        reversing=int((next_same & (along < -1e-3)).sum()),
    )


def _same(vehicle: FloatArray, ahead: int) -> BoolArray:
    """Mask (n - ahead,) of rows of the same vehicle as the row `ahead` rows later."""
    return vehicle[ahead:] == vehicle[: len(vehicle) - ahead]


def _roughness(acceleration: FloatArray, vehicle: FloatArray, reach: int) -> Roughness:
    """Roughness of `acceleration`, each entry of which depends on the `reach` following rows."""
    inner, pairs = _same(vehicle, reach), _same(vehicle, reach + 1)
    values = acceleration[: len(inner)][inner]
    jerk = np.diff(acceleration)[: len(pairs)][pairs] / STEP_S
    return Roughness(_share(np.abs(values) > HARD_ACCELERATION), _share(np.abs(jerk) > HARD_JERK))


def _share(of: BoolArray) -> float:
    return float(of.mean()) if len(of) else 0.0


def _flips(turn: FloatArray, steps: FloatArray, same: BoolArray) -> int:
    """Number of large turns, of `turn` (n - 1,) [rad], in `steps` (n - 1, 2) [m] at standstill."""
    return int((same & (np.linalg.norm(steps, axis=1) < STANDSTILL) & (np.abs(wrap_angle(turn)) > FLIP)).sum())


def _slip(positions: FloatArray, velocity: FloatArray, vehicle: FloatArray) -> float:
    """Maximum difference [m/s] between steps of positions (n, 2) and the velocity (n, 2) integrated over them.

    The integral is that of the cubic through four velocities; its error is far below a millimetre per second.
    """
    inner = _same(vehicle, 3)
    if not inner.any():
        return 0.0
    mean = (13.0 * (velocity[1:-2] + velocity[2:-1]) - velocity[:-3] - velocity[3:]) / 24.0
    steps = (positions[2:-1] - positions[1:-2]) / STEP_S
    return float(np.abs(steps - mean)[inner].max())


def _overlaps(table: pd.DataFrame, centre: FloatArray, yaw: FloatArray) -> dict[tuple[int, int], int]:
    """Number of frames with overlapping boxes, by pair of vehicle ids."""
    frame = table["frame"].to_numpy()
    order = np.argsort(frame, kind="stable")
    vehicle, length, width = (table[name].to_numpy() for name in ("vehicle_id", "length", "width"))
    counts: dict[tuple[int, int], int] = {}
    for rows in np.split(order, np.flatnonzero(np.diff(frame[order])) + 1):
        pairs = overlapping_pairs(centre[rows, 0], centre[rows, 1], yaw[rows], length[rows], width[rows])
        for a, b in vehicle[rows][pairs]:
            key = (int(min(a, b)), int(max(a, b)))
            counts[key] = counts.get(key, 0) + 1
    return counts
