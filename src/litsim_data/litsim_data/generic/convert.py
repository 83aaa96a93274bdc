"""Conversion of a table of trajectories to a recording, by its mapping."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd

from litsim_data.cleaning.cleaning import smoothed
from litsim_data.cleaning.noise import HARSH, Noise
from litsim_data.cleaning.report import overlaps
from litsim_data.generic.checks import check_plausible, heading, off_their_motion
from litsim_data.generic.counts import Counts
from litsim_data.generic.draft import likely_kind
from litsim_data.generic.headings import direction_of_motion, headings
from litsim_data.generic.heights import levels
from litsim_data.generic.mapping import FACTORS, KindName, Mapping
from litsim_data.generic.obstacles import NAMES as OBSTACLES
from litsim_data.generic.obstacles import obstacle_rows, with_usual_sizes, without_unused
from litsim_data.generic.reading import plain, read_rows, texts
from litsim_data.generic.resampling import (
    HOLE_MAX_S,
    PIECE,
    check_clock,
    count_leaps,
    count_turns,
    in_order,
    resampled,
    split,
    without_outliers,
)
from litsim_data.generic.towing import joined
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import RATE_HZ, STEP_S, FloatArray, IntArray, Kind
from litsim_sim.io.table_input import TableFiles, is_stamped, since_1970
from litsim_sim.scenario.recording import BOUNDS, COLUMNS, Recording, RecordingHeader

IDS_KEPT = 5000  # most renumbered vehicle ids that the header lists
DROP, UNKNOWN = "drop", "unknown"
FAR = 1.0  # [m] displacement by cleaning beyond which a vehicle is reported
OVERLAP_S = 1.0  # [s] for which a pair of vehicles must overlap to be reported
CLOCK = "time_of_frame_0_s"  # note of the header: clock time of the file at frame 0
AHEAD = {"front_centre": -0.5, "box_centre": 0.0, "rear_axle": VehicleLimits.rear_axle, "box_corner": 0.0}
"""Distance of the box centre ahead of the reference point, in lengths; corners are converted to centres on reading."""
NUMBER_MAX = 1e20  # of any column, such as times since 1970 in ns; squares of larger ones overflow
DERIVED = ("yaw", "speed", "acceleration")  # optional columns
NUMBERS = {kind.name.lower(): int(kind) for kind in Kind}


class RoughMotionError(InputError):
    """Positions or speeds are so noisy that accelerations derived from them are impossible; cleaning helps."""


def convert(tables: Path | Sequence[Path] | TableFiles, mapping: Mapping) -> tuple[Recording, Counts]:
    """Returns `tables` (CSV or Parquet, one file or several) as a recording, and counts of the conversion.

    Raises:
        InputError: a column is missing, a cell is not a number, a vehicle is at two places at a time or jumps too
            often, a kind is not in the mapping, the motion is implausible, or the result fails a check of
            :meth:`Recording.from_table`.
    """
    source, counts = tables if isinstance(tables, TableFiles) else TableFiles.open(tables), Counts()
    raw_table = _without_dropped_kinds(read_rows(source, mapping, counts), mapping, source, counts)
    table, names = _in_si(without_unused(raw_table), mapping, source)
    check_clock(table, source)
    table = in_order(table, source, counts)
    counts.levels = levels(table, source)
    walking = obstacle_rows(table)
    counts.off_motion = [] if "heading" in mapping.accept else off_their_motion(table[~walking], mapping)
    off = table["vehicle_id"].isin(counts.off_motion)
    if "speed" in table:
        table = table.assign(speed=table["speed"].mask(off, table["speed"].abs()))
    counts.accepted = check_plausible(table[~(walking | off)], mapping, str(source))
    if "speed" in table:  # below 0 of reversing vehicles, or of noise around 0
        counts.backwards = int((table["speed"] < 0.0).sum())
        table = table.assign(speed=table["speed"].clip(lower=0.0))
    table = with_usual_sizes(table, mapping, counts)
    columns = mapping.columns
    counts.kindless = int(table["vehicle_id"].nunique()) if columns.kind is None else 0
    if not (isinstance(columns.length, str) and isinstance(columns.width, str)):
        other = table["kind"].isin([Kind.TRUCK, Kind.MOTORCYCLE])
        counts.of_one_size = int(table.loc[other, "vehicle_id"].nunique())
    table = without_outliers(table, source, counts)
    count_leaps(table[~obstacle_rows(table)], source, counts)
    count_turns(table[~(obstacle_rows(table) | table["vehicle_id"].isin(counts.off_motion))], source, counts)
    table = _along_motion(resampled(split(table, counts), source, counts), mapping, counts)
    moving = _with_motion(table, mapping)
    _check_walking(moving[obstacle_rows(moving)], names.get("ids", {}), source)
    mapping, moving = _cleaned_if_noisy(table, moving, mapping, source, counts)
    walking = obstacle_rows(moving)
    driving, counts.joined, counts.towed = joined(moving[~walking])
    moving = pd.concat([driving, moving[walking]])
    counts.rows = len(moving)
    frames = overlaps(driving)
    counts.overlaps = {pair: count * STEP_S for pair, count in frames.items() if count >= OVERLAP_S * RATE_HZ}
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
    most = way.groupby(level=0).max()
    far = most[most > FAR]
    counts.moved = dict(zip(far.index.tolist(), far.tolist(), strict=True))
    if mapping.clean is None:
        counts.noisy = noise.described(Noise.of(cleaned), float(way.median()))
    return mapping.model_copy(update={"clean": True}), pd.concat([cleaned, moving[walking]])


def _check_rough(table: pd.DataFrame, moving: pd.DataFrame, source: TableFiles, counts: Counts) -> None:
    """Refuses motion `moving`, of `table`, with impossible accelerations, and counts harsh ones of vehicles.

    Raises:
        RoughMotionError: accelerations that are derived are impossible.
    """
    harsh = np.abs(moving["acceleration"].to_numpy()[~obstacle_rows(moving)]) > HARSH
    counts.harsh = float(harsh.mean())
    if (np.abs(moving["acceleration"]) <= BOUNDS["acceleration"][1]).all() or "acceleration" in table:
        return
    leap = f"; {counts.leaps} leaps, at most {counts.farthest_leap}, it would not" if counts.leaps else ""
    raise RoughMotionError(
        f"{source}: accelerations derived from the file reach "
        f"{np.abs(moving['acceleration']).max():.3g} m/s2, beyond {HARSH:g} m/s2 in {counts.harsh:.1%} of the "
        f"rows: field clean of the mapping, set to true, smooths such positions{leap}"
    )


def _in_si(raw: pd.DataFrame, mapping: Mapping, source: TableFiles) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Returns columns in SI units and frame map: vehicle_id, t [s], x, y, length, width, kind, lane, row, and yaw,
    speed and acceleration where given; and notes on ids and clock for the header.
    """
    units, columns = mapping.units, mapping.columns
    row = raw["row"].to_numpy()

    def numbers(name: str, unit: str = "m") -> FloatArray:
        values = pd.to_numeric(raw[name], errors="coerce").to_numpy(np.float64, na_value=np.nan)
        bad = ~(np.abs(values) <= NUMBER_MAX)
        if bad.any():
            first_bad = int(np.argmax(bad))
            ours = name.removesuffix("_x").removesuffix("_y")
            theirs, cell = columns.named()[name], raw[name].iloc[first_bad]
            without = (
                f"; without field columns.{ours} it is derived from the motion, and rows: {{{theirs}: {{min: -1000}}}} "
                "leaves such rows out, with gaps of up to half a second interpolated"
            ) * (ours in DERIVED)
            content = "empty or nan" if pd.isna(cell) else repr(str(cell))
            most = "" if np.isnan(values[first_bad]) else f" of at most {NUMBER_MAX:g}"
            raise InputError(
                f"{source.at(row[first_bad])}: column {theirs!r} is {content}, expected a number{most}; "
                f"{int(bad.sum())} such rows{without}"
            )
        return values * FACTORS[unit]

    ids, names = _ids(raw["vehicle_id"], row, source)
    if columns.time is None:
        time = numbers("frame") / mapping.rate_hz
    else:  # frame 0 is the first one
        stamped = is_stamped(raw["time"])
        raw = raw.assign(time=since_1970(raw["time"])) if stamped else raw
        time = numbers("time", "s" if stamped else units.time)
        zero = float(np.floor(time.min() * RATE_HZ) / RATE_HZ)
        time, names = time - zero, {CLOCK: round(zero, 6) + 0.0} | names
    turn, mirror = np.deg2rad(mapping.transform.yaw_deg), -1.0 if mapping.transform.mirror_y else 1.0
    sizes = {}
    for name in ("length", "width"):
        size = getattr(columns, name)
        sizes[name] = numbers(name, units.size) if isinstance(size, str) else size * FACTORS[units.size]
    x, y = numbers("x", units.position), numbers("y", units.position)
    if mapping.reference == "box_corner":
        x, y = x + 0.5 * sizes["length"], y + 0.5 * sizes["width"]
    y = mirror * y
    table = pd.DataFrame(
        {
            "vehicle_id": ids,
            "t": time,
            "x": mapping.transform.x + np.cos(turn) * x - np.sin(turn) * y,
            "y": mapping.transform.y + np.sin(turn) * x + np.cos(turn) * y,
            "row": row,
            "kind": raw["kind"].map(NUMBERS).to_numpy(np.int64) if "kind" in raw else int(Kind.UNKNOWN),
            "lane": numbers("lane") if columns.lane is not None else -1.0,
        }
    )
    table = table.assign(**sizes)
    if columns.yaw is not None:
        angle = heading(numbers("yaw", units.angle), mapping.angles.zero, mapping.angles.positive)
        table["yaw"] = mirror * angle + turn
    if isinstance(columns.speed, tuple):
        table["speed"] = np.hypot(numbers("speed_x", units.speed), numbers("speed_y", units.speed))
    elif columns.speed is not None:
        table["speed"] = numbers("speed", units.speed)
    if columns.acceleration is not None:
        table["acceleration"] = numbers("acceleration", units.acceleration)
    return table, names


def _ids(column: pd.Series, row: IntArray, source: TableFiles) -> tuple[IntArray, dict[str, Any]]:
    """Returns ids as integers: small integers stay; others are numbered on from the largest of these, or from 1.

    Raises:
        InputError: an id is missing, or there are too many.
    """
    if (empty := column.isna().to_numpy()).any():
        raise InputError(f"{source.at(row[empty][0])}: no vehicle id; {int(empty.sum())} such rows")
    codes, names = pd.factorize(texts(column))
    numeric = pd.to_numeric(pd.Series(names), errors="coerce")
    small = (numeric.between(0, PIECE - 1) & (numeric == np.floor(numeric)) & ~numeric.duplicated()).to_numpy()
    first = int(numeric[small].max()) + 1 if small.any() else 1
    others = int((~small).sum())
    if first + others > PIECE:
        raise InputError(
            f"{source}: {others} vehicles with ids that are not integers below {PIECE}, to be numbered from {first}: "
            f"expected fewer than {PIECE} vehicles"
        )
    numbers = np.where(small, numeric.fillna(0.0), first + np.cumsum(~small) - 1).astype(np.int64)
    if not others:
        return numbers[codes], {}
    renumbered = {str(name): int(number) for name, number in zip(names[~small], numbers[~small], strict=True)}
    return numbers[codes], {"ids": renumbered} if others <= IDS_KEPT else {"ids_renumbered": others}


def _without_dropped_kinds(raw: pd.DataFrame, mapping: Mapping, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns the rows of kinds that the mapping keeps, with column `kind` translated by it."""
    if "kind" not in raw:
        return raw
    kind_names, kinds = texts(raw["kind"]), {plain(name): ours for name, ours in mapping.kinds.items()}
    if missing := sorted(set(kind_names.unique()) - set(kinds)):
        row = raw["row"][kind_names == missing[0]].iloc[0]
        entries = ", ".join(f"{name!r}: {likely_kind(name)}" for name in missing)
        raise InputError(
            f"{source.at(row)}: kind {missing[0]!r} is not in field kinds of the mapping, which needs an entry for "
            f"each value of column {mapping.columns.kind!r}, one of {', '.join(get_args(KindName))}: for those that "
            f"are missing, probably kinds: {{{entries}}}"
        )
    row_kind = kind_names.map(kinds)
    ours = _of_whole_tracks(row_kind, raw, mapping, counts)
    for kind in sorted(set(kind_names[row_kind == DROP])):
        counts.leave_out(f"kind {kind}", int(((kind_names == kind) & (ours == DROP)).sum()))
    counts.leave_out("of a track most of whose rows are dropped", int(((row_kind != DROP) & (ours == DROP)).sum()))
    for kind in sorted(set(kind_names[ours == UNKNOWN])):
        counts.unknown[kind] = int(raw["vehicle_id"][kind_names == kind].nunique())
    if ours.isin([DROP, *OBSTACLES]).all():
        every = (
            "field kinds of the mapping drops every row"
            if (ours == DROP).all()
            else "only pedestrians and cyclists are left"
        )
        raise InputError(f"{source}: {every}; the kinds are {sorted(set(kind_names))}")
    return raw.assign(kind=ours)[ours != DROP]


def _of_whole_tracks(row_kind: pd.Series, raw: pd.DataFrame, mapping: Mapping, counts: Counts) -> pd.Series:
    """Returns, for each row of `raw`, the kind that most rows of its track have, as trackers change their minds.

    Tracks end at long holes: trackers use an id again for another object.
    """
    ids, _ = pd.factorize(raw["vehicle_id"])
    kinds, names = pd.factorize(row_kind)
    if (pd.DataFrame({"id": ids, "kind": kinds}).drop_duplicates()["id"].value_counts() == 1).all():
        return row_kind
    if mapping.columns.time is not None and is_stamped(raw["time"]):
        t = since_1970(raw["time"]).to_numpy(np.float64)
    else:  # NaN for cells that are no time
        by_frame = mapping.columns.time is None
        name, unit = ("frame", 1.0 / mapping.rate_hz) if by_frame else ("time", FACTORS[mapping.units.time])
        t = pd.to_numeric(raw[name], errors="coerce").to_numpy(np.float64, na_value=np.nan) * unit
    order = np.lexsort([t, ids])
    begins = np.r_[True, (np.diff(ids[order]) != 0) | (np.diff(t[order]) > HOLE_MAX_S + STEP_S)]
    track = np.empty(len(ids), np.int64)
    track[order] = np.cumsum(begins) - 1
    rows = np.zeros((track.max() + 1, len(names)), np.int64)
    np.add.at(rows, (track, kinds), 1)
    counts.changing = int(((rows > 0).sum(axis=1) > 1).sum())
    return pd.Series(np.asarray(names)[rows.argmax(axis=1)][track], index=row_kind.index)


def _headings(table: pd.DataFrame, mapping: Mapping) -> FloatArray:
    """Returns headings (n,) [rad] that follow from the motion of the reference point, rows of 10 Hz."""
    lever = (VehicleLimits.rear_axle - AHEAD[mapping.reference]) * table["length"].to_numpy()
    lever = np.zeros(len(table)) if mapping.reference == "box_corner" else lever
    vehicle, x, y = (table[name].to_numpy() for name in ("vehicle_id", "x", "y"))
    return headings(vehicle, x, y, lever)


def _along_motion(table: pd.DataFrame, mapping: Mapping, counts: Counts) -> pd.DataFrame:
    """Returns `table`, rows of 10 Hz, where headings of vehicles that are off their motion follow from it."""
    off = (table["vehicle_id"] % PIECE).isin(counts.off_motion)
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
