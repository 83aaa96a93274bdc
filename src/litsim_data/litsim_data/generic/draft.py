"""Drafting of a mapping: the meaning of columns is guessed from their names, units from their values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from litsim_data.generic.checks import (
    AGREEMENT,
    ANGLE_UNITS,
    CAMERA_RATES_HZ,
    MOVING,
    POSITIVES,
    SPEED_UNITS,
    STEP_RANGE_S,
    WIDTH_RANGE,
    ZEROS,
    heading,
    pace,
    rows_apart,
    steps,
)
from litsim_data.generic.column_names import (
    COMPONENTS,
    FEET,
    GEOGRAPHIC,
    HEIGHT,
    METRES,
    SUMO_X,
    named_columns,
    plain_name,
)
from litsim_data.generic.geography import projected
from litsim_data.generic.kinds import NUMBERED, likely_kind
from litsim_data.generic.mapping import FACTORS, Mapping
from litsim_data.generic.published import drafted
from litsim_data.generic.reading import NEEDED, texts
from litsim_data.generic.si_units import DEGREES_MAX
from litsim_data.generic.wide import open_tables, repeated_columns
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.table_input import TableFiles, is_stamped, seconds_of

NARROW = 0.45  # [m] width of people, who may be most of those in a file
FRAMES_APART = 3  # rows between the positions that motion is judged by, where frames have a rate that nobody knows
HINTS = (
    "# vehicles: {file: tracksMeta.csv, vehicle_id: id}  # a file with a row for each vehicle: classes, sizes",
    "# transform: {yaw_deg: 0, x: 0, y: 0}  # onto the net, in degrees and metres; data map --check says what fits",
    "# signals: signals.yaml  # what signals of the net showed (docs/signals.md)",
)
POSITIONS = ("m", "cm", "ft")
"""Units of positions, the more usual ones first."""
VALID = r"(is_?)?valid"
"""Pattern of names of a column, in lower case, that says in which rows a vehicle is there."""
LATITUDE_MAX = 80.0  # [deg] of UTM
TRUE = ("true", "1")
"""Values, as text, of a column that says so."""
NUMBERS = {"time", "frame", "x", "y", "length", "width", "yaw", "speed", "speed_x", "speed_y"}
OPTIONAL = ("yaw", "speed", "acceleration", "lane")
"""Columns of numbers that a file need not have; in one that it has, every cell is one."""


class _Draft:
    """The fields of a mapping, and remarks on them for the user."""

    def __init__(self, **fields: Any) -> None:
        self.fields, self.remarks = fields, dict[str, str]()


def draft(paths: Path | Sequence[Path]) -> str:
    """Returns the text of a mapping file for the table at `paths`; guesses are marked by comments.

    Raises:
        InputError: the file cannot be read, or has no columns for id, position and time.
    """
    if text := drafted(paths):
        return text
    repeated = repeated_columns(paths if isinstance(paths, Path) else paths[0])
    source = open_tables(paths, repeated)
    columns = named_columns(source)
    used = set(columns.values())
    raw, valid = _present(source, columns)
    table = pd.DataFrame({ours: raw[theirs] for ours, theirs in columns.items()})
    if "time" in table and is_stamped(table["time"]):
        table["time"] = seconds_of(table["time"])
    for name in sorted(NUMBERS & {*columns}):
        table[name] = _numbers(table[name], raw["row"], columns[name], source)
    empty = _incomplete(table)
    held = [columns.pop(name) for name in empty]
    table = table.drop(columns=empty)
    components = [columns.pop(name) for name in COMPONENTS if name in columns]
    if len(components) == 2 and "speed" not in columns:
        table["speed"] = np.hypot(table["speed_x"], table["speed_y"])
    stem = Path(source.name.partition(", ")[0]).stem
    mapping = _Draft(name=re.sub(r"\W+", "_", stem), source="", licence="", net="")
    mapping.remarks["source"] = "data set, site and period, as in a citation"
    mapping.remarks["net"] = "name of the SUMO net in whose frame the positions are"
    mapping.fields["columns"] = columns | ({"speed": components} if "speed" in table and components else {})
    remarks = [f"{name} has cells without a number, and is not used" for name in held]
    sizes = [name for name in ("length", "width") if name not in columns]
    remarks += [f"the file has no {' and '.join(sizes)}: usual ones by kind, unless you give them"] if sizes else []
    mapping.remarks["columns"] = "; ".join(remarks)
    if repeated:
        mapping.fields["repeated"] = repeated
    if re.fullmatch(GEOGRAPHIC["x"], plain_name(columns["x"])):
        table = _on_plane(mapping, table)
    mapping.fields["reference"], mapping.remarks["reference"] = _reference(columns)
    table = _of_first_clip(mapping, table)
    clock = "time" if "time" in columns else "frame"
    complete = table.dropna(subset=[name for name in (clock, "x", "y", "yaw", "speed") if name in table])
    complete = complete.sort_values(["vehicle_id", clock])
    apart = _clock(mapping, steps(complete, 1, clock)["dt"])
    _sizes(mapping, table)
    _motion(mapping, steps(complete, apart, clock))
    if "kind" in columns:
        _kinds(mapping, table["kind"])
    if valid:
        mapping.fields["rows"] = {name: [*TRUE] for name in valid}
    unused = [name for name in source.columns if name not in {*used, *valid} or name in held]
    text = _written(mapping, f"Drafted from the columns of {source.name}; not used: {', '.join(unused) or 'none'}.")
    Mapping.model_validate(yaml.safe_load(text))  # else this is wrong, not the user
    return text


def _of_first_clip(mapping: _Draft, table: pd.DataFrame) -> pd.DataFrame:
    """Returns the rows of the first of several clips, which the mapping chooses."""
    if "clip" not in table:
        return table
    clips = texts(table["clip"])
    if table["clip"].nunique() < 2:
        del mapping.fields["columns"]["clip"]
        return table
    first = clips[clips != ""].iloc[0]
    mapping.fields["clip"] = int(first) if re.fullmatch(r"0|[1-9]\d*", first) else first
    mapping.remarks["clip"] = f"the first of {table['clip'].nunique()}"
    return table[clips == first]


def _on_plane(mapping: _Draft, table: pd.DataFrame) -> pd.DataFrame:
    """Returns a table of longitudes and latitudes with x and y in metres, from an origin amid the vehicles."""
    middle = [float(table[name].median()) for name in ("y", "x")]
    spread = max(float(np.ptp(table[name].dropna())) for name in ("y", "x"))
    if not (abs(middle[0]) <= LATITUDE_MAX and spread <= DEGREES_MAX):
        names = [mapping.fields["columns"][name] for name in ("x", "y")]
        raise InputError(
            f"columns {' and '.join(names)} are no longitudes and latitudes of one place: they are around "
            f"{middle[1]:g} and {middle[0]:g}, within {spread:g} degrees"
        )
    origin = (round(middle[0], 3), round(middle[1], 3))
    mapping.fields["origin"] = list(origin)
    mapping.remarks["origin"] = "a guess, amid the vehicles: latitude and longitude of (0, 0), those of the net"
    x, y = projected(table["y"].to_numpy(), table["x"].to_numpy(), origin)
    return table.assign(x=x, y=y)


def _reference(columns: dict[str, str]) -> tuple[str, str]:
    """Returns the reference point by the names of columns, and a remark on it."""
    if columns.get("width") == HEIGHT:
        return "box_corner", "a guess: columns width and height are of boxes in a picture, x and y their corner"
    if columns["x"] == SUMO_X:
        return "front_centre", "a guess: column names are those of SUMO, whose positions are of front centres"
    return "box_centre", "a guess: box_centre, front_centre or rear_axle"


def _present(source: TableFiles, columns: dict[str, str]) -> tuple[pd.DataFrame, list[str]]:
    """Returns the rows of the file's `columns` in which a vehicle is there, and the columns that say so.

    Raises:
        InputError: the file cannot be read, or none is there.
    """
    valid = [name for name in source.columns if re.fullmatch(VALID, name.strip().lower())][:1]
    needed = {columns[name] for name in NEEDED if name in columns}
    raw = source.read(sorted({*columns.values(), *valid}), needed=needed)
    for name in valid:
        raw = raw[texts(raw[name]).isin(TRUE)].reset_index(drop=True)
        if raw.empty:
            raise InputError(f"{source}: column {name!r} is true in no row; write the mapping by hand (docs/data.md)")
    return raw, valid


def _numbers(column: pd.Series, row: pd.Series, name: str, source: TableFiles) -> pd.Series:
    """Returns the numbers of a column, NaN where cells are empty.

    Raises:
        InputError: a cell holds something else; `name` is the column, `row` (n,) the places of the cells.
    """
    values = pd.to_numeric(column, errors="coerce").astype(np.float64)
    if (bad := (values.isna() & column.notna()).to_numpy()).any():
        first_bad = int(np.argmax(bad))
        raise InputError(
            f"{source.place(row.iloc[first_bad])}: column {name!r} is {str(column.iloc[first_bad])!r}, expected a "
            f"number; {int(bad.sum())} such rows"
        )
    return values


def _incomplete(table: pd.DataFrame) -> list[str]:
    """Returns our names of the columns that a file need not have, and that lack numbers where they are needed."""
    vehicles = table  # of people no heading or speed is read
    if "kind" in table:
        vehicles = table[texts(table["kind"]).map(likely_kind) != "drop"]
    names = [name for name in (*OPTIONAL, *COMPONENTS) if name in table and name != "lane"]
    names = [name for name in names if vehicles[name].isna().any()]
    lanes = pd.to_numeric(table["lane"], errors="coerce") if "lane" in table else pd.Series()  # many are names
    return [*names, *(["lane"] if lanes.isna().any() else [])]


def _clock(mapping: _Draft, step: pd.Series) -> int:
    """Guesses the unit of times by the `step` (n,) from row to row; puts a placeholder for the rate of frame numbers.

    Returns how many rows apart positions are for the guesses on motion.
    """
    if "time" not in mapping.fields["columns"]:
        mapping.fields["rate_hz"] = 10.0
        mapping.remarks["rate_hz"] = "a guess: frames per second of the camera"
        return FRAMES_APART
    (low, high), median = STEP_RANGE_S, float(step.median()) if len(step) else 0.0
    unit = next((unit for unit in ("s", "ms", "us", "ns") if low <= median * FACTORS[unit] <= high), "s")
    mapping.fields.setdefault("units", {})["time"] = unit
    mapping.remarks["units.time"] = f"rows of a vehicle follow each other by {median:g}"
    return rows_apart(median * FACTORS[unit]) if median > 0.0 else FRAMES_APART


def _sizes(mapping: _Draft, table: pd.DataFrame) -> None:
    """Guesses the unit of sizes by the median width of the vehicles."""
    if "width" not in table:
        return
    width = float(table.groupby("vehicle_id")["width"].median().median())
    low, high = NARROW, WIDTH_RANGE[1]
    units = mapping.fields.setdefault("units", {})
    units["size"] = next((u for u in ("m", "ft", "cm") if low <= width * FACTORS[u] <= high), "m")
    mapping.remarks["units.size"] = f"half of the vehicles are wider than {width:g}"


def _motion(mapping: _Draft, moves: pd.DataFrame) -> None:
    """Guesses the units of positions, speeds and angles such that they agree with each other."""
    units, columns = mapping.fields.setdefault("units", {}), mapping.fields["columns"]
    in_feet = re.search(FEET, columns["x"].lower())
    units["position"] = "ft" if in_feet else "m"
    if units.get("size") == "ft" and not (in_feet or re.search(METRES, columns["x"].lower())):
        units["position"], mapping.remarks["units.position"] = "ft", "a guess: sizes are in feet, too"
    by_frame = "time" not in columns
    dt = moves["dt"].to_numpy() * (1.0 / mapping.fields["rate_hz"] if by_frame else FACTORS[units["time"]])
    dx, dy = (moves[name].to_numpy() * FACTORS[units["position"]] for name in ("dx", "dy"))
    driven = np.hypot(dx, dy) / np.where(dt > 0, dt, np.inf)
    slowest = MOVING
    if by_frame and len(driven):  # at another rate they are faster
        slowest = min(MOVING, 0.5 * float(np.quantile(driven, 0.9)))
    moving = driven > slowest
    if "speed" in moves and moving.any():
        speed = np.abs(moves["speed"].to_numpy(np.float64)[moving])
        ratio = max(1.0 / pace(speed, driven[moving]), 1e-9)
        rates = {0.0: 1.0}
        if by_frame:  # the file does not give the rate: choose that of a camera by which speeds agree
            rates = {rate: rate / mapping.fields["rate_hz"] for rate in CAMERA_RATES_HZ}
        position, names = units["position"], columns["speed"]
        agrees = f"column {names} agrees" if isinstance(names, str) else f"columns {' and '.join(names)} agree"
        off = {
            (place, unit, rate): abs(float(np.log(ratio * FACTORS[unit] / faster * FACTORS[position] / FACTORS[place])))
            for place in ([position] if by_frame else POSITIONS)
            for unit in SPEED_UNITS
            for rate, faster in rates.items()
        }
        agreeing = [choice for choice in off if choice[0] == position and off[choice] <= np.log(AGREEMENT)]
        best = min(agreeing or off, key=lambda choice: round(off[choice], 2))
        units["position"], units["speed"], rate = best
        mapping.remarks["units.speed"] = f"{agrees} best with the change of positions in this unit"
        if off[best] > np.log(AGREEMENT):
            mapping.remarks["units.speed"] += f", but is off by a factor of {np.exp(off[best]):.2g}"
        if units["position"] != position:
            mapping.remarks["units.position"] = f"a guess: {agrees} with no change of positions in {position}"
        if by_frame:
            mapping.fields["rate_hz"] = rate
            mapping.remarks["rate_hz"] = "a guess by the change of positions: frames per second of the camera"
    if "yaw" in moves and moving.any():
        _angles(mapping, moves["yaw"].to_numpy(np.float64)[moving], np.arctan2(dy, dx)[moving])


def _angles(mapping: _Draft, angle: FloatArray, motion: FloatArray) -> None:
    """Guesses the convention by which headings `angle` (n,) agree best with the directions of `motion` (n,) [rad]."""
    errors = {
        (unit, zero, positive): float(
            np.median(np.abs(wrap_angle(heading(angle * FACTORS[unit], zero, positive) - motion)))
        )
        for unit, zero, positive in product(ANGLE_UNITS, ZEROS, POSITIVES)
    }
    best = min(errors, key=lambda key: errors[key])
    mapping.fields["units"]["angle"] = best[0]
    mapping.fields["angles"] = {"zero": best[1], "positive": best[2]}
    off = np.rad2deg(errors[best])
    mapping.remarks["angles"] = f"headings are then {off:.2g} degrees off the direction of motion (median)"


def _kinds(mapping: _Draft, kinds: pd.Series) -> None:
    counts = texts(kinds).value_counts()
    translation = {str(name): likely_kind(str(name)) for name in counts.index}
    if mapping.fields["columns"]["kind"].lower() == "v_class":
        translation = {name: NUMBERED.get(name, ours) for name, ours in translation.items()}
    mapping.fields["kinds"] = translation
    vehicles = "unknown ones are vehicles, too: say what they are; " if "unknown" in translation.values() else ""
    held = ", ".join(f"{name or 'empty'} {rows}" for name, rows in counts.items())
    mapping.remarks["kinds"] = f"{vehicles}drop leaves rows out; pedestrian and bicycle keep them as obstacles: {held}"


def _written(mapping: _Draft, head: str) -> str:
    lines = [f"# {head}"]
    for name, value in mapping.fields.items():
        remark = mapping.remarks.get(name)
        if isinstance(value, dict):
            lines.append(f"{name}:{_comment(remark)}")
            for inner, entry in value.items():
                comment = _comment(mapping.remarks.get(f"{name}.{inner}"))
                lines.append(f"  {_scalar(inner)}: {_scalar(entry)}{comment}")
        else:
            lines.append(f"{name}: {_scalar(value)}{_comment(remark)}")
    return "\n".join([*lines, *HINTS]) + "\n"


def _comment(remark: str | None) -> str:
    return f"  # {' '.join(remark.split())}" if remark else ""


def _scalar(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True)
    return text.removesuffix("\n...\n").strip()
