"""The mapping file: the meaning of a table's columns, their units and the reference point of positions.

docs/data.md has examples for front centres and for box centres.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from litsim_sim.core.scene import RATE_HZ

FOOT = 0.3048  # [m]
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
"""Value of one of each unit in SI units."""

PARTS: dict[int, tuple[str, ...]] = {2: ("x", "y"), 6: ("x1", "y1", "x2", "y2", "x3", "y3")}
"""Parts of a quantity that is given by so many columns."""
Corners = tuple[str, str, str, str, str, str]

Number = Annotated[float, Field(allow_inf_nan=False)]
Latitude = Annotated[float, Field(ge=-80.0, le=84.0)]
Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
Length = Literal["m", "ft", "cm"]
KindName = Literal["car", "truck", "motorcycle", "bicycle", "pedestrian", "unknown", "drop"]
Value = str | int | float | bool
Check = Literal["time", "speed", "acceleration", "heading", "side", "size"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Span(_Strict):
    """A range of numbers, bounds included; either may be omitted."""

    min: float = -math.inf
    max: float = math.inf


class Columns(_Strict):
    """Names of the file's columns.

    Attributes:
        vehicle_id: id, number or text.
        frame: frame number at `rate_hz`; either this or `time`.
        time: time of the row.
        x, y: position of the reference point; with field `origin` of the mapping, longitude and latitude [deg].
        length, width: a column, or a number in the unit of sizes that holds for all vehicles. If omitted, those that
            `corners` give, or else usual ones by kind.
        corners: x and y of three corners that follow each other around the box, [x1, y1, x2, y2, x3, y3], in the unit
            of positions: its longer side is the length.
        yaw: heading; derived from motion if omitted.
        speed, acceleration: values along the heading; derived from positions if omitted. Two columns of speed are its
            components along x and y.
        kind: class of the vehicle, translated by `kinds`.
        clip: clip of the row; times and vehicle ids of different clips are unrelated.
        lane: lane number, counted from 1 at the left edge.
    """

    vehicle_id: str
    frame: str | None = None
    time: str | None = None
    x: str
    y: str
    length: str | float | None = None
    width: str | float | None = None
    corners: Corners | None = None
    yaw: str | None = None
    speed: str | tuple[str, str] | None = None
    acceleration: str | None = None
    kind: str | None = None
    clip: str | None = None
    lane: str | None = None

    @field_validator("length", "width", mode="before")
    @classmethod
    def _column_or_size(cls, value: object) -> object:
        is_size = isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf
        if not (value is None or isinstance(value, str) or is_size):
            raise ValueError(f"expected a column, or a number greater than 0, found {value!r:.60}")
        return value

    @field_validator("speed", mode="before")
    @classmethod
    def _one_speed_or_two(cls, value: object) -> object:
        pair = isinstance(value, list | tuple) and len(value) == 2 and all(isinstance(name, str) for name in value)
        if not (value is None or isinstance(value, str) or pair):
            raise ValueError(f"expected a column, or the two of its components, [vx, vy], found {value!r:.60}")
        return value

    @model_validator(mode="after")
    def _one_clock(self) -> Columns:
        if (self.frame is None) == (self.time is None):
            raise ValueError("give either frame or time")
        return self

    @model_validator(mode="after")
    def _sizes_once(self) -> Columns:
        if self.corners is not None and not (self.length is None and self.width is None):
            raise ValueError("give either corners, or length and width")
        return self

    @model_validator(mode="after")
    def _each_for_one_thing(self) -> Columns:
        quantities: dict[str, str] = {}
        for ours, theirs in self.named().items():
            other = quantities.setdefault(theirs, ours)
            if other != ours and {ours, other} != {"length", "width"}:  # of round obstacles
                raise ValueError(f"{other} and {ours} are both column {theirs!r}, expected two")
        return self

    def named(self) -> dict[str, str]:
        """Returns the file's columns by our names; those of several have `PARTS` of the name, such as ``speed_x``."""
        columns: dict[str, str] = {}
        for ours, theirs in self.model_dump().items():
            if isinstance(theirs, str):
                columns[ours] = theirs
            elif isinstance(theirs, tuple):
                columns |= {f"{ours}_{part}": name for part, name in zip(PARTS[len(theirs)], theirs, strict=True)}
        return columns


class Vehicles(_Strict):
    """A second file with one row per vehicle, in which many data sets keep classes and sizes.

    Attributes:
        file: path relative to the table.
        vehicle_id: its column with the ids of the table.
    """

    file: Annotated[str, Field(min_length=1)]
    vehicle_id: str


class Units(_Strict):
    """Units of the file."""

    position: Length = "m"
    size: Length = "m"
    speed: Literal["m/s", "km/h", "mph", "ft/s"] = "m/s"
    acceleration: Literal["m/s2", "ft/s2", "g"] = "m/s2"
    angle: Literal["rad", "deg"] = "rad"
    time: Literal["s", "ms", "us", "ns"] = "s"


class Angles(_Strict):
    """Convention of headings: the axis of the file that zero points along, and the direction in which they grow."""

    zero: Literal["x", "y"] = "x"
    positive: Literal["counterclockwise", "clockwise"] = "counterclockwise"


class Transform(_Strict):
    """Rigid transform to frame map: positions are rotated by `yaw_deg` counter-clockwise, then translated by x, y [m].

    `mirror_y` first changes the sign of y and of headings, for image coordinates with y pointing down.
    """

    yaw_deg: Number = 0.0
    x: Number = 0.0
    y: Number = 0.0
    mirror_y: bool = False


class Mapping(_Strict):
    """The mapping file.

    Attributes:
        name, source, licence, net: fields of the recording's header.
        columns: names of the columns.
        vehicles: file with the columns that the table lacks.
        reference: point that x and y refer to: the centre of the front bumper, of the box, of the rear axle or of the
            rear bumper; or the corner of the box with the smallest x and y, if all vehicles drive along the x axis of
            the file.
        repeated: the last columns of the header, which repeat along each row, once for each time.
        origin: latitude and longitude [deg] of (0, 0), if x and y are longitude and latitude.
        rate_hz: frames per second of column `frame`.
        units, angles, transform: conventions of the file.
        kinds: our kind for each value of column `kind`; ``drop`` leaves rows out. Pedestrians and bicycles always
            follow their log, see :mod:`litsim_data.generic.obstacles`.
        clip: the clip to convert, a value of column `clip`; required if there are several.
        rows: the rows to keep, by column of the file: a value, a list of values, or a :class:`Span`.
        signals: file with the states of the net's signals (docs/signals.md), relative to the mapping; its times are
            those of column `time`, or else count from frame 0.
        accept: checks of :mod:`litsim_data.generic.checks` to skip.
        clean: whether headings, speeds and accelerations are derived from smoothed positions; else those of the file
            are kept, and missing ones are plain differences. None stands for where the motion is noisy
            (:class:`litsim_data.cleaning.noise.Noise`).
    """

    name: Annotated[str, Field(min_length=1)]
    source: str = ""
    licence: str = ""
    net: str = ""
    columns: Columns
    vehicles: Vehicles | None = None
    repeated: list[str] = []
    reference: Literal["front_centre", "box_centre", "rear_axle", "rear_centre", "box_corner"]
    origin: tuple[Latitude, Longitude] | None = None
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = RATE_HZ
    units: Units = Units()
    angles: Angles = Angles()
    transform: Transform = Transform()
    kinds: dict[str, KindName] = {}
    clip: Value | None = None
    rows: dict[str, Value | list[Value] | Span] = {}
    signals: str = ""
    accept: list[Check] = []
    clean: bool | None = None

    @classmethod
    def of_scene(cls, columns: Columns | dict[str, str], kinds: dict[str, str], **fields: Any) -> Mapping:
        """Returns the mapping of a scene's tracks: of box centres, if `reference` is not among other `fields`."""
        return cls.model_validate(
            {"name": "scene", "reference": "box_centre", "columns": columns, "kinds": kinds} | fields
        )

    @model_validator(mode="after")
    def _sizes_of_corners(self) -> Mapping:
        if self.reference == "box_corner" and (self.columns.length is None or self.columns.width is None):
            raise ValueError("reference box_corner needs columns.length and columns.width")
        return self

    @model_validator(mode="after")
    def _kinds_of_a_column(self) -> Mapping:
        if self.kinds and self.columns.kind is None:
            raise ValueError("kinds without columns.kind, expected the column with the kinds of vehicles there")
        return self
