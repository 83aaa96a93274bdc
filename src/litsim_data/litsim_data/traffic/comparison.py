"""Comparison of generated traffic with the recorded windows of US-101, by distributions of the usual measures.

Generated and recorded traffic are processed alike: the same stretch of road beside the auxiliary lane, the same filter
on positions, speeds and accelerations differentiated from these, and leaders determined in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.ngsim import windows as ngsim_windows
from litsim_data.traffic.calibration_data import LANE_WIDTH, US101_WINDOWS, count_lane_changes
from litsim_data.traffic.motion import smooth
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.io.parquet_input import read_table
from litsim_sim.scenario.recording import Recording

WINDOWS = (((316, 543), (180.0, 415.0)), ((403, 543), (200.0, 478.0)), ((748, 828), (135.0, 325.0)))
"""Complete windows: first and last frame, [m] along the road. Rows in two of them count once."""
STRETCH = (180.0, 415.0)  # [m] along the generated road
FILTER_S = 0.4  # [s] standard deviation: recorded positions are noisy, generated ones have passed it once already
MOVING = 1.0  # [m/s] above which a time headway makes sense
HEADWAY_MAX = 100.0  # [m]
MEASURES = {
    "speed": "m/s",
    "acceleration": "m/s2",
    "space headway": "m",
    "time headway": "s",
    "lane changes": "1/km",
}


@dataclass(frozen=True)
class Sample:
    """Measures of some traffic.

    Attributes:
        measured: by measure of MEASURES but lane changes, all vehicles and frames (k,).
        changes: number of lane changes.
        kilometres: driven by all vehicles.
    """

    measured: dict[str, FloatArray]
    changes: int
    kilometres: float

    @property
    def rate(self) -> float:
        """Lane changes per kilometre driven."""
        return self.changes / max(self.kilometres, 1e-9)

    def distance(self, other: Sample) -> dict[str, float]:
        """Wasserstein-1 distance by measure, in its unit; of the rates of lane changes, their difference."""
        distances = {name: wasserstein(values, other.measured[name]) for name, values in self.measured.items()}
        return distances | {"lane changes": abs(self.rate - other.rate)}


def wasserstein(first: FloatArray, second: FloatArray) -> float:
    """Wasserstein-1 distance of two samples (n,), (m,): the area between their distribution functions."""
    points = np.sort(np.concatenate([first, second]))
    shares = [np.searchsorted(np.sort(sample), points[:-1], "right") / len(sample) for sample in (first, second)]
    return float((np.abs(shares[0] - shares[1]) * np.diff(points)).sum())


def recorded(data: Path) -> Sample:
    """The complete windows of the US-101 file in the folder `data`.

    Raises:
        InputError: the file is missing, cannot be read, lacks columns, or has no vehicle for long enough.
    """
    columns = {"vehicle_id": "vehicle", "local_y_m": "front", "local_x_m": "lateral", "lane_est": "lane"}
    purpose = "the comparison needs it (README of the folder in LITSIM_DATA)"
    table = read_table(data / US101_WINDOWS, ("src", "frame", *columns), purpose=purpose)
    table = table[table["src"] < ngsim_windows.WINDOW_SOURCES]
    inside = np.zeros(len(table), np.bool_)
    for (first, last), (low, high) in WINDOWS:
        inside |= (table["frame"].between(first, last) & table["local_y_m"].between(low, high)).to_numpy()
    table = table[inside]
    return _sample([table.rename(columns=columns)], str(data / US101_WINDOWS))


def generated(recordings: Iterable[Recording]) -> Sample:
    """The stretch beside the auxiliary lane of recordings on ``us101_like``.

    Raises:
        InputError: no vehicle is there for long enough.
    """
    tables = []
    for recording in recordings:
        table = recording.table
        front = table["x"] + 0.5 * table["length"]
        table = table.assign(front=front, lateral=-table["y"], vehicle=table["vehicle_id"])
        tables.append(table[front.between(*STRETCH)])
    return _sample(tables, "generated traffic")


def report(real: Sample, samples: Sequence[tuple[str, Sample]]) -> str:
    """A table of means and of distances to `real`, one row a measure."""
    head = f"{'measure':<22}{'recorded':>10}" + "".join(f"{name:>24}" for name, _ in samples)
    lines = [head, f"{'':<22}{'mean':>10}" + f"{'mean':>14}{'distance':>10}" * len(samples)]
    distances = [sample.distance(real) for _, sample in samples]
    for measure, unit in MEASURES.items():
        means = [_mean(sample, measure) for sample in (real, *(sample for _, sample in samples))]
        cells = [f"{mean:>14.2f}{row[measure]:>10.3f}" for mean, row in zip(means[1:], distances, strict=True)]
        lines.append(f"{measure + ' [' + unit + ']':<22}{means[0]:>10.2f}" + "".join(cells))
    lines.append(f"recorded: {real.changes} lane changes in {real.kilometres:.1f} vehicle kilometres")
    worse = [name for name in MEASURES if len(samples) > 1 and distances[0][name] >= distances[1][name]]
    if len(samples) > 1:
        verdict = f"not closer in: {', '.join(worse)}" if worse else "closer in every measure"
        lines.append(f"{samples[0][0]} against {samples[1][0]}: {verdict}")
    return "\n".join(lines)


def _mean(sample: Sample, measure: str) -> float:
    return sample.rate if measure == "lane changes" else float(sample.measured[measure].mean())


def _sample(tables: list[pd.DataFrame], source: str) -> Sample:
    """Measures of tables with the columns vehicle, frame, front, lateral (from the left edge) and lane.

    Raises:
        InputError: no vehicle is in them for long enough; `source` names them.
    """
    speeds, accelerations, gaps, times = [], [], [], []
    changes, metres = 0, 0.0
    for table in tables:
        by_track: list[pd.DataFrame] = []
        ordered = table.sort_values(["vehicle", "frame"])
        # A vehicle that is in two windows that do not touch makes two tracks.
        broken = (np.diff(ordered["vehicle"]) != 0) | (np.diff(ordered["frame"]) != 1)
        for rows in np.split(np.arange(len(ordered)), np.flatnonzero(broken) + 1):
            track = ordered.iloc[rows]
            if len(track) < 2 * round(1.0 / STEP_S):
                continue
            front = smooth(track["front"].to_numpy(np.float64), FILTER_S / STEP_S)
            speed = np.gradient(front, STEP_S)
            by_track.append(track.assign(front=front, speed=speed, acceleration=np.gradient(speed, STEP_S)))
            changes += count_lane_changes(track["lateral"].to_numpy(np.float64), LANE_WIDTH)
            metres += float(np.ptp(front))
        if not by_track:
            continue
        rows_of = pd.concat(by_track)
        speeds.append(rows_of["speed"].to_numpy())
        accelerations.append(rows_of["acceleration"].to_numpy())
        gap, speed = _headways(rows_of)
        gaps.append(gap)
        times.append((gap / np.maximum(speed, MOVING))[speed > MOVING])
    if not speeds:
        raise InputError(f"{source}: no vehicle is seen for 2 s in a row on the stretch that is compared")
    values = {"speed": speeds, "acceleration": accelerations, "space headway": gaps, "time headway": times}
    return Sample({name: np.concatenate(parts) for name, parts in values.items()}, changes, metres / 1000.0)


def _headways(table: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    """Distance from front to front of the next vehicle ahead in the lane (k,) [m], and the follower's speed [m/s]."""
    ordered = table.sort_values(["frame", "lane", "front"])
    same = (np.diff(ordered["frame"]) == 0) & (np.diff(ordered["lane"]) == 0)
    gap = np.diff(ordered["front"])
    same &= gap < HEADWAY_MAX
    return gap[same], ordered["speed"].to_numpy()[:-1][same]
