"""Repair of the rows of one NGSIM recording (a site and a period), and their conversion to the neutral schema.

Duplicated rows, contradicting rows, missing frames and reused ids are repaired and counted, or refused with the line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from litsim_data.cleaning.cleaning import CleaningReport, clean
from litsim_data.ngsim.reading import on_site
from litsim_data.ngsim.sites import Site
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, BoolArray, FloatArray, IntArray, Kind
from litsim_sim.scenario.recording import BOUNDS, COLUMNS

HOLE_MAX = 5  # [frames] longest hole that is interpolated; a longer one splits the track
JUMP_MAX = 8.0  # [m] per frame; a longer step splits the track: it is another vehicle
TRACK_MIN = 5  # [frames] shorter tracks are left out
SAME_PLACE = 0.3  # [m] rows of one vehicle and frame that differ by no more are duplicates
CONTRADICTIONS_MAX = 0.01  # share of contradicting rows above which the file is refused
SIZES_MAX = 0.01  # share of vehicles without a plausible size above which the file is refused
PIECE = 1_000_000
"""Added to the Vehicle_ID of the second, twice to that of the third piece of a split track, and so on."""

KINDS = {1: Kind.MOTORCYCLE, 2: Kind.CAR, 3: Kind.TRUCK}  # by v_Class
USUAL_SIZE = {Kind.MOTORCYCLE: (2.2, 0.9), Kind.CAR: (4.6, 2.0), Kind.TRUCK: (12.0, 2.5), Kind.UNKNOWN: (4.6, 2.0)}

SMOOTHED = 5  # frames to either side over which the direction of a raw track is taken
DIRECTION_MIN = 0.5  # [m] shortest displacement with a direction

NEEDED = (
    *("vehicle_id", "frame", "total_frames", "time_ms", "local_x", "local_y", "global_x", "global_y"),
    *("length", "width", "vehicle_class", "speed", "acceleration", "lane", "direction"),
)
"""Columns of the file that are needed; `total_frames` and `direction` may be absent."""


@dataclass
class RepairCounts:
    """Counts of the repairs of one recording.

    Attributes:
        rows: rows of the file that belong to it.
        off_site: rows left out because they are far from the site.
        duplicates: rows left out because they repeat another one.
        contradictions: rows left out because another one has the vehicle elsewhere at that time.
        filled: frames interpolated in short holes.
        splits: cuts of tracks at long holes or jumps.
        short_tracks: tracks left out because they are shorter than half a second.
        sizes: vehicles with an implausible size, replaced by that of their class.
        incomplete: vehicles with fewer frames than column Total_Frames says.
    """

    rows: int = 0
    off_site: int = 0
    duplicates: int = 0
    contradictions: int = 0
    filled: int = 0
    splits: int = 0
    short_tracks: int = 0
    sizes: int = 0
    incomplete: int = 0

    def text(self) -> str:
        """Returns the non-zero counts with their names, as one line."""
        return ", ".join(f"{name} {count}" for name, count in vars(self).items() if count)


def tracks_of(raw: pd.DataFrame, site: Site, where: str) -> tuple[pd.DataFrame, RepairCounts]:
    """Makes tracks of the rows of one recording.

    Args:
        raw: columns NEEDED (SI units, global axes) and `line`; rows in any order.
        site: site of the recording.
        where: the file, for errors.

    Returns:
        The tracks at 10 Hz without holes, sorted by vehicle and frame: vehicle_id, frame, x, y (FRONT centre, frame map
        [m]), length, width [m], kind, lane, speed, acceleration as published, and `hint`, the usual heading [rad] of
        the row's Direction (NaN if unknown); and the counts of repairs.

    Raises:
        InputError: too many rows are off the site or contradict each other, too many sizes are implausible, or nothing
            is left.
    """
    counts = RepairCounts(rows=len(raw))
    raw = on_site(raw, site, where)
    counts.off_site = counts.rows - len(raw)
    raw = _without_duplicates(raw, counts, where)
    x, y = site.map_from_global(raw["global_x"].to_numpy(), raw["global_y"].to_numpy())
    table = raw.assign(x=x, y=y)
    table = _without_contradictions(table, counts, where)
    if "total_frames" in table:
        counted = table.groupby("vehicle_id")["total_frames"].agg(["max", "size"])
        counts.incomplete = int((counted["size"] < counted["max"]).sum())
    table = _split(table, counts)
    if table.empty:
        raise InputError(f"{where}: no track of {TRACK_MIN} frames or more is left of {counts.rows} rows")
    table = _sized(table, counts, where)
    return _filled(table, site, counts), counts


def neutral(tracks: pd.DataFrame, *, cleaned: bool) -> tuple[pd.DataFrame, CleaningReport | None]:
    """Returns tracks in the columns of the neutral schema, and the report on their cleaning (None without).

    Args:
        tracks: see :func:`tracks_of`.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions; else speed and
            acceleration stay as published, and yaw is the direction of motion over a second.

    Raises:
        InputError: the tracks cannot be cleaned.
    """
    if cleaned:
        table = tracks.drop(columns="hint")
        if tracks["hint"].notna().all():
            table = table.assign(yaw=tracks["hint"])
        return clean(table)
    yaw = direction_of_motion(
        tracks["vehicle_id"].to_numpy(), tracks["x"].to_numpy(), tracks["y"].to_numpy(), tracks["hint"].to_numpy()
    )
    half = 0.5 * tracks["length"].to_numpy()
    table = tracks.assign(x=tracks["x"] - half * np.cos(yaw), y=tracks["y"] - half * np.sin(yaw), yaw=yaw)
    return table[list(COLUMNS)], None


def direction_of_motion(
    vehicle: IntArray, x: FloatArray, y: FloatArray, hint: FloatArray, least: float = DIRECTION_MIN
) -> FloatArray:
    """Returns the heading [rad] (n,) from the way between half a second before and after; held where a vehicle stands.

    Args:
        vehicle: (n,) ids; rows of one vehicle are consecutive frames.
        x, y: (n,) [m].
        hint: (n,) heading of vehicles that never move, NaN for 0.
        least: way [m] below which a vehicle stands.
    """
    index = np.arange(len(vehicle))
    first = np.flatnonzero(np.r_[True, vehicle[1:] != vehicle[:-1]])
    track = np.cumsum(np.r_[True, vehicle[1:] != vehicle[:-1]]) - 1
    last = np.r_[first[1:], len(vehicle)] - 1
    before, after = np.maximum(index - SMOOTHED, first[track]), np.minimum(index + SMOOTHED, last[track])
    dx, dy = x[after] - x[before], y[after] - y[before]
    moves = np.hypot(dx, dy) >= least
    yaw = pd.Series(np.where(moves, np.arctan2(dy, dx), np.nan))
    held = yaw.groupby(track).ffill().groupby(track).bfill().to_numpy()
    return np.where(np.isnan(held), np.nan_to_num(hint), held)


def _without_duplicates(raw: pd.DataFrame, counts: RepairCounts, where: str) -> pd.DataFrame:
    content = [name for name in raw.columns if name != "line"]
    single = raw.drop_duplicates(content)
    counts.duplicates = len(raw) - len(single)
    if (single["vehicle_id"].abs() >= PIECE).any():
        at = single.loc[single["vehicle_id"].abs() >= PIECE].iloc[0]
        raise InputError(
            f"{where}: line {at['line']:.0f}: Vehicle_ID is {at['vehicle_id']:.0f}, expected below {PIECE}"
        )
    return single.sort_values(["vehicle_id", "frame", "line"], ignore_index=True)


def _without_contradictions(table: pd.DataFrame, counts: RepairCounts, where: str) -> pd.DataFrame:
    """Returns one row per vehicle and frame: rows at the same place are merged, contradicting ones are all left out."""
    vehicle, frame = table["vehicle_id"].to_numpy(), table["frame"].to_numpy()
    again = np.r_[False, (vehicle[1:] == vehicle[:-1]) & (frame[1:] == frame[:-1])]
    if not again.any():
        return table
    group = np.cumsum(~again) - 1
    first = np.flatnonzero(~again)[group]
    apart = np.hypot(table["x"] - table["x"].to_numpy()[first], table["y"] - table["y"].to_numpy()[first]).to_numpy()
    contradicted = np.zeros(group[-1] + 1, np.bool_)
    contradicted[group[apart > SAME_PLACE]] = True
    wrong = contradicted[group]
    counts.contradictions = int(wrong.sum())
    counts.duplicates += int((again & ~wrong).sum())
    if counts.contradictions > CONTRADICTIONS_MAX * len(table):
        at = int(np.argmax(wrong & again))
        lines = table["line"].to_numpy()[[first[at], at]]
        raise InputError(
            f"{where}: lines {lines[0]} and {lines[1]}: Vehicle_ID {vehicle[at]} is at two places at frame "
            f"{frame[at]}, {apart[at]:.1f} m apart; {counts.contradictions} of {len(table)} rows contradict each other"
        )
    return table[~wrong & ~again].reset_index(drop=True)


def _sized(table: pd.DataFrame, counts: RepairCounts, where: str) -> pd.DataFrame:
    """Returns `table` with kinds, and one plausible size per vehicle: its median, or that of its class."""
    kind = table["vehicle_class"].map(KINDS).fillna(int(Kind.UNKNOWN)).astype("uint8")
    table = table.assign(kind=kind)
    vehicles = table.groupby("vehicle_id")[["length", "width", "kind"]].median()
    bad = pd.Series(data=False, index=vehicles.index)
    for column, name in enumerate(("length", "width")):
        low, high = BOUNDS[name]
        wrong = ~vehicles[name].between(low, high)
        usual = vehicles["kind"].map(lambda k, column=column: USUAL_SIZE.get(k, USUAL_SIZE[Kind.UNKNOWN])[column])
        vehicles[name] = vehicles[name].where(~wrong, usual)
        bad |= wrong
    counts.sizes = int(bad.sum())
    if counts.sizes > max(1.0, SIZES_MAX * len(vehicles)):
        row = table[table["vehicle_id"] == bad.index[bad][0]].iloc[0]
        raise InputError(
            f"{where}: line {row['line']:.0f}: Vehicle_ID {row['vehicle_id']:.0f} is {row['length']:.2f} m long and "
            f"{row['width']:.2f} m wide; {counts.sizes} of {len(vehicles)} vehicles have no plausible size"
        )
    sizes = vehicles[["length", "width"]].reindex(table["vehicle_id"])
    return table.assign(length=sizes["length"].to_numpy(), width=sizes["width"].to_numpy())


def _split(table: pd.DataFrame, counts: RepairCounts) -> pd.DataFrame:
    """Returns tracks cut at long holes and jumps, with the pieces renumbered and short ones left out."""
    vehicle, frame = table["vehicle_id"].to_numpy(), table["frame"].to_numpy()
    same = vehicle[1:] == vehicle[:-1]
    step = np.diff(frame)
    moved = np.hypot(np.diff(table["x"].to_numpy()), np.diff(table["y"].to_numpy()))
    cut = same & ((step > HOLE_MAX + 1) | (moved > JUMP_MAX * np.maximum(step, 1)))
    counts.splits = int(cut.sum())
    begins = np.r_[True, ~same]  # first rows of vehicles
    cuts = np.cumsum(np.r_[False, cut])
    piece = cuts - cuts[np.flatnonzero(begins)][np.cumsum(begins) - 1]
    table = table.assign(vehicle_id=vehicle + PIECE * piece)
    track = np.cumsum(begins | np.r_[False, cut]) - 1
    first = np.flatnonzero(np.diff(track, prepend=-1))
    span = frame[np.append(first[1:], len(frame)) - 1] - frame[first] + 1
    keep = (span >= TRACK_MIN)[track]
    counts.short_tracks = int((span < TRACK_MIN).sum())
    return table[keep].reset_index(drop=True)


def _filled(table: pd.DataFrame, site: Site, counts: RepairCounts) -> pd.DataFrame:
    """Returns the columns of :func:`tracks_of`, with short holes interpolated."""
    vehicle, frame = table["vehicle_id"].to_numpy(), table["frame"].to_numpy()
    begins = np.r_[True, vehicle[1:] != vehicle[:-1]]
    step = np.r_[np.diff(frame), 1]
    ends = np.r_[begins[1:], True]
    repeat = np.where(ends, 1, step)  # a row stands for itself and the missing frames after it
    source = np.repeat(np.arange(len(table)), repeat)
    offset = np.arange(len(source)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    counts.filled = int((offset > 0).sum())
    share = offset / np.repeat(repeat, repeat)
    target = np.minimum(source + (offset > 0), len(table) - 1)

    def between(name: str) -> FloatArray:
        values = table[name].to_numpy(np.float64)
        return (1.0 - share) * values[source] + share * values[target]

    lane = table["lane"].to_numpy()
    plausible = (lane >= 1) & (lane <= int(BOUNDS["lane"][1]))
    return pd.DataFrame(
        {
            "vehicle_id": vehicle[source],
            "frame": frame[source] + offset,
            "x": between("x"),
            "y": between("y"),
            "length": table["length"].to_numpy()[source],
            "width": table["width"].to_numpy()[source],
            "kind": table["kind"].to_numpy()[source],
            "lane": np.where(plausible, lane, -1)[source],
            "speed": np.clip(between("speed"), 0.0, None),
            "acceleration": between("acceleration"),
            "hint": _hints(table, site)[source],
        }
    )


def _hints(table: pd.DataFrame, site: Site) -> FloatArray:
    """Returns usual headings (n,) [rad] by Direction; the vehicle's median or 0 if unknown; NaN on motorways."""
    if "direction" not in table or len(site.headings) < 2:
        return np.full(len(table), np.nan)
    hint = table["direction"].map(site.headings).astype(np.float64)
    usual = hint.groupby(table["vehicle_id"]).transform("median")  # for an odd number of codes, one of them
    known: BoolArray = np.isin(usual, list(site.headings.values()))
    usual = usual.where(known, 0.0)
    return np.asarray(hint.fillna(usual), np.float64)


def origins_of(time_ms: IntArray, frame: IntArray) -> IntArray:
    """Returns the time (n,) [ms] of frame 0 by the clock of each row; every period has its own."""
    return time_ms - np.round(1000.0 / RATE_HZ * frame).astype(np.int64)
