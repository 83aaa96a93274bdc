"""Resampling of tracks with rows at arbitrary times to 10 Hz."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.counts import Counts
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import RATE_HZ, STEP_S, BoolArray, IntArray
from litsim_sim.io.table_input import TableFiles

PIECE = 1_000_000
"""Added to the id of the second, twice to that of the third piece of a split track, and so on."""
JUMP_MAX = 8.0  # [m] per frame; a longer step splits the track: it is another vehicle
HOLE_MAX_S = 0.5  # [s] longest hole that is interpolated; a longer one splits the track
EDGE = 1e-4  # [frames] tolerance of times at frames; above the rounding of seconds since 1970
AWAY_MAX_S = 0.5  # [s] shorter stretches between two jumps are errors and left out
LEAP, LEAP_ACCELERATION = 2.0, 15.0  # [m], [m/s2] by which no vehicle departs between two rows from its motion around
TURN, TURN_RATE = np.deg2rad(30.0), 3.0  # [rad], [rad/s] by which no vehicle turns between two rows
AROUND = 3  # steps before and after that this motion is the median of
CONTRADICTIONS_MAX = 0.01  # share of rows that contradict each other above which the file is refused
FALL_MIN_S = 60.0  # [s] by which a clock that begins anew falls back at least
PADDED_MIN = 10  # rows of vehicles at one place at one time that are no chance
JUMPS_MAX = 0.01  # share of rows left out or following a jump above which the file is refused


def check_clock(table: pd.DataFrame, source: TableFiles) -> None:
    """Refuses rows, in the order of the file, whose clock begins anew while a vehicle drives on, such as at midnight.

    Raises:
        InputError: times of a vehicle fall back by more than FALL_MIN_S between two rows that are as near to each
            other as those before and after.
    """
    rows = table.sort_values("vehicle_id", kind="stable")
    t, vehicle = rows["t"].to_numpy(), rows["vehicle_id"].to_numpy()
    step, way = np.diff(t), np.hypot(np.diff(rows["x"].to_numpy()), np.diff(rows["y"].to_numpy()))
    on = (step > 0.0) & (step <= HOLE_MAX_S + STEP_S) & (way > 0.0)
    near = way[1:-1] <= 2.0 * np.maximum(way[:-2], way[2:])
    falls = (step[1:-1] < -FALL_MIN_S) & on[:-2] & on[2:] & near & (vehicle[3:] == vehicle[:-3])
    if falls.any():
        row = int(np.argmax(falls)) + 2
        raise InputError(
            f"{source.place(rows['row'].iloc[row])}: the clock falls back by {-step[row - 1]:.1f} s, while vehicle "
            f"{vehicle[row]} drives on: expected times that go on, past midnight, too"
        )


def in_order(table: pd.DataFrame, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns rows sorted by vehicle and time, without exact copies, nor the few that contradict each other.

    Raises:
        InputError: vehicles have different rows at one time, in a share of more than CONTRADICTIONS_MAX.
    """
    single = table.drop_duplicates([name for name in table.columns if name != "row"])
    counts.leave_out("exact copy of another", len(table) - len(single))
    table = single.sort_values(["vehicle_id", "t", "row"], ignore_index=True)
    vehicle, step = table["vehicle_id"].to_numpy(), np.diff(table["t"].to_numpy())
    twice = (vehicle[1:] == vehicle[:-1]) & (step <= 1e-9)
    if not twice.any():
        return table
    contradict = np.r_[False, twice] | np.r_[twice, False]
    if contradict.sum() > CONTRADICTIONS_MAX * len(table):
        first = int(np.argmax(twice))
        rows = table["row"].to_numpy()[first : first + 2]
        raise InputError(
            f"{source.place(*rows)}: vehicle {vehicle[first]} occurs twice at "
            f"{table['t'].iloc[first]:.3f} s, with other values; {int(twice.sum())} such pairs; are there several "
            f"clips in the file (field columns.clip of the mapping)?"
        )
    counts.leave_out("another row has the same vehicle and time, and other values", int(contradict.sum()))
    return table[~contradict].reset_index(drop=True)


def without_outliers(table: pd.DataFrame, source: TableFiles, counts: Counts) -> pd.DataFrame:
    """Returns the rows, in order, without stretches of less than half a second between two jumps of a vehicle.

    Raises:
        InputError: vehicles jump to one place, as rows of absent ones do; or there are so many jumps that rows of one
            id cannot be of one vehicle.
    """
    vehicle, t = table["vehicle_id"].to_numpy(), table["t"].to_numpy()
    jumps = _jumps(table)
    if not jumps.any():
        return table
    _check_padding(table, jumps, source)
    begins = np.r_[True, vehicle[1:] != vehicle[:-1]]
    stretch = np.cumsum(begins | jumps) - 1  # stretch of each row: tracks, cut at jumps
    first = np.flatnonzero(begins | jumps)
    last = np.r_[first[1:], len(table)] - 1
    whole = begins[first] & np.r_[begins[first[1:]], True]
    away = ((t[last] - t[first] < AWAY_MAX_S) & ~whole)[stretch]
    if max(int(away.sum()), int(jumps.sum())) > max(JUMPS_MAX * len(table), 2):
        jump = int(np.argmax(jumps))
        rows = table.iloc[jump - 1 : jump + 1]
        way = float(np.hypot(*np.diff(rows[["x", "y"]].to_numpy(), axis=0)[0]))
        raise InputError(
            f"{source.place(*rows['row'])}: vehicle {vehicle[jump]} moves by {way:.4g} m within "
            f"{t[jump] - t[jump - 1]:.3g} s; {int(jumps.sum())} such jumps: does every vehicle have its own id?"
        )
    counts.leave_out("the vehicle jumps elsewhere for less than half a second", int(away.sum()))
    return table[~away].reset_index(drop=True)


def _check_padding(table: pd.DataFrame, jumps: BoolArray, source: TableFiles) -> None:
    """Refuses rows with a fixed value where a vehicle is absent, which put several that jump there at one place."""
    jumping = table[table["vehicle_id"].isin(table["vehicle_id"][jumps])]
    same = jumping[jumping.duplicated(["t", "x", "y"], keep=False)]
    if len(same) < PADDED_MIN:
        return
    x, y = (float(value) for value in np.asarray(same[["x", "y"]].value_counts().index[0]))
    padded = same[(same["x"] == x) & (same["y"] == y)]
    raise InputError(
        f"{source.place(padded['row'].iloc[0])}: {padded['vehicle_id'].nunique()} vehicles jump to one place, "
        f"({x:g}, {y:g}) in frame map, where several are at once in {len(padded)} rows: are they absent there? Leave "
        f"such rows out by field rows of the mapping"
    )


def split(table: pd.DataFrame, counts: Counts) -> pd.DataFrame:
    """Returns tracks cut at long holes and jumps, with the pieces renumbered; rows are in order."""
    vehicle, step = table["vehicle_id"].to_numpy(), np.diff(table["t"].to_numpy())
    same = vehicle[1:] == vehicle[:-1]
    begins = np.r_[True, ~same]
    hole = np.r_[False, same & (step > HOLE_MAX_S + STEP_S)]
    jumps = _jumps(table) & ~hole
    cuts = np.cumsum(hole | jumps)
    piece = cuts - cuts[np.flatnonzero(begins)][np.cumsum(begins) - 1]
    counts.jumps = int(jumps.sum())
    counts.tracks = int(begins.sum())
    counts.pieces = counts.tracks + int(cuts[-1])
    return table.assign(vehicle_id=vehicle + PIECE * piece)


def resampled(table: pd.DataFrame, source: TableFiles | Path, counts: Counts) -> pd.DataFrame:
    """Returns every track at the 10 Hz frames within its time span; values between rows are interpolated.

    Tracks without such a frame are left out.

    Raises:
        InputError: no track is left.
    """
    pieces = []
    for vehicle, rows in table.groupby("vehicle_id", sort=True):
        t = rows["t"].to_numpy()
        first, last = int(np.ceil(t[0] * RATE_HZ - EDGE)), int(np.floor(t[-1] * RATE_HZ + EDGE))
        if last < first:
            counts.too_short += 1
            continue
        frame = np.arange(first, last + 1)
        times = frame * STEP_S
        values: dict[str, Any] = {"vehicle_id": vehicle, "frame": frame}
        for name in ("x", "y", "speed", "acceleration"):
            if name in rows:
                values[name] = np.interp(times, t, rows[name].to_numpy())
        if "yaw" in rows:
            values["yaw"] = np.interp(times, t, np.unwrap(rows["yaw"].to_numpy()))
        after = np.clip(np.searchsorted(t, times - EDGE * STEP_S), 0, len(t) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(times - t[before] < t[after] - times, before, after)
        for name in ("length", "width"):
            values[name] = float(rows[name].median())
        for name in ("kind", "lane"):
            values[name] = rows[name].to_numpy()[nearest]
        pieces.append(pd.DataFrame(values))
    if not pieces:
        raise InputError(f"{source}: no vehicle is seen at a frame of 10 Hz: are times in the unit of the mapping?")
    tracks = pd.concat(pieces, ignore_index=True)
    counts.rows = len(tracks)
    return tracks


def count_leaps(table: pd.DataFrame, source: TableFiles, counts: Counts) -> None:
    """Counts the steps of vehicles, rows in order, that are no jumps but depart from the motion around as none drives.

    A step counts if it ends farther than LEAP from where the median velocity of the steps around it leads, and farther
    than LEAP_ACCELERATION explains: a vehicle that is pushed aside by a lane's width, say, and goes on.
    """
    vehicle, t = table["vehicle_id"].to_numpy(), table["t"].to_numpy()
    step = np.diff(t)
    connected = (vehicle[1:] == vehicle[:-1]) & (step <= HOLE_MAX_S + STEP_S) & ~_jumps(table)[1:]
    way = np.where(connected, np.diff(table[["x", "y"]].to_numpy(), axis=0).T, np.nan)
    velocity = way / step
    change = np.hypot(*np.diff(velocity))
    near = np.fmax(np.r_[0.0, change], np.r_[change, 0.0]) * step > LEAP  # only these need a closer look
    leaps = np.flatnonzero(near & connected)
    around = leaps[:, None] + np.r_[-AROUND:0, 1 : AROUND + 1]
    same = (around >= 0) & (around < len(step)) & (vehicle[np.clip(around, 0, len(step))] == vehicle[leaps, None])
    others = np.where(same, velocity[:, np.clip(around, 0, len(step) - 1)], np.nan)
    enough = np.isfinite(others[0]).sum(axis=1) >= AROUND
    leaps, others = leaps[enough], others[:, enough]
    off = np.hypot(*(velocity[:, leaps] - np.nanmedian(others, axis=2))) * step[leaps]
    is_leap = off > LEAP + LEAP_ACCELERATION * step[leaps] ** 2
    if number := int(is_leap.sum()):
        worst = int(np.argmax(np.where(is_leap, off, 0.0)))
        rows = table["row"].to_numpy()[leaps[worst] : leaps[worst] + 2]
        most = f"at most by {off[worst]:.1f} m within {step[leaps[worst]]:.3g} s ({source.place(*rows)})"
        counts.leaps = f"{number} leaps, {most}"
        counts.tell(
            "leaps",
            f"{number} times a vehicle departs from its motion before and after as none drives, {most}: speeds and "
            "headings there may be wrong, too",
            leaps=number,
        )


def count_turns(table: pd.DataFrame, source: TableFiles, counts: Counts) -> None:
    """Counts the steps of vehicles, rows in order, at which `yaw` turns as none does: front and rear swapped, say."""
    if "yaw" not in table:
        return
    vehicle, t = table["vehicle_id"].to_numpy(), table["t"].to_numpy()
    step, turn = np.diff(t), np.abs(wrap_angle(np.diff(table["yaw"].to_numpy())))
    connected = (vehicle[1:] == vehicle[:-1]) & (step <= HOLE_MAX_S + STEP_S)
    turn = np.where(connected & (turn > TURN) & (turn > TURN_RATE * step), turn, 0.0)
    if number := int((turn > 0.0).sum()):
        worst = int(np.argmax(turn))
        rows = table["row"].to_numpy()[worst : worst + 2]
        most = f"by {np.rad2deg(turn[worst]):.0f} degrees within {step[worst]:.3g} s ({source.place(*rows)})"
        counts.tell(
            "turns",
            f"{number} times the heading of a vehicle turns as none does, at most {most}: without field columns.yaw "
            "headings follow from the motion",
            turns=number,
        )


def _jumps(table: pd.DataFrame) -> BoolArray:
    """Returns the mask (n,) of rows farther from the previous one of the vehicle than any moves in that time."""
    vehicle: IntArray = table["vehicle_id"].to_numpy()
    t, x, y = (table[name].to_numpy() for name in ("t", "x", "y"))
    far = np.hypot(np.diff(x), np.diff(y)) > JUMP_MAX * np.maximum(np.diff(t) / STEP_S, 1.0)
    return np.r_[False, (vehicle[1:] == vehicle[:-1]) & far]
