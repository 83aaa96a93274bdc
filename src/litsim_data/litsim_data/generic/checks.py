"""Plausibility checks of a mapping: wrong units and conventions show in motion, sizes and sides of vehicles.

Each check compares two quantities that must agree, and suggests another unit or convention of the mapping under which
they do. The bounds are our choice and wide: a wrong unit is off by a factor of three at least, the closest frame rates
in use (10 and 12.5, 25 and 30) by one of 1.2. Mirrored tables agree with themselves; the sides on which vehicles pass
each other tell them: lanes are numbered from the left, and in right-hand traffic oncoming vehicles pass on the left.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from litsim_data.generic.mapping import FACTORS, Mapping
from litsim_data.generic.obstacles import USUAL_SIZES
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import FloatArray, Kind

STEP_RANGE_S = (0.005, 0.6)  # time between rows of a vehicle: 200 to 2 rows per second, and longer ones are holes
SPAN_S = 0.1  # least time between the positions that motion is judged by: nearer ones differ by noise above all
SPEED_MAX = 50.0  # [m/s] bound on the 90 % quantile of speeds: nine of ten vehicles drive slower on any road
CAMERA_RATES_HZ = (2.0, 4.0, 5.0, 10.0, 12.5, 15.0, 20.0, 25.0, 30.0, 29.97, 50.0, 60.0)
LIKE_CAMERA = 1.05  # ratio to one of these within which a rate is suggested
AGREEMENT = 1.15  # largest ratio between speeds and those of the positions; 1.01 in NGSIM's files
CLOSE, CLOSER = 1.05, 0.25  # ratio beyond which another unit, in which a quarter of its logarithm is left, is suggested
HEADING_MAX = 0.35  # [rad] bound on the median angle between heading and direction of motion
MISREAD = 0.005  # share of moving rows off by more above which a convention that halves it is suggested
TURNED_MAX = np.deg2rad(3.0)  # bound on the median offset of headings of vehicles that go straight; NGSIM: 0
STRAIGHT, WAY_MIN, VEHICLES_MIN = np.deg2rad(8.0), 20.0, 5  # going straight: range of headings, [m]; vehicles needed
SIDEWAYS, OFF_WAY = np.deg2rad(45.0), 15.0  # heading off the motion, for so many [m]: nobody reverses as far. Untuned
ACROSS_MAX = 0.05  # share of moving rows that may lead off the x axis for reference box_corner
REVERSE_MAX = 5.0  # [m/s] largest plausible speed in reverse
STANDING = 0.5  # [m/s] if 99 % of rows are slower, all vehicles are parked
CHANGE_S = 1.0  # [s] interval over which speeds are compared
CHANGE_MIN = 0.5  # [m/s2] smallest change of speed that counts
CHANGES = (0.32, 1.6)  # ratio of accelerations to those of the positions; NGSIM's files: 0.39 to 1
SAME_SIGN = 0.8  # smallest share of changes with the same sign; 0.95 in NGSIM's files
LENGTH_RANGE, WIDTH_RANGE = (2.5, 25.0), (1.2, 3.2)  # [m] bounds on the medians; motorcycles are smaller
ROWS_MIN = 20  # moving rows that a comparison needs
SPEED_UNITS = ("m/s", "km/h", "mph", "ft/s")
ANGLE_UNITS, ZEROS, POSITIVES = ("rad", "deg"), ("x", "y"), ("counterclockwise", "clockwise")

# Sides
INSTANTS = 400  # about as many instants are compared
INSTANT_S = 0.1  # [s] resolution of instants
MOVING = 2.0  # [m/s] smallest speed at which the direction of motion is reliable
NEXT_MIN = 0.05  # [m] smallest distance between two rows, likewise
ABREAST = 10.0  # [m] largest longitudinal distance of vehicles that pass each other
BESIDE = (2.0, 9.0)  # [m] range of lateral distances
APART = 25.0  # [m] largest lateral distance of oncoming vehicles, which counts only where too few are within BESIDE
ALONG = 30.0  # [m] largest longitudinal distance of vehicles in adjacent lanes
SAME_WAY, ONCOMING = np.deg2rad(15.0), np.deg2rad(165.0)
PAIRS_MIN = 6  # fewest pairs of vehicles that are conclusive
DOWN = "y points down, which transform.mirror_y corrects"
NEAR = float(max(np.hypot(ALONG, BESIDE[1]), np.hypot(ABREAST, APART)))  # [m] no pair is farther apart
SHARE = 0.8  # smallest share of pairs that is conclusive


def check_plausible(table: pd.DataFrame, mapping: Mapping, where: str) -> list[str]:
    """Refuses a table with implausible motion or sizes; returns what is implausible and accepted.

    Args:
        table: rows in SI units and frame map, sorted by vehicle and time; columns vehicle_id, t, x, y, length, width,
            kind, lane, and yaw, speed and acceleration where the file has them.
        mapping: the mapping; checks in its field `accept` refuse nothing.
        where: name of the file in errors.

    Raises:
        InputError: checks failed; the message has the figure of each.
    """
    consecutive = steps(table, 1)
    step = consecutive["dt"].to_numpy()[consecutive["dt"] > 0]
    texts = {"time": _time(step, mapping), "size": _size(table, mapping)}
    if not texts["time"] or "time" in mapping.accept:  # the others depend on times
        moves = steps(table, rows_apart(float(np.median(step))) if len(step) else 1)
        moves = moves[moves["dt"] > 0]
        texts |= {
            "speed": _speed(table, moves, mapping) or _fast(table, mapping),
            "acceleration": _acceleration(table, mapping),
            "heading": _across(_moving(moves), mapping) or _heading(table, _moving(moves), mapping),
            "side": _mirrored(table),
        }
    findings = {name: f"{text} (check {name})" for name, text in texts.items() if text}
    problems = [text for name, text in findings.items() if name not in mapping.accept]
    if problems:
        raise InputError(
            f"{where}: {'; '.join(problems)}; nothing was written: correct the mapping, or accept a check (--accept or "
            f"field accept of the mapping) if the file is right"
        )
    return [text for name, text in findings.items() if name in mapping.accept]


def _time(step: FloatArray, mapping: Mapping) -> str:
    """Checks that the time `step` (n,) [s] between rows of a vehicle is plausible."""
    if not len(step):
        return ""
    median = float(np.median(step))
    low, high = STEP_RANGE_S
    if low <= median <= high:
        return ""
    finding = f"rows of a vehicle follow each other by {median:.4g} s (median), expected {low:g} to {high:g} s"
    if mapping.columns.time is None:
        return f"{finding}: is rate_hz, which is {mapping.rate_hz:g}, right?"
    fits = [unit for unit in ("s", "ms", "us", "ns") if _fit((median,), (STEP_RANGE_S,), mapping.units.time, unit)]
    would = f"; units.time {' or '.join(fits)} would fit" if fits else ""
    return f"{finding}, units.time being {mapping.units.time}{would}"


def _fast(table: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that the file's speeds are those of road vehicles."""
    fast = float(np.quantile(np.abs(table["speed"].to_numpy()), 0.9)) if "speed" in table and len(table) else 0.0
    if fast <= SPEED_MAX:
        return ""
    return (
        f"column {mapping.columns.speed!r} says {fast:.0f} m/s ({3.6 * fast:.0f} km/h) in one row of ten and more, "
        f"expected at most {SPEED_MAX:g} m/s: is units.speed, which is {mapping.units.speed}, right?"
    )


def _speed(table: pd.DataFrame, moves: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that speeds agree with the change of positions."""
    driven = moves["way"].to_numpy() / moves["dt"].to_numpy()
    if "speed" not in table:
        fast = float(np.quantile(driven, 0.9)) if len(driven) else 0.0
        slow = float(np.quantile(driven, 0.99)) if len(driven) >= ROWS_MIN else STANDING
        if slow >= STANDING and fast <= SPEED_MAX:
            return ""
        far = f"{fast:.0f} m/s in one row of ten and more, expected at most {SPEED_MAX:g}"
        if slow < STANDING:
            far = f"less than {STANDING:g} m/s in 99 of 100 rows, so that no vehicle moves"
        by_time = f"units.time, which is {mapping.units.time}"
        clock = by_time if mapping.columns.time is not None else f"rate_hz, which is {mapping.rate_hz:g}"
        right = f"is units.position, which is {mapping.units.position}, right, and {clock}?"
        return f"positions change by {far}: {right}{_degrees(table, mapping)}"
    if (back := table["speed"].to_numpy() < -REVERSE_MAX).any():
        return (
            f"column {mapping.columns.speed!r} is below -{REVERSE_MAX:g} m/s in {back.mean():.0%} of the rows, down to "
            f"{table['speed'].min():.3g} m/s, expected speeds along the heading: is it that along an axis?"
        )
    speed = moves["mean_speed"].to_numpy()
    moving = (np.abs(speed) > 0.05) & ((driven > 0.05) | (np.abs(speed) > MOVING))
    if moving.sum() < ROWS_MIN:
        return ""
    ratio = float(np.median(driven[moving] / np.abs(speed[moving])))
    if 1.0 / AGREEMENT <= ratio <= AGREEMENT:
        return _closer_unit(speed[moving], driven[moving], mapping)
    fits = [
        f"{field} {unit}"
        for field, ours, units, power in (
            ("units.position", mapping.units.position, ("m", "ft", "cm"), 1),
            ("units.speed", mapping.units.speed, SPEED_UNITS, -1),
        )
        for unit in units
        if unit != ours and 1.0 / AGREEMENT <= ratio * (FACTORS[unit] / FACTORS[ours]) ** power <= AGREEMENT
    ]
    rate = mapping.rate_hz / ratio
    if mapping.columns.time is None and any(1 / LIKE_CAMERA < rate / usual < LIKE_CAMERA for usual in CAMERA_RATES_HZ):
        fits.append(f"rate_hz {rate:.3g}")
    no_unit = _degrees(table, mapping) or (
        f"; are columns {mapping.columns.x!r} and {mapping.columns.y!r} in another unit than field units.position has, "
        "such as pixels?"
    )
    would = f"; {' or '.join(fits)} would fit" if fits else no_unit
    return f"positions change {ratio:.3g} times as fast as column {mapping.columns.speed!r} says (median){would}"


def _closer_unit(speed: FloatArray, driven: FloatArray, mapping: Mapping) -> str:
    """Checks that speeds (n,) do not agree better in a unit close to that of the mapping: km/h is 0.91 ft/s."""
    ratio = pace(speed, driven)
    off = abs(np.log(ratio))
    for unit in SPEED_UNITS:
        would = abs(np.log(ratio * FACTORS[mapping.units.speed] / FACTORS[unit]))
        if off > np.log(CLOSE) and would < CLOSER * off:
            return (
                f"positions change {ratio:.3g} times as fast as column {mapping.columns.speed!r} says (median of the "
                f"fastest quarter); units.speed {unit} would fit better than {mapping.units.speed}"
            )
    return ""


def pace(speed: FloatArray, driven: FloatArray) -> float:
    """Returns how many times as fast as speeds (n,) say positions change: the median of the fastest quarter.

    Noise of positions a few hundredths of a second apart makes slow vehicles seem faster, but hardly fast ones.
    """
    fast = np.abs(speed) >= np.quantile(np.abs(speed), 0.75)
    return float(np.median(driven[fast] / np.maximum(np.abs(speed[fast]), 1e-9)))


def _acceleration(table: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that accelerations agree with the change of positions."""
    if "acceleration" not in table:
        return ""
    published, driven = _changes(table)
    clear = np.abs(driven) > CHANGE_MIN
    if clear.sum() < ROWS_MIN:
        return ""
    published, driven = published[clear], driven[clear]
    ratio, same = float(np.median(published / driven)), float((published * driven > 0.0).mean())
    where = f"column {mapping.columns.acceleration!r} says"
    if same < SAME_SIGN and ratio != 0.0:
        return (
            f"{where} the opposite of how speeds change in {1.0 - same:.0%} of {len(published)} clear changes: is it "
            f"an acceleration along an axis, or is braking positive? Without field columns.acceleration it is derived "
            f"from the speeds"
        )
    if CHANGES[0] <= ratio <= CHANGES[1]:
        return ""
    fits = [
        f"units.acceleration {unit}"
        for unit in ("m/s2", "ft/s2", "g")
        if CHANGES[0] <= ratio * FACTORS[unit] / FACTORS[mapping.units.acceleration] <= CHANGES[1]
    ]
    would = (
        f"; {' or '.join(fits)} would fit"
        if fits
        else "; without field columns.acceleration it is derived from the speeds"
    )
    return f"{where} {ratio:.3g} times the acceleration with which positions change (median){would}"


def _changes(table: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    """Returns accelerations (k,) [m/s2] by the file's column and by its positions, each over two consecutive seconds.

    Both are second differences of the distance travelled, the former of accelerations integrated twice; noise of
    positions has little weight in them.
    """
    vehicle, t, x, y, acceleration = (table[name].to_numpy() for name in ("vehicle_id", "t", "x", "y", "acceleration"))
    begins = np.flatnonzero((vehicle[1:] != vehicle[:-1]) | (np.diff(t) > STEP_RANGE_S[1])) + 1
    published, driven = [np.zeros(0)], [np.zeros(0)]
    for first, last in zip(np.r_[0, begins], np.r_[begins, len(t)], strict=True):
        rows = slice(first, last)
        times = np.arange(t[first], t[last - 1] + 1e-9, CHANGE_S)
        step = np.diff(t[rows])
        speed = np.r_[0.0, np.cumsum(0.5 * (acceleration[rows][1:] + acceleration[rows][:-1]) * step)]
        way = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)]
        published.append(np.diff(np.interp(times, t[rows], way), 2) / CHANGE_S**2)
        gone = np.hypot(*(np.diff(np.interp(times, t[rows], values[rows])) for values in (x, y)))
        driven.append(np.diff(gone) / CHANGE_S**2)
    return np.concatenate(published), np.concatenate(driven)


def _degrees(table: pd.DataFrame, mapping: Mapping) -> str:
    """Returns a hint for positions that may be longitudes and latitudes, which hardly differ; else empty."""
    if mapping.units.position != "m" or max(np.ptp(table[name].to_numpy()) for name in ("x", "y")) > 1.0:
        return ""
    return "; or are they degrees? Field origin of the mapping makes metres of longitudes and latitudes"


def _across(moves: pd.DataFrame, mapping: Mapping) -> str:
    """Checks, for reference box_corner, that vehicles drive along the x axis of the file."""
    if mapping.reference != "box_corner" or len(moves) < ROWS_MIN:
        return ""
    motion = moves["course"].to_numpy() - np.deg2rad(mapping.transform.yaw_deg)
    across = float((np.abs(np.sin(motion)) > np.sin(HEADING_MAX)).mean())
    if across <= ACROSS_MAX:
        return ""
    return (
        f"vehicles drive more than {np.rad2deg(HEADING_MAX):.0f} degrees off the file's x axis in {across:.0%} of the "
        f"moving rows, and reference box_corner is for boxes along that axis"
    )


def _heading(table: pd.DataFrame, moves: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that headings agree with the direction of motion."""
    if "yaw" not in table or len(moves) < ROWS_MIN:
        return ""
    motion, yaw = moves["course"].to_numpy(), moves["yaw"].to_numpy()
    error, off = _apart(yaw, motion), _off(yaw, motion)
    angle, there = _in_file(yaw, motion, mapping)
    fits = []
    for unit, zero, positive in product(ANGLE_UNITS, ZEROS, POSITIVES):
        read = heading(angle * FACTORS[unit] / FACTORS[mapping.units.angle], zero, positive)
        if _apart(read, there) <= 0.5 * HEADING_MAX and _off(read, there) <= 0.5 * off:
            changes = {
                "units.angle": (mapping.units.angle, unit),
                "angles.zero": (mapping.angles.zero, zero),
                "angles.positive": (mapping.angles.positive, positive),
            }
            fits.append([f"{name} {new}" for name, (old, new) in changes.items() if new != old])
    few = off <= max(MISREAD, ROWS_MIN / len(moves))
    if error <= HEADING_MAX and (few or not fits):
        return _turned_headings(table, mapping)
    fewest = min(map(len, fits), default=0)
    would = " or ".join(" with ".join(fit) for fit in fits if len(fit) == fewest)
    mirrored = fewest == 1 and would.startswith("angles.positive")
    also = ", and transform.mirror_y with it where y points down but headings do not turn with it" if mirrored else ""
    most = f"{np.rad2deg(HEADING_MAX):.0f}"
    if error > HEADING_MAX:
        off_by = f"{np.rad2deg(error):.0f} degrees off the direction of motion"
        far = f"{off_by} (median of moving rows), at most {most} expected"
    else:
        far = (
            f"more than {most} degrees off the direction of motion in {off:.1%} of the moving rows, and in at most "
            f"half as many under another convention"
        )
    largest = float(np.abs(angle).max() / FACTORS[mapping.units.angle])
    return (
        f"headings are {far}; column {mapping.columns.yaw!r} goes up to {largest:.4g} {mapping.units.angle}"
        f"{f'; {would} would fit{also}' if fits else ''}"
    )


def _turned_headings(table: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that headings of vehicles that go straight are not all turned to one side of their way."""
    off = []
    for _, rows in table.groupby("vehicle_id", sort=False):
        yaw = np.unwrap(rows["yaw"].to_numpy())
        way = rows[["x", "y"]].to_numpy()[[0, -1]]
        gone = np.hypot(*(way[1] - way[0]))
        if gone > WAY_MIN and np.ptp(yaw) < STRAIGHT:
            off.append(float(wrap_angle(yaw.mean() - np.arctan2(*(way[1] - way[0])[::-1]))))
    turned = float(np.median(off)) if len(off) >= VEHICLES_MIN else 0.0
    if abs(turned) <= TURNED_MAX:
        return ""
    return (
        f"headings of {len(off)} vehicles that go straight are {abs(np.rad2deg(turned)):.1f} degrees to the "
        f"{'left' if turned > 0 else 'right'} of their way (median): is column {mapping.columns.yaw!r} relative to "
        f"another north than the positions? Without field columns.yaw headings follow from the motion"
    )


def _in_file(yaw: FloatArray, motion: FloatArray, mapping: Mapping) -> tuple[FloatArray, FloatArray]:
    """Returns headings `yaw` (n,) as angles of the file, and `motion` (n,) in its axes, mirrored like the headings."""
    mirror, turn = -1.0 if mapping.transform.mirror_y else 1.0, np.deg2rad(mapping.transform.yaw_deg)
    angle = mirror * (yaw - turn) - (0.5 * np.pi if mapping.angles.zero == "y" else 0.0)
    return angle if mapping.angles.positive == "counterclockwise" else -angle, mirror * (motion - turn)


def off_their_motion(table: pd.DataFrame, mapping: Mapping) -> list[int]:
    """Returns ids of vehicles whose heading is more than SIDEWAYS off their motion for OFF_WAY or more.

    Trackers confuse front and rear of single vehicles. Where more than half of those that move are off, or half as many
    under another convention of angles, there are none: that is for :func:`check_plausible` to tell.

    Args:
        table, mapping: as of :func:`check_plausible`.
    """
    if "yaw" not in table:
        return []
    step = steps(table, 1)["dt"]
    apart = max(1, round(CHANGE_S / max(float(step[step > 0].median()), STEP_RANGE_S[0]))) if (step > 0).any() else 1
    moves = _moving(steps(table, apart))
    motion, yaw = moves["course"].to_numpy(), moves["yaw"].to_numpy()
    off = moves[np.abs(wrap_angle(motion - yaw)) > SIDEWAYS]
    if off.empty:
        return []
    angle, there = _in_file(yaw, motion, mapping)
    if min(_off(heading(angle, *way), there) for way in product(ZEROS, POSITIVES)) <= 0.5 * _off(yaw, motion):
        return []
    gone = off.groupby("vehicle_id")["way"].sum() / apart  # these steps overlap
    ids = [int(vehicle) for vehicle in gone.index[gone >= OFF_WAY]]
    return ids if 2 * len(ids) <= moves["vehicle_id"].nunique() else []


def _size(table: pd.DataFrame, mapping: Mapping) -> str:
    """Checks that median length and width are those of vehicles; those known to be motorcycles do not count."""
    wide = table[table["kind"] != Kind.MOTORCYCLE]
    if wide.empty:
        return ""
    vehicles = wide.groupby("vehicle_id")[["length", "width"]].median()
    vehicles = vehicles.fillna(dict(zip(vehicles, USUAL_SIZES[Kind.CAR], strict=True)))
    length, width = (float(vehicles[name].median()) for name in ("length", "width"))
    finding = f"half of the vehicles are longer than {length:.3g} m and wider than {width:.3g} m"
    if width > length:
        return f"{finding}: are columns length and width swapped?"
    bounds = (LENGTH_RANGE, WIDTH_RANGE)
    fits = [unit for unit in ("m", "ft", "cm") if _fit((length, width), bounds, mapping.units.size, unit)]
    if mapping.units.size in fits:
        return ""
    would = f"; units.size {' or '.join(fits)} would fit" if fits else ""
    if not fits and all(2.0 * size > low for size, (low, _) in zip((length, width), bounds, strict=True)):
        would = "; are they half of the sizes, from the middle?"
    elif not fits and width < WIDTH_RANGE[0]:
        would = "; are most of them motorcycles or people, whom field columns.kind would tell apart?"
    expected = " and ".join(f"{low:g} to {high:g}" for low, high in bounds)
    return f"{finding}, expected {expected}{would}"


def heading(angle: FloatArray, zero: str, positive: str) -> FloatArray:
    """Returns headings (n,) [rad], counter-clockwise from x, of angles (n,) [rad] in a convention; axes of the file."""
    return (angle if positive == "counterclockwise" else -angle) + (0.5 * np.pi if zero == "y" else 0.0)


def rows_apart(step: float) -> int:
    """Returns how many rows that follow each other by `step` [s], more than 0, are SPAN_S apart; from 1 to 20."""
    return round(SPAN_S / max(min(step, SPAN_S), STEP_RANGE_S[0]))


def steps(table: pd.DataFrame, apart: int, clock: str = "t") -> pd.DataFrame:
    """Returns the steps from each row of a vehicle to its row `apart` rows later, in one sorted by vehicle and time.

    Returns:
        The rows at which steps begin, with the changes `dt` of the column `clock`, and `dx` and `dy` of the position;
        `way` and `course`, the distance and direction [rad]; and `mean_speed`, of both rows, if the table has speeds.
    """
    vehicle = table["vehicle_id"].to_numpy()
    same = vehicle[apart:] == vehicle[:-apart]
    begin, end = table.iloc[:-apart][same], table.iloc[apart:][same]
    dt, dx, dy = (end[name].to_numpy(np.float64) - begin[name].to_numpy(np.float64) for name in (clock, "x", "y"))
    moves = begin.assign(dt=dt, dx=dx, dy=dy, way=np.hypot(dx, dy), course=np.arctan2(dy, dx))
    if "speed" in table:
        moves["mean_speed"] = 0.5 * (end["speed"].to_numpy() + begin["speed"].to_numpy())
    return moves


def _moving(moves: pd.DataFrame) -> pd.DataFrame:
    """Returns the :func:`steps` whose direction is reliable."""
    return moves[moves["way"] > MOVING * moves["dt"]]


def _apart(angles: FloatArray, others: FloatArray) -> float:
    """Returns the median distance of two arrays of angles (n,) [rad]."""
    return float(np.median(np.abs(wrap_angle(angles - others))))


def _off(angles: FloatArray, others: FloatArray) -> float:
    """Returns the share of pairs of angles (n,) [rad] that differ by more than HEADING_MAX."""
    return float((np.abs(wrap_angle(angles - others)) > HEADING_MAX).mean())


def _fit(values: tuple[float, ...], bounds: tuple[tuple[float, float], ...], ours: str, unit: str) -> bool:
    """Returns whether all values, read in `unit` instead of `ours`, are within their bounds."""
    factor = FACTORS[unit] / FACTORS[ours]
    return all(low <= value * factor <= high for value, (low, high) in zip(values, bounds, strict=True))


def sides(table: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    """Measures on which side of each other vehicles drive, in a table sorted by vehicle and time.

    Args:
        table: vehicle_id, t [s], x, y [m], lane.

    Returns:
        Median distance to the left (p,) [m] at which the other vehicle of an oncoming pair passes; and that (q,) [m] of
        the vehicle in the lane of the next higher number, for pairs that go the same way.
    """
    moving = steps(table, 1)
    moving = moving[(moving["dt"] > 0) & (moving["way"] > np.maximum(MOVING * moving["dt"], NEXT_MIN))]
    instant = np.round(moving["t"].to_numpy() / INSTANT_S).astype(np.int64)
    every = max(1, len(np.unique(instant)) // INSTANTS)
    moving = moving.assign(instant=instant)[instant % every == 0].drop_duplicates(["vehicle_id", "instant"])
    ids, x, y, instant, course, lane = (
        moving[name].to_numpy() for name in ("vehicle_id", "x", "y", "instant", "course", "lane")
    )
    apart = 2.0 * NEAR * instant  # a third coordinate, by which those of another instant are not near
    vehicle, other = KDTree(np.column_stack([x, y, apart])).query_pairs(NEAR, output_type="ndarray").T
    swap = lane[vehicle] > lane[other]
    vehicle, other = np.where(swap, other, vehicle), np.where(swap, vehicle, other)
    ahead, left = to_body(x[other] - x[vehicle], y[other] - y[vehicle], course[vehicle])
    turn, ahead, beside = np.abs(wrap_angle(course[other] - course[vehicle])), np.abs(ahead), np.abs(left)
    oncoming = (turn > ONCOMING) & (ahead < ABREAST) & (beside > BESIDE[0]) & (beside < APART)
    adjacent = (turn < SAME_WAY) & (ahead < ALONG) & (beside > BESIDE[0]) & (beside < BESIDE[1])
    adjacent &= (lane[vehicle] >= 1) & (lane[other] == lane[vehicle] + 1)
    pairs = pd.DataFrame({"one": ids[vehicle], "other": ids[other], "left": left})
    return _medians(pairs[oncoming]), _medians(pairs[adjacent])


def _mirrored(table: pd.DataFrame) -> str:
    """Checks that a table is not mirrored."""
    findings, (oncoming, next_lane) = [], sides(table)
    near = oncoming[np.abs(oncoming) < BESIDE[1]]
    oncoming = near if len(near) >= PAIRS_MIN else oncoming
    right = oncoming < 0.0
    if len(right) >= PAIRS_MIN and right.mean() >= SHARE:
        findings.append(
            f"oncoming vehicles pass on the right, {-np.median(oncoming):.1f} m beside, in {right.mean():.0%} of "
            f"{len(right)} encounters: {DOWN}, or traffic keeps to the left there"
        )
    left = next_lane > 0.0
    if len(left) >= PAIRS_MIN and left.mean() > 1.0 - SHARE:
        mirrored = f"{DOWN}, or " if left.mean() >= SHARE else ""
        findings.append(
            f"the lane of the next higher number is {np.median(next_lane[left]):.1f} m to the left for "
            f"{left.mean():.0%} of {len(left)} pairs of vehicles, expected to the right: {mirrored}lanes are not "
            f"counted from the left in either direction, and field columns.lane has to go"
        )
    return "; ".join(findings)


def _medians(pairs: pd.DataFrame) -> FloatArray:
    """Returns the median distance to the left (k,) [m] of each pair of vehicles."""
    return np.asarray(pairs.groupby(["one", "other"])["left"].median().to_numpy(), np.float64)
