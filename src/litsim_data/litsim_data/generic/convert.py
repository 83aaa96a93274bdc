"""Conversion of a table of trajectories to a recording, by its mapping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.cleaning.cleaning import smoothed
from litsim_data.cleaning.noise import HARSH, HARSH_SHARE, Noise
from litsim_data.cleaning.report import overlaps
from litsim_data.generic.checks import check_plausible, off_their_motion
from litsim_data.generic.counts import SHOWN, Counts
from litsim_data.generic.headings import direction_of_motion, headings
from litsim_data.generic.heights import tell_levels
from litsim_data.generic.kinds import without_dropped_kinds
from litsim_data.generic.mapping import Mapping
from litsim_data.generic.obstacles import obstacle_rows, with_usual_sizes, without_unused
from litsim_data.generic.reading import read_rows
from litsim_data.generic.resampling import (
    PIECE,
    check_clock,
    count_leaps,
    count_turns,
    in_order,
    resampled,
    split,
    without_outliers,
)
from litsim_data.generic.si_units import in_si
from litsim_data.generic.towing import joined
from litsim_data.generic.wide import open_tables
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import RATE_HZ, STEP_S, BoolArray, FloatArray, IntArray, Kind
from litsim_sim.io.table_input import TableFiles
from litsim_sim.scenario.recording import BOUNDS, COLUMNS, Recording, RecordingHeader

FAR = 1.0  # [m] displacement by cleaning beyond which a vehicle is reported
OVERLAP_S = 1.0  # [s] for which a pair of vehicles must overlap to be reported
AHEAD = {
    "front_centre": -0.5,
    "box_centre": 0.0,
    "rear_axle": VehicleLimits.rear_axle,
    "rear_centre": 0.5,
    "box_corner": 0.0,
}
"""Distance of the box centre ahead of the reference point, in lengths; corners are converted to centres on reading."""


class RoughMotionError(InputError):
    """Positions or speeds are so noisy that accelerations derived from them are impossible; cleaning helps."""


def convert(tables: Path | Sequence[Path] | TableFiles, mapping: Mapping) -> tuple[Recording, Counts]:
    """Returns `tables` (CSV or Parquet, one file or several) as a recording, and counts of the conversion.

    Raises:
        InputError: a column is missing, a cell is not a number, a vehicle is at two places at a time or jumps too
            often, a kind is not in the mapping, the motion is implausible, or the result fails a check of
            :meth:`Recording.from_table`.
    """
    source, counts = tables if isinstance(tables, TableFiles) else open_tables(tables, mapping.repeated), Counts()
    raw_table = without_dropped_kinds(read_rows(source, mapping, counts), mapping, source, counts)
    table, names = in_si(without_unused(raw_table), mapping, source)
    check_clock(table, source)
    table = in_order(table, source, counts)
    _tell_what_is_left_open(table, mapping, counts)
    walking = obstacle_rows(table)
    off_motion = [] if "heading" in mapping.accept else off_their_motion(table[~walking], mapping)
    off = table["vehicle_id"].isin(off_motion)
    if off_motion:
        counts.tell(
            "headings",
            f"{len(off_motion)} vehicles drive off their heading for 15 m and more, such as "
            f"{', '.join(map(str, off_motion[:SHOWN]))}: their headings follow from the motion",
            headings_from_motion=off_motion,
        )
    table = _with_plausible_speeds(table, walking, off, mapping, source, counts)
    table = without_outliers(with_usual_sizes(table, mapping, counts), source, counts)
    tell_levels(table, source, counts)
    count_leaps(table[~obstacle_rows(table)], source, counts)
    count_turns(table[~(obstacle_rows(table) | table["vehicle_id"].isin(off_motion))], source, counts)
    table = _along_motion(resampled(split(table, counts), source, counts), mapping, off_motion)
    moving = _with_motion(table, mapping)
    _check_walking(moving[obstacle_rows(moving)], names.get("ids", {}), source)
    mapping, moving = _cleaned_if_noisy(table, moving, mapping, source, counts)
    walking = obstacle_rows(moving)
    driving = joined(moving[~walking], counts)
    _tell_overlaps(driving, counts)
    moving = pd.concat([driving, moving[walking]])
    counts.rows = len(moving)
    header = RecordingHeader(
        name=mapping.name,
        source=mapping.source,
        licence=mapping.licence,
        net=mapping.net,
        notes={
            "file": source.name,
            "mapping": mapping.model_dump(exclude_defaults=True),
            **counts.note(),
            **({"cleaned": True} if mapping.clean else {}),
            **names,
        },
    )
    return Recording.from_table(header, moving[list(COLUMNS)], f"{source}, brought to 10 Hz"), counts


def _tell_what_is_left_open(table: pd.DataFrame, mapping: Mapping, counts: Counts) -> None:
    """Tells which vehicles the mapping gives no kind, or a size that holds for all."""
    columns = mapping.columns
    if columns.kind is None:
        counts.tell(
            "unknown",
            f"{table['vehicle_id'].nunique()} vehicles, as the mapping has no field columns.kind: pedestrians and "
            "cyclists among them, too, are vehicles then",
        )
    of_one_size = isinstance(columns.length, float) or isinstance(columns.width, float)
    other = table.loc[table["kind"].isin([Kind.TRUCK, Kind.MOTORCYCLE]), "vehicle_id"].nunique()
    if of_one_size and other:
        counts.tell(
            "sizes",
            f"{other} trucks or motorcycles have the size of all vehicles that fields columns.length and columns.width "
            "of the mapping give as numbers",
        )


def _with_plausible_speeds(
    table: pd.DataFrame, walking: BoolArray, off: pd.Series, mapping: Mapping, source: TableFiles, counts: Counts
) -> pd.DataFrame:
    """Returns `table` with speeds from 0 on; of vehicles `off` their headings by their magnitudes.

    Raises:
        InputError: the motion of vehicles is implausible.
    """
    if "speed" in table:
        table = table.assign(speed=table["speed"].mask(off, table["speed"].abs()))
    for accepted in check_plausible(table[~(walking | off)], mapping, str(source)):
        counts.tell("accepted", accepted)
    if "speed" not in table:
        return table
    if backwards := int((table["speed"] < 0.0).sum()):
        text = f"{backwards} rows below 0, of reversing or standing vehicles, became 0"
        counts.tell("speeds", text, rows_backwards=backwards)
    return table.assign(speed=table["speed"].clip(lower=0.0))


def _tell_overlaps(driving: pd.DataFrame, counts: Counts) -> None:
    """Tells which vehicles overlap for OVERLAP_S or more."""
    if pairs := {pair: count for pair, count in overlaps(driving).items() if count >= OVERLAP_S * RATE_HZ}:
        first, second = max(pairs, key=lambda pair: pairs[pair])
        counts.tell(
            "overlaps",
            f"{len(pairs)} pairs of vehicles overlap for a second or more, above all {first} and {second} for "
            f"{pairs[first, second] * STEP_S:.1f} s: is one of them there twice, or are sizes too large?",
            pairs_that_overlap=len(pairs),
        )


def _cleaned_if_noisy(
    table: pd.DataFrame, moving: pd.DataFrame, mapping: Mapping, source: TableFiles, counts: Counts
) -> tuple[Mapping, pd.DataFrame]:
    """Returns the mapping, which says whether it cleans, and `moving`, of `table`, cleaned if it does or has to.

    Raises:
        RoughMotionError: accelerations are impossible, and the motion is not cleaned.
    """
    walking = obstacle_rows(table)  # not cleaned: the motion model is that of vehicles
    noise = Noise.of(moving[~walking].sort_values(["vehicle_id", "frame"]))
    if mapping.clean is False or not (mapping.clean or noise.needs_cleaning):
        _check_rough(table, moving, source, counts)
        return mapping, moving
    raw = table[~walking].drop(columns="acceleration", errors="ignore")
    ahead = -AHEAD[mapping.reference]
    cleaned = smoothed(raw, ahead=ahead, measured="yaw" in table).sort_values(["vehicle_id", "frame"])
    way = _moved(raw, cleaned, ahead)
    if mapping.clean is None:
        text = noise.described(Noise.of(cleaned), float(way.median()))
        counts.tell("noisy", f"cleaned: {text}", noise=text)
    most = way.groupby(level=0).max()
    far = most[most > FAR].sort_values(ascending=False, kind="stable")
    if len(far):
        ways = ", ".join(f"{vehicle} by {moved:.1f} m" for vehicle, moved in far.head(SHOWN).items())
        counts.tell(
            "cleaned",
            f"{len(far)} vehicles are moved by more than 1 m, above all {ways}: do they reverse?",
            moved_by_cleaning_m={str(vehicle): round(moved, 2) for vehicle, moved in far.items()},
        )
    return mapping.model_copy(update={"clean": True}), pd.concat([cleaned, moving[walking]])


def _check_rough(table: pd.DataFrame, moving: pd.DataFrame, source: TableFiles, counts: Counts) -> None:
    """Refuses motion `moving`, of `table`, with impossible accelerations, and counts harsh ones of vehicles.

    Raises:
        RoughMotionError: accelerations that are derived are impossible.
    """
    harsh = float((np.abs(moving["acceleration"].to_numpy()[~obstacle_rows(moving)]) > HARSH).mean())
    if harsh > HARSH_SHARE:
        share = f"{harsh:.0%} of the accelerations are beyond 5 m/s2"
        counts.tell("rough", f"{share}: field clean of the mapping, set to true, smooths positions")
    if (np.abs(moving["acceleration"]) <= BOUNDS["acceleration"][1]).all() or "acceleration" in table:
        return
    leap = f"; {counts.leaps}, it would not" if counts.leaps else ""
    raise RoughMotionError(
        f"{source}: accelerations derived from the file reach "
        f"{np.abs(moving['acceleration']).max():.3g} m/s2, beyond {HARSH:g} m/s2 in {harsh:.1%} of the "
        f"rows: field clean of the mapping, set to true, smooths such positions{leap}"
    )


def _headings(table: pd.DataFrame, mapping: Mapping) -> FloatArray:
    """Returns headings (n,) [rad] that follow from the motion of the reference point, rows of 10 Hz."""
    lever = (VehicleLimits.rear_axle - AHEAD[mapping.reference]) * table["length"].to_numpy()
    lever = np.zeros(len(table)) if mapping.reference == "box_corner" else lever
    vehicle, x, y = (table[name].to_numpy() for name in ("vehicle_id", "x", "y"))
    return headings(vehicle, x, y, lever)


def _along_motion(table: pd.DataFrame, mapping: Mapping, off_motion: list[int]) -> pd.DataFrame:
    """Returns `table`, rows of 10 Hz, where headings of vehicles that are off their motion follow from it."""
    off = (table["vehicle_id"] % PIECE).isin(off_motion)
    if not off.any():
        return table
    return table.assign(yaw=table["yaw"].mask(off, pd.Series(_headings(table, mapping), table.index)))


def _with_motion(table: pd.DataFrame, mapping: Mapping) -> pd.DataFrame:
    """Returns `table` with box centres, and with heading, speed and acceleration derived where the file lacks them."""
    vehicle, x, y = (table[name].to_numpy() for name in ("vehicle_id", "x", "y"))
    walking = obstacle_rows(table)
    if "yaw" not in table:
        table = table.assign(yaw=_headings(table, mapping))
    if walking.any():
        along = direction_of_motion(vehicle, x, y)
        table = table.assign(yaw=np.where(walking, along, table["yaw"]))
    yaw = wrap_angle(table["yaw"].to_numpy())
    ahead = AHEAD[mapping.reference] * table["length"].to_numpy()
    x, y = x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)
    speed = np.hypot(_rate(vehicle, x), _rate(vehicle, y))
    speed = np.where(walking, speed, table["speed"]) if "speed" in table else speed
    rate = _rate(vehicle, speed)
    rate = np.where(walking, rate, table["acceleration"]) if "acceleration" in table else rate
    return table.assign(x=x, y=y, yaw=yaw, speed=speed, acceleration=rate)


def _check_walking(table: pd.DataFrame, ids: dict[str, int], source: TableFiles) -> None:
    """Refuses pedestrians and cyclists, rows of 10 Hz, who jump; `ids` are names of the file by vehicle_id's numbers.

    Raises:
        InputError: one does.
    """
    jumps = (np.abs(table["acceleration"]) > BOUNDS["acceleration"][1]).to_numpy()
    if not jumps.any():
        return
    first = table.iloc[int(np.argmax(jumps))]
    number = int(first["vehicle_id"]) % PIECE
    who = next((name for name, new in ids.items() if new == number), number)
    raise InputError(
        f"{source}: {Kind(int(first['kind'])).name.lower()} {who} jumps {first['frame'] * STEP_S:.1f} s after frame 0, "
        f"as an acceleration of {first['acceleration']:.0f} m/s2 by its positions shows; {int(jumps.sum())} such rows: "
        f"leave it out by field rows of the mapping, or all of its kind by field kinds"
    )


def _moved(raw: pd.DataFrame, cleaned: pd.DataFrame, ahead: float) -> pd.Series:
    """Returns the displacements (n,) [m], indexed by vehicle, of the point `ahead` lengths ahead of the centre."""
    both = raw.merge(cleaned, on=["vehicle_id", "frame"], suffixes=("", "_cleaned"))
    lever, yaw = ahead * both["length"], both["yaw_cleaned" if "yaw" in raw else "yaw"]
    dx = both["x_cleaned"] + lever * np.cos(yaw) - both["x"]
    dy = both["y_cleaned"] + lever * np.sin(yaw) - both["y"]
    return pd.Series(np.hypot(dx, dy).to_numpy(), index=both["vehicle_id"].to_numpy())


def _rate(vehicle: IntArray, values: FloatArray) -> FloatArray:
    """Returns the time derivative (n,) of `values` (n,) by central differences within vehicles; 0 for a single row."""
    index = np.arange(len(vehicle))
    begins = np.r_[True, vehicle[1:] != vehicle[:-1]]
    ends = np.r_[begins[1:], True]
    before, after = np.where(begins, index, index - 1), np.where(ends, index, index + 1)
    span = np.maximum(after - before, 1) * STEP_S
    return np.asarray((values[after] - values[before]) / span, np.float64)
