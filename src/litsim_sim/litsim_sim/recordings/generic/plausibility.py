"""Whether a table is what its mapping says: wrong units and conventions show in how vehicles move, and in their sizes.

Each check compares two things that have to agree, and says which other unit or convention of the mapping would make
them agree. Bounds are wide on purpose (our choice): a wrong unit is off by a factor of three at least, the nearest
rates of frames that are in use (10 and 12.5, 25 and 30) by one of 1.2.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.recordings.generic import sides
from litsim_sim.recordings.generic.mapping import FACTORS, Mapping
from litsim_sim.recordings.generic.sides import MOVING

STEP_RANGE_S = (0.005, 0.5)  # between rows of a vehicle: 200 to 2 rows a second
SPEED_MAX = 70.0  # [m/s] that nine in ten rows keep to
AGREEMENT = 1.15  # by which speeds may differ from those of the positions; those of NGSIM's files do by 1.01
HEADING_MAX = 0.35  # [rad] by which headings may differ from the direction of motion, half of the rows being better
LENGTH_RANGE, WIDTH_RANGE = (1.5, 25.0), (0.5, 3.2)  # [m] of half of the vehicles
ROWS_MIN = 20  # moving rows that a comparison needs
ANGLE_UNITS, ZEROS, POSITIVES = ("rad", "deg"), ("x", "y"), ("counterclockwise", "clockwise")


def check_plausible(table: pd.DataFrame, mapping: Mapping, where: str) -> None:
    """Refuse a table that does not move as traffic does.

    Args:
        table: in SI units and frame map, sorted by vehicle and time; columns vehicle_id, t, x, y, length, width,
            lane, and yaw and speed where the file has them.
        mapping: what the file is said to be; checks in its field `accept` are left out.
        where: names the file in errors.

    Raises:
        InputError: every check that failed, with the figure that gives it away.
    """
    found = {"time": _time(table, mapping), "size": _size(table, mapping)}
    if not found["time"]:  # else nothing that follows from times says anything
        found |= {"speed": _speed(table, mapping), "heading": _heading(table, mapping), "side": sides.problems(table)}
    problems = [f"{text} (check {name})" for name, text in found.items() if text and name not in mapping.accept]
    if problems:
        raise InputError(
            f"{where}: {'; '.join(problems)}; nothing was written: mend the mapping, or list a check in its field "
            f"accept if the file is right"
        )


def _time(table: pd.DataFrame, mapping: Mapping) -> str:
    """Rows of a vehicle follow each other by a plausible time."""
    step = _steps(table)["dt"].to_numpy()
    if not len(step):
        return ""
    median = float(np.median(step))
    low, high = STEP_RANGE_S
    if low <= median <= high:
        return ""
    said = f"rows of a vehicle follow each other by {median:.4g} s (median), expected {low:g} to {high:g} s"
    if mapping.columns.time is None:
        return f"{said}: is rate_hz, which is {mapping.rate_hz:g}, right?"
    fits = [unit for unit in ("s", "ms", "us", "ns") if _fit((median,), (STEP_RANGE_S,), mapping.units.time, unit)]
    would = f"; units.time {' or '.join(fits)} would fit" if fits else ""
    return f"{said}, units.time being {mapping.units.time}{would}"


def _speed(table: pd.DataFrame, mapping: Mapping) -> str:
    """Speeds are those at which the positions change."""
    steps = _steps(table)
    driven = steps["way"].to_numpy() / steps["dt"].to_numpy()
    if "speed" not in table:
        fast = float(np.quantile(driven, 0.9)) if len(driven) else 0.0
        return (
            f"positions change by {fast:.0f} m/s in one row of ten and more, expected at most {SPEED_MAX:g}: is "
            f"units.position, which is {mapping.units.position}, right, and {_clock(mapping)}?"
            if fast > SPEED_MAX
            else ""
        )
    said = steps["speed"].to_numpy()
    moving = (np.abs(said) > 0.05) & (driven > 0.05)
    if moving.sum() < ROWS_MIN:
        return ""
    ratio = float(np.median(driven[moving] / np.abs(said[moving])))
    if 1.0 / AGREEMENT <= ratio <= AGREEMENT:
        return ""
    fits = [
        f"{field} {unit}"
        for field, given, units in (
            ("units.position", mapping.units.position, ("m", "ft", "cm")),
            ("units.speed", mapping.units.speed, ("m/s", "km/h", "mph", "ft/s")),
        )
        for unit in units
        if unit != given and _agrees(ratio, FACTORS[unit] / FACTORS[given], field == "units.speed")
    ]
    if mapping.columns.time is None:
        fits.append(f"rate_hz {mapping.rate_hz / ratio:.3g}")
    would = f"; {' or '.join(fits)} would fit" if fits else ""
    return f"positions change {ratio:.3g} times as fast as column {mapping.columns.speed!r} says (median){would}"


def _heading(table: pd.DataFrame, mapping: Mapping) -> str:
    """Headings are where vehicles go."""
    if "yaw" not in table:
        return ""
    steps = _steps(table)
    steps = steps[steps["way"] > MOVING * steps["dt"]]
    if len(steps) < ROWS_MIN:
        return ""
    motion, yaw = np.arctan2(steps["dy"].to_numpy(), steps["dx"].to_numpy()), steps["yaw"].to_numpy()
    error = _apart(yaw, motion)
    if error <= HEADING_MAX:
        return ""
    mirror = -1.0 if mapping.transform.mirror_y else 1.0
    turn = np.deg2rad(mapping.transform.yaw_deg)
    there = mirror * (motion - turn)  # in the axes of the file; mirrored with the headings, it tells nothing of them
    angle = mirror * (yaw - turn) - (0.5 * np.pi if mapping.angles.zero == "y" else 0.0)
    angle = angle if mapping.angles.positive == "counterclockwise" else -angle
    fits = []
    for unit, zero, positive in product(ANGLE_UNITS, ZEROS, POSITIVES):
        read = heading(angle * FACTORS[unit] / FACTORS[mapping.units.angle], zero, positive)
        if _apart(read, there) <= 0.5 * HEADING_MAX:
            changes = {
                "units.angle": (mapping.units.angle, unit),
                "angles.zero": (mapping.angles.zero, zero),
                "angles.positive": (mapping.angles.positive, positive),
            }
            fits.append([f"{name} {new}" for name, (old, new) in changes.items() if new != old])
    fewest = min(map(len, fits), default=0)
    would = " or ".join(" with ".join(fit) for fit in fits if len(fit) == fewest)
    mirrored = fewest == 1 and would.startswith("angles.positive")
    also = ", and transform.mirror_y with it where y points down but headings do not turn with it" if mirrored else ""
    far = f"headings are {np.rad2deg(error):.0f} degrees off the direction of motion (median of moving rows), at most "
    largest = float(np.abs(angle).max() / FACTORS[mapping.units.angle])
    return (
        f"{far}{np.rad2deg(HEADING_MAX):.0f} expected; column {mapping.columns.yaw!r} goes up to {largest:.4g} "
        f"{mapping.units.angle}{f'; {would} would fit{also}' if fits else ''}"
    )


def _size(table: pd.DataFrame, mapping: Mapping) -> str:
    """Vehicles are as large as vehicles."""
    vehicles = table.groupby("vehicle_id")[["length", "width"]].median()
    length, width = (float(vehicles[name].median()) for name in ("length", "width"))
    said = f"half of the vehicles are longer than {length:.3g} m and wider than {width:.3g} m"
    if width > length:
        return f"{said}: are columns length and width swapped?"
    bounds = (LENGTH_RANGE, WIDTH_RANGE)
    fits = [unit for unit in ("m", "ft", "cm") if _fit((length, width), bounds, mapping.units.size, unit)]
    if mapping.units.size in fits:
        return ""
    would = f"; units.size {' or '.join(fits)} would fit" if fits else ""
    expected = " and ".join(f"{low:g} to {high:g}" for low, high in bounds)
    return f"{said}, expected {expected}{would}"


def heading(angle: FloatArray, zero: str, positive: str) -> FloatArray:
    """Headings (n,) in mathematical convention from angles [rad] by a convention of the mapping, in the file's axes."""
    return (angle if positive == "counterclockwise" else -angle) + (0.5 * np.pi if zero == "y" else 0.0)


def _steps(table: pd.DataFrame) -> pd.DataFrame:
    """From each row of a vehicle to its next: `dt` [s], `dx`, `dy`, `way` [m], `speed` (mean of both) and `yaw`."""
    vehicle = table["vehicle_id"].to_numpy()
    same = vehicle[1:] == vehicle[:-1]
    values = {name: np.diff(table[column].to_numpy())[same] for name, column in (("dt", "t"), ("dx", "x"), ("dy", "y"))}
    steps = pd.DataFrame(values).assign(way=np.hypot(values["dx"], values["dy"]))
    if "speed" in table:
        speed = table["speed"].to_numpy()
        steps["speed"] = (0.5 * (speed[1:] + speed[:-1]))[same]
    if "yaw" in table:
        steps["yaw"] = table["yaw"].to_numpy()[:-1][same]
    return steps[steps["dt"] > 0]


def _agrees(ratio: float, factor: float, of_speed: bool) -> bool:
    """Whether speeds would agree, were the positions or speeds larger by `factor`."""
    would = ratio / factor if of_speed else ratio * factor
    return 1.0 / AGREEMENT <= would <= AGREEMENT


def _apart(angles: FloatArray, others: FloatArray) -> float:
    """Median distance of two arrays of angles (n,) [rad]."""
    return float(np.median(np.abs(wrap_angle(angles - others))))


def _fit(values: tuple[float, ...], bounds: tuple[tuple[float, float], ...], given: str, unit: str) -> bool:
    """Whether all values, read in `unit` instead of `given`, are within their bounds."""
    factor = FACTORS[unit] / FACTORS[given]
    return all(low <= value * factor <= high for value, (low, high) in zip(values, bounds, strict=True))


def _clock(mapping: Mapping) -> str:
    if mapping.columns.time is None:
        return f"rate_hz, which is {mapping.rate_hz:g}"
    return f"units.time, which is {mapping.units.time}"
