"""Columns of a table in SI units and frame map, by its mapping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.checks import heading
from litsim_data.generic.geography import projected
from litsim_data.generic.mapping import FACTORS, PARTS, Mapping
from litsim_data.generic.reading import texts
from litsim_data.generic.resampling import PIECE
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import RATE_HZ, FloatArray, IntArray, Kind
from litsim_sim.io.table_input import TableFiles, is_stamped, seconds_of

CLOCK = "time_of_frame_0_s"  # note of the header: clock time of the file at frame 0
IDS_KEPT = 5000  # most renumbered vehicle ids that the header lists
NUMBER_MAX = 1e20  # of any column, such as times since 1970 in ns; squares of larger ones overflow
DEGREES_MAX = 1.0  # from the origin, farther than any recording reaches
DERIVED = ("yaw", "speed", "acceleration")  # optional columns
NUMBERS = {kind.name.lower(): int(kind) for kind in Kind}


def in_si(raw: pd.DataFrame, mapping: Mapping, source: TableFiles) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Returns columns in SI units and frame map: vehicle_id, t [s], x, y, length, width, kind, lane, row, and yaw,
    speed and acceleration where given; and notes on ids and clock for the header.

    Raises:
        InputError: a cell is not a number, or an id is missing.
    """
    return _Columns(raw, mapping, source).table()


@dataclass(frozen=True)
class _Columns:
    """The columns of a table, under our names, and what they mean."""

    raw: pd.DataFrame
    mapping: Mapping
    source: TableFiles

    def table(self) -> tuple[pd.DataFrame, dict[str, Any]]:
        """See :func:`in_si`."""
        units, columns, place = self.mapping.units, self.mapping.columns, self.mapping.transform
        ids, names = _ids(self.raw["vehicle_id"], self.raw["row"].to_numpy(), self.source)
        time, clock = self._times()
        sizes = self._sizes()
        x, y = self._places()
        if self.mapping.reference == "box_corner":
            x, y = x + 0.5 * sizes["length"], y + 0.5 * sizes["width"]
        turn, mirror = np.deg2rad(place.yaw_deg), -1.0 if place.mirror_y else 1.0
        y = mirror * y
        kinds = self.raw["kind"].map(NUMBERS).to_numpy(np.int64) if "kind" in self.raw else int(Kind.UNKNOWN)
        values: dict[str, Any] = {
            "vehicle_id": ids,
            "t": time,
            "x": place.x + np.cos(turn) * x - np.sin(turn) * y,
            "y": place.y + np.sin(turn) * x + np.cos(turn) * y,
            "row": self.raw["row"].to_numpy(),
            "kind": kinds,
            "lane": self._numbers("lane") if columns.lane is not None else -1.0,
            **sizes,
        }
        if columns.yaw is not None:
            angle = heading(self._numbers("yaw", units.angle), self.mapping.angles.zero, self.mapping.angles.positive)
            values["yaw"] = mirror * angle + turn
        if isinstance(columns.speed, tuple):
            values["speed"] = np.hypot(*(self._numbers(f"speed_{part}", units.speed) for part in PARTS[2]))
        elif columns.speed is not None:
            values["speed"] = self._numbers("speed", units.speed)
        if columns.acceleration is not None:
            values["acceleration"] = self._numbers("acceleration", units.acceleration)
        return pd.DataFrame(values), clock | names

    def _times(self) -> tuple[FloatArray, dict[str, Any]]:
        """Returns times (n,) [s] from frame 0 on, and a note on the clock then."""
        if self.mapping.columns.time is None:
            return self._numbers("frame") / self.mapping.rate_hz, {}
        time = self._numbers("time", "s" if is_stamped(self.raw["time"]) else self.mapping.units.time)
        zero = float(np.floor(time.min() * RATE_HZ) / RATE_HZ)  # frame 0 is the first one
        return time - zero, {CLOCK: round(zero, 6) + 0.0}

    def _sizes(self) -> dict[str, FloatArray | float]:
        """Returns lengths and widths [m], one for all or (n,); NaN where the table has none."""
        columns, units = self.mapping.columns, self.mapping.units
        if columns.corners is not None:
            x1, y1, x2, y2, x3, y3 = (self._numbers(f"corners_{part}", units.position) for part in PARTS[6])
            sides = np.sort([np.hypot(x2 - x1, y2 - y1), np.hypot(x3 - x2, y3 - y2)], axis=0)
            return {"length": sides[1], "width": sides[0]}
        given = {"length": columns.length, "width": columns.width}
        return {
            name: self._numbers(name, units.size)
            if isinstance(size, str)
            else np.nan
            if size is None
            else size * FACTORS[units.size]
            for name, size in given.items()
        }

    def _places(self) -> tuple[FloatArray, FloatArray]:
        """Returns x and y (n,) [m] in the axes of the file; those on earth by the projection of maps with the origin.

        Raises:
            InputError: a place is not near the origin.
        """
        unit, origin = self.mapping.units.position, self.mapping.origin
        if origin is None:
            return self._numbers("x", unit), self._numbers("y", unit)
        longitude, latitude = self._numbers("x"), self._numbers("y")
        far = np.maximum(np.abs(latitude - origin[0]), np.abs(longitude - origin[1])) > DEGREES_MAX
        if far.any():
            row = int(np.argmax(far))
            raise InputError(
                f"{self.source.place(self.raw['row'].iloc[row])}: latitude {latitude[row]:g} and longitude "
                f"{longitude[row]:g} are more than {DEGREES_MAX:g} degree from field origin of the mapping, "
                f"{list(origin)}; {int(far.sum())} such rows: columns.x is the longitude, columns.y the latitude"
            )
        return projected(latitude, longitude, origin)

    def _numbers(self, name: str, unit: str = "m") -> FloatArray:
        """Returns the numbers (n,) of the column with our `name`, of which one is a `unit`, in SI units.

        NaN stands for empty cells of sizes.

        Raises:
            InputError: a cell is not a number.
        """
        column = self.raw[name]
        column = seconds_of(column) if name == "time" and is_stamped(column) else column
        values = pd.to_numeric(column, errors="coerce").to_numpy(np.float64, na_value=np.nan)
        bad = ~(np.abs(values) <= NUMBER_MAX)
        if name in ("length", "width"):
            bad &= column.notna().to_numpy()
        if bad.any():
            first_bad = int(np.argmax(bad))
            ours = name.rpartition("_")[0] or name
            theirs, cell = self.mapping.columns.named()[name], self.raw[name].iloc[first_bad]
            without = (
                f"; without field columns.{ours} it is derived from the motion, and rows: {{{theirs}: {{min: -1000}}}} "
                "leaves such rows out, with gaps of up to half a second interpolated"
            ) * (ours in DERIVED)
            content = "empty or nan" if pd.isna(cell) else repr(str(cell))
            most = "" if np.isnan(values[first_bad]) else f" of at most {NUMBER_MAX:g}"
            raise InputError(
                f"{self.source.place(self.raw['row'].iloc[first_bad])}: column {theirs!r} is {content}, expected a "
                f"number{most}; {int(bad.sum())} such rows{without}"
            )
        return values * FACTORS[unit]


def _ids(column: pd.Series, row: IntArray, source: TableFiles) -> tuple[IntArray, dict[str, Any]]:
    """Returns ids as integers: small integers stay; others are numbered on from the largest of these, or from 1.

    Raises:
        InputError: an id is missing, or there are too many.
    """
    if (empty := column.isna().to_numpy()).any():
        raise InputError(f"{source.place(row[empty][0])}: no vehicle id; {int(empty.sum())} such rows")
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
