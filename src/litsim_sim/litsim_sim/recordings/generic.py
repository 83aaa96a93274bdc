"""Any table of trajectories to a recording: a mapping (YAML) says which column is what, in which unit, of which point.

docs/data.md has an example each for a source of front centres and one of box centres.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pcsv
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, model_validator

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import RATE_HZ, STEP_S, FloatArray, IntArray, Kind
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.recordings.cleaning.cleaning import clean, front_centres
from litsim_sim.recordings.ngsim.sites import FOOT
from litsim_sim.recordings.ngsim.tracks import PIECE, direction_of_motion
from litsim_sim.recordings.recording import COLUMNS, Recording, RecordingHeader

FACTORS: dict[str, float] = {
    "m": 1.0,
    "ft": FOOT,
    "cm": 0.01,
    "m/s": 1.0,
    "km/h": 1.0 / 3.6,
    "mph": 0.44704,
    "ft/s": FOOT,
    "m/s2": 1.0,
    "ft/s2": FOOT,
    "g": 9.80665,
    "rad": 1.0,
    "deg": float(np.pi / 180.0),
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
}
"""By unit, what one of it is in SI units."""

HOLE_MAX_S = 0.5  # [s] without a row that is interpolated; a longer hole splits the track
IDS_KEPT = 5000  # names of vehicles that are kept in the header; of more, only the count

Length = Literal["m", "ft", "cm"]
KindName = Literal["car", "truck", "motorcycle", "unknown"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Columns(_Strict):
    """Which column of the file is what; numbers in `length` and `width` are the same size for every vehicle.

    Attributes:
        vehicle_id: numbers or text.
        frame: counts at `rate_hz`; either this or `time`.
        time: of the row.
        x, y: of the reference point.
        length, width: column, or a number in the unit of sizes.
        yaw: heading; derived from motion if not given.
        speed, acceleration: along the heading; derived from positions if not given.
        kind: class of the vehicle, translated by `kinds`.
        lane: counted from the left edge, 1 first.
    """

    vehicle_id: str
    frame: str | None = None
    time: str | None = None
    x: str
    y: str
    length: str | Annotated[float, Field(gt=0)]
    width: str | Annotated[float, Field(gt=0)]
    yaw: str | None = None
    speed: str | None = None
    acceleration: str | None = None
    kind: str | None = None
    lane: str | None = None

    @model_validator(mode="after")
    def _one_clock(self) -> Columns:
        if (self.frame is None) == (self.time is None):
            raise ValueError("give either frame or time")
        return self


class Units(_Strict):
    """The units of lengths, speeds, accelerations and times in the file, as the mapping names them."""

    position: Length = "m"
    size: Length = "m"
    speed: Literal["m/s", "km/h", "mph", "ft/s"] = "m/s"
    acceleration: Literal["m/s2", "ft/s2", "g"] = "m/s2"
    angle: Literal["rad", "deg"] = "rad"
    time: Literal["s", "ms", "us", "ns"] = "s"


class Angles(_Strict):
    """Convention of headings: where zero points, and which way they grow, in the axes of the file."""

    zero: Literal["x", "y"] = "x"
    positive: Literal["counterclockwise", "clockwise"] = "counterclockwise"


class Transform(_Strict):
    """Rigid transform to frame map: positions are turned by `yaw_deg` counter-clockwise, then moved by x, y [m].

    `mirror_y` first changes the sign of y (and of headings): for images, whose y grows downwards.
    """

    yaw_deg: float = 0.0
    x: float = 0.0
    y: float = 0.0
    mirror_y: bool = False


class Mapping(_Strict):
    """The mapping file.

    Attributes:
        name, source, licence, net: for the header of the recording.
        columns: which column is what.
        reference: what x and y are of: the middle of the front bumper, or of the box.
        rate_hz: frames per second of column `frame`.
        units, angles, transform: of the file.
        kinds: vehicle classes by what column `kind` says.
        clean: whether headings, speeds and accelerations are derived from smoothed positions. Needed where the file has
            none and positions are noisy; left out, those of the file stay, and missing ones are plain differences.
    """

    name: Annotated[str, Field(min_length=1)]
    source: str = ""
    licence: str = ""
    net: str = ""
    columns: Columns
    reference: Literal["front_centre", "box_centre"]
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = RATE_HZ
    units: Units = Units()
    angles: Angles = Angles()
    transform: Transform = Transform()
    kinds: dict[str, KindName] = {}
    clean: bool = False


def read_mapping(path: Path) -> Mapping:
    """Read a mapping file.

    Raises:
        InputError: it is missing, no YAML, or a field is missing, unknown or of the wrong type.
    """
    return read_yaml(path, Mapping)


def convert(path: Path, mapping: Mapping) -> Recording:
    """The table at `path` (CSV or Parquet) as a recording.

    Raises:
        InputError: a column is missing, a cell is no number (with its line), rows are duplicated, a kind is not in the
            mapping, or the result fails a check of :meth:`Recording.from_table`.
    """
    given = _read(path, mapping)
    table, names = _in_si(given, mapping, path)
    table = _resampled(_split(table, path))
    moving = _with_motion(table, mapping)
    if mapping.clean:
        moving, _ = clean(front_centres(moving).drop(columns=["speed", "acceleration"]))
    header = RecordingHeader(
        name=mapping.name,
        source=mapping.source,
        licence=mapping.licence,
        net=mapping.net,
        notes={"file": path.name, "mapping": mapping.model_dump(exclude_defaults=True), **names},
    )
    return Recording.from_table(header, moving[list(COLUMNS)], str(path))


def _read(path: Path, mapping: Mapping) -> pd.DataFrame:
    """The columns that the mapping names, by our names, and `row`, the line or number of the row."""
    columns = {ours: theirs for ours, theirs in mapping.columns.model_dump().items() if isinstance(theirs, str)}
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with path.open("rb") as file:
            parquet = file.read(4) == b"PAR1"
        if parquet:
            available = pq.read_schema(path).names
        else:
            with pcsv.open_csv(path) as reader:
                available = reader.schema.names
        missing = sorted(set(columns.values()) - set(available))
        if missing:
            raise InputError(f"{path}: columns {missing} of the mapping are missing; the file has {available}")
        wanted = sorted(set(columns.values()))
        if parquet:
            arrow = pq.read_table(path, columns=wanted)
        else:
            options = pcsv.ConvertOptions(include_columns=wanted, strings_can_be_null=True)
            arrow = pcsv.read_csv(path, convert_options=options)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: not readable as CSV or Parquet: {error}") from error
    if not len(arrow):
        raise InputError(f"{path}: holds no rows")
    given = pd.DataFrame({ours: arrow.column(theirs).to_pandas() for ours, theirs in columns.items()})
    return given.assign(row=np.arange(len(given)) + (0 if parquet else 2))


def _in_si(given: pd.DataFrame, mapping: Mapping, path: Path) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Columns in SI units and frame map: vehicle_id, t [s], x, y, yaw, speed, acceleration where given, length, width,
    kind, lane, row; and what the header says of the ids.
    """
    units, columns = mapping.units, mapping.columns
    row = given["row"].to_numpy()

    def numbers(name: str, unit: str = "m") -> FloatArray:
        values = pd.to_numeric(given[name], errors="coerce").to_numpy(np.float64, na_value=np.nan)
        bad = ~np.isfinite(values)
        if bad.any():
            at = int(np.argmax(bad))
            raise InputError(
                f"{path}: line {row[at]}: column {getattr(columns, name)!r} is {given[name].iloc[at]!r}, no number; "
                f"{int(bad.sum())} such rows"
            )
        return values * FACTORS[unit]

    ids, names = _ids(given["vehicle_id"], path)
    time = numbers("time", units.time) if columns.time is not None else numbers("frame") / mapping.rate_hz
    if columns.time is not None:  # frame 0 is the first one
        time = time - np.floor(time.min() * RATE_HZ) / RATE_HZ
    turn, mirror = np.deg2rad(mapping.transform.yaw_deg), -1.0 if mapping.transform.mirror_y else 1.0
    x, y = numbers("x", units.position), mirror * numbers("y", units.position)
    table = pd.DataFrame(
        {
            "vehicle_id": ids,
            "t": time,
            "x": mapping.transform.x + np.cos(turn) * x - np.sin(turn) * y,
            "y": mapping.transform.y + np.sin(turn) * x + np.cos(turn) * y,
            "row": row,
            "kind": _kinds(given, mapping, path),
            "lane": numbers("lane") if columns.lane is not None else -1.0,
        }
    )
    for name in ("length", "width"):
        size = getattr(columns, name)
        table[name] = numbers(name, units.size) if isinstance(size, str) else size * FACTORS[units.size]
    if columns.yaw is not None:
        angle = numbers("yaw", units.angle)
        angle = angle if mapping.angles.positive == "counterclockwise" else -angle
        angle = angle + (0.5 * np.pi if mapping.angles.zero == "y" else 0.0)
        table["yaw"] = mirror * angle + turn
    if columns.speed is not None:
        table["speed"] = numbers("speed", units.speed)
    if columns.acceleration is not None:
        table["acceleration"] = numbers("acceleration", units.acceleration)
    return table, names


def _ids(column: pd.Series, path: Path) -> tuple[IntArray, dict[str, Any]]:
    """Ids as whole numbers: their own where they are small ones, else counted in the order of appearance."""
    if column.isna().any():
        raise InputError(f"{path}: {int(column.isna().sum())} rows have no vehicle id")
    numeric = pd.to_numeric(column, errors="coerce")
    if numeric.notna().all() and (numeric == np.floor(numeric)).all() and numeric.between(0, PIECE - 1).all():
        return numeric.to_numpy(np.int64), {}
    codes, names = pd.factorize(column)
    if len(names) >= PIECE:
        raise InputError(f"{path}: {len(names)} vehicles, expected fewer than {PIECE}")
    kept = {str(name): number for number, name in enumerate(names, 1)} if len(names) <= IDS_KEPT else {}
    return codes + 1, {"ids": kept} if kept else {"ids_renumbered": len(names)}


def _kinds(given: pd.DataFrame, mapping: Mapping, path: Path) -> IntArray:
    if "kind" not in given:
        return np.full(len(given), int(Kind.UNKNOWN))
    said = given["kind"].astype(str).str.strip()
    known = {name: int(Kind[kind.upper()]) for name, kind in mapping.kinds.items()}
    unknown = sorted(set(said.unique()) - set(known))
    if unknown:
        row = given["row"][said == unknown[0]].iloc[0]
        raise InputError(f"{path}: line {row}: kind {unknown[0]!r} is not among kinds of the mapping, {sorted(known)}")
    return np.asarray(said.map(known), np.int64)


def _split(table: pd.DataFrame, path: Path) -> pd.DataFrame:
    """Rows sorted by vehicle and time, tracks with long holes cut and their pieces renumbered."""
    table = table.sort_values(["vehicle_id", "t", "row"], ignore_index=True)
    vehicle, step = table["vehicle_id"].to_numpy(), np.diff(table["t"].to_numpy())
    same = vehicle[1:] == vehicle[:-1]
    twice = same & (step <= 1e-9)
    if twice.any():
        at = int(np.argmax(twice))
        rows = table["row"].to_numpy()[at : at + 2]
        raise InputError(
            f"{path}: lines {rows[0]} and {rows[1]}: vehicle {vehicle[at]} is there twice at "
            f"{table['t'].iloc[at]:.3f} s; {int(twice.sum())} such pairs"
        )
    begins = np.r_[True, ~same]
    cuts = np.cumsum(np.r_[False, same & (step > HOLE_MAX_S + STEP_S)])
    piece = cuts - cuts[np.flatnonzero(begins)][np.cumsum(begins) - 1]
    return table.assign(vehicle_id=vehicle + PIECE * piece)


def _resampled(table: pd.DataFrame) -> pd.DataFrame:
    """Every track at the frames of 10 Hz that lie within its time; values between rows are interpolated.

    Vehicles that are seen between two frames only are left out.
    """
    pieces = []
    for vehicle, rows in table.groupby("vehicle_id", sort=True):
        t = rows["t"].to_numpy()
        first, last = int(np.ceil(t[0] * RATE_HZ - 1e-6)), int(np.floor(t[-1] * RATE_HZ + 1e-6))
        if last < first:
            continue
        frame = np.arange(first, last + 1)
        at = frame * STEP_S
        values: dict[str, Any] = {"vehicle_id": vehicle, "frame": frame}
        for name in ("x", "y", "speed", "acceleration"):
            if name in rows:
                values[name] = np.interp(at, t, rows[name].to_numpy())
        if "yaw" in rows:
            values["yaw"] = np.interp(at, t, np.unwrap(rows["yaw"].to_numpy()))
        nearest = np.clip(np.searchsorted(t, at - 1e-6), 0, len(t) - 1)
        for name in ("length", "width"):
            values[name] = float(rows[name].median())
        for name in ("kind", "lane"):
            values[name] = rows[name].to_numpy()[nearest]
        pieces.append(pd.DataFrame(values))
    if not pieces:
        raise InputError(
            "no vehicle of the file is seen at a frame of 10 Hz: are its times in the unit of the mapping?"
        )
    return pd.concat(pieces, ignore_index=True)


def _with_motion(table: pd.DataFrame, mapping: Mapping) -> pd.DataFrame:
    """Box centres, and what of heading, speed and acceleration the file does not have."""
    vehicle, x, y = (table[name].to_numpy() for name in ("vehicle_id", "x", "y"))
    if "yaw" not in table:
        table = table.assign(yaw=direction_of_motion(vehicle, x, y, np.full(len(table), np.nan)))
    yaw = wrap_angle(table["yaw"].to_numpy())
    if mapping.reference == "front_centre":
        half = 0.5 * table["length"].to_numpy()
        table = table.assign(x=x - half * np.cos(yaw), y=y - half * np.sin(yaw))
    table = table.assign(yaw=yaw)
    if "speed" not in table:
        table = table.assign(speed=np.hypot(_rate(vehicle, x), _rate(vehicle, y)))
    if "acceleration" not in table:
        table = table.assign(acceleration=_rate(vehicle, table["speed"].to_numpy()))
    return table


def _rate(vehicle: IntArray, values: FloatArray) -> FloatArray:
    """Derivative (n,) by time of `values` (n,), by central differences within each vehicle; 0 of a single row."""
    index = np.arange(len(vehicle))
    begins = np.r_[True, vehicle[1:] != vehicle[:-1]]
    ends = np.r_[begins[1:], True]
    before, after = np.where(begins, index, index - 1), np.where(ends, index, index + 1)
    span = np.maximum(after - before, 1) * STEP_S
    return np.asarray((values[after] - values[before]) / span, np.float64)
