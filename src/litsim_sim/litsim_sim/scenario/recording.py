"""Recordings: observed traffic in one neutral Parquet schema.

A recording is a table with one row per vehicle and frame, with poses of box CENTRES in frame ``map`` (metres of the
SUMO net, x right, y up, yaw counter-clockwise from +x in radians), plus a JSON header in the Parquet metadata.
Converters from published formats: :mod:`litsim_sim.scenario.load`.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import TypeAdapter, ValidationError

from litsim_sim.core.errors import InputError, shown
from litsim_sim.core.scene import RATE_HZ, FloatArray, IntArray
from litsim_sim.io.files import replacing
from litsim_sim.io.parquet_input import UNREADABLE, check_unpacked, parse_arrow, plain_columns, read_arrow

if TYPE_CHECKING:
    import pandas as pd  # imported lazily: it is slow to import, and the nodes of a run do not need it

HEADER_KEY = b"litsim"
CHECK_KEY = b"litsim_crc32"  # key of the checksum in the Parquet metadata; absent in files of older versions

PART_ROWS = 50_000  # rows that are in memory together, of a recording that is read in parts
COLUMNS: dict[str, str] = {
    "vehicle_id": "int64",
    "frame": "int64",
    "x": "float64",
    "y": "float64",
    "yaw": "float64",
    "speed": "float64",
    "acceleration": "float64",
    "length": "float64",
    "width": "float64",
    "kind": "uint8",
    "lane": "int16",
}
"""Columns of the neutral schema and their types. `lane` counts from 1 at the left edge; -1 is unknown."""

BOUNDS: dict[str, tuple[float, float]] = {
    "x": (-1e7, 1e7),
    "y": (-1e7, 1e7),
    "speed": (0.0, 90.0),
    "acceleration": (-60.0, 60.0),
    "length": (0.5, 40.0),
    "width": (0.3, 5.0),
    "yaw": (-10.0, 10.0),
    "kind": (0, 255),
    "lane": (-1, 1000),
}
"""Ranges by column; values outside indicate a wrong unit (feet, km/h, degrees), or do not fit the column's type."""


@dataclass(frozen=True)
class RecordingHeader:
    """Provenance of a recording.

    Attributes:
        name: short name of the recording.
        source: data set, site and period, as in a citation.
        licence: licence of the data.
        rate_hz: frames per second; always 10.
        net: file name of the SUMO net in whose frame the recording is, or empty.
        notes: anything else worth keeping (processing parameters, seeds).
        signals: states of the signals of `net`, as the fields of
            :class:`litsim_sim.scenario.signals.SignalsFile`; empty if unknown.
    """

    name: str
    source: str = ""
    licence: str = ""
    rate_hz: float = RATE_HZ
    net: str = ""
    notes: dict[str, object] = field(default_factory=dict)
    signals: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Recording:
    """A header and columns in the neutral schema, sorted by frame and vehicle.

    Attributes:
        header: provenance.
        columns: (n,) arrays by the names of :data:`COLUMNS`.
    """

    header: RecordingHeader
    columns: Mapping[str, np.ndarray]

    @cached_property
    def table(self) -> pd.DataFrame:
        """The columns as a pandas table."""
        import pandas as pd

        return pd.DataFrame(dict(self.columns))

    @classmethod
    def of_table(cls, header: RecordingHeader, table: pd.DataFrame) -> Recording:
        """Returns the recording of a `table` in the neutral schema, without checks."""
        return cls(header, {name: table[name].to_numpy() for name in COLUMNS})

    def take(self, rows: np.ndarray) -> Recording:
        """Returns the recording restricted to `rows`: ascending indices, or a mask."""
        return Recording(self.header, {name: values[rows] for name, values in self.columns.items()})

    @classmethod
    def from_table(cls, header: RecordingHeader, table: pd.DataFrame, where: str) -> Recording:
        """Check `table` and bring it into the neutral schema; `where` names it in errors.

        Raises:
            InputError: unknown or missing columns, non-finite or implausible values, duplicated rows, holes in a
                track, or a rate other than 10 Hz.
        """
        unknown = [c for c in table.columns if c not in COLUMNS]
        missing = [c for c in COLUMNS if c not in table.columns]
        if unknown or missing:
            raise InputError(
                f"{where}: unknown columns {unknown}, missing columns {missing}; expected exactly {list(COLUMNS)}"
            )
        if not table.columns.is_unique:
            raise InputError(f"{where}: columns {list(table.columns)}, expected each of them once")
        return cls._checked(
            header,
            {name: table[name].to_numpy() for name in COLUMNS},
            lambda name: _numbers(table[name], f"{where}: column {name}"),
            where,
        )

    @classmethod
    def from_columns(cls, header: RecordingHeader, columns: Mapping[str, np.ndarray], where: str) -> Recording:
        """Like :meth:`from_table`, from numeric arrays (n,) by the names of :data:`COLUMNS`."""
        return cls._checked(header, columns, lambda name: columns[name].astype(np.float64, copy=False), where)

    @classmethod
    def _checked(
        cls, header: RecordingHeader, raw: Mapping[str, Any], numbers: Callable[[str], FloatArray], where: str
    ) -> Recording:
        """Check the columns, `raw` and as `numbers`, and make the recording of them; raises as :meth:`from_table`."""
        if header.rate_hz != RATE_HZ:
            raise InputError(f"{where}: header field rate_hz is {header.rate_hz}, expected {RATE_HZ}")
        if not len(raw["frame"]):
            raise InputError(f"{where}: the recording holds no rows")
        for name, dtype in COLUMNS.items():
            values = numbers(name)
            bad = ~np.isfinite(values)
            expected = "a finite number"
            if not dtype.startswith("float"):  # a cast would silently cut fractions off
                bad |= values != np.floor(values)
                expected = "a whole number"
            if name in BOUNDS:
                low, high = BOUNDS[name]
                bad |= (values < low) | (values > high)
                expected += f" in [{low}, {high}]"
            if bad.any():
                row = int(np.argmax(bad))
                vehicle, frame, value = (raw[column][row] for column in ("vehicle_id", "frame", name))
                raise InputError(
                    f"{where}: row {row + 1} (vehicle_id {vehicle}, frame {frame}): column {name} is {value}, "
                    f"expected {expected}; {int(bad.sum())} such rows"
                )
        with np.errstate(invalid="ignore"):  # an id or a frame beyond int64 becomes an arbitrary one
            columns = {name: np.asarray(raw[name]).astype(dtype, copy=False) for name, dtype in COLUMNS.items()}
        if not _in_order(columns["frame"], columns["vehicle_id"]):
            order = np.lexsort((columns["vehicle_id"], columns["frame"]))
            columns = {name: values[order] for name, values in columns.items()}
        _check_tracks(columns, where)
        return cls(header, columns)

    @classmethod
    def read(cls, path: Path) -> Recording:
        """Read a neutral-schema Parquet file; raises InputError as :meth:`from_arrow`."""
        return cls.from_arrow(read_arrow(path), str(path))

    @classmethod
    def from_arrow(cls, arrow: pa.Table, where: str) -> Recording:
        """Returns the recording in the content of a neutral-schema Parquet file; `where` names it in errors.

        Raises:
            InputError: as :meth:`from_table`, or there is no LitSim header, or the checksum does not match.
        """
        metadata = arrow.schema.metadata or {}
        raw = metadata.get(HEADER_KEY)
        if raw is None:
            raise InputError(
                f"{where}: no {HEADER_KEY.decode()!r} header in the Parquet metadata: not a LitSim recording"
            )
        header = _header(raw, where)
        if (columns := _neutral(arrow)) is not None:
            recording = cls.from_columns(header, columns, where)
        else:
            recording = cls.from_table(header, arrow.to_pandas(), where)
        del arrow  # as large as the recording, for which its memory is used from here on
        pa.default_memory_pool().release_unused()
        if metadata.get(CHECK_KEY, (crc := _checksum(raw, lambda name: [recording.columns[name]]))) != crc:
            raise InputError(f"{where}: damaged: its content does not match its checksum")
        return recording

    @classmethod
    def parts(cls, data: bytes, where: str) -> Iterator[Mapping[str, np.ndarray]]:
        """Yields the columns of the recording in the content `data` of a file, part by part if it is long."""
        if _is_long_and_sound(data, where):
            with pq.ParquetFile(pa.BufferReader(data)) as file:
                for batch in file.iter_batches(PART_ROWS):
                    yield plain_columns(pa.Table.from_batches([batch]))
        else:
            yield cls.from_arrow(parse_arrow(pa.BufferReader(data), where), where).columns

    def write(self, path: Path) -> None:
        """Write as Parquet, with the header in the metadata; raises InputError if `path` cannot be written."""
        with replacing(path) as new:
            new.write_bytes(self.parquet)

    @cached_property
    def parquet(self) -> bytes:
        """The recording as a Parquet file (zstd), with header and checksum in the metadata.

        Equal recordings give equal bytes. The checksum covers the whole content; Parquet's own cover single pages.
        """
        arrow = pa.table({name: _arrow(self.columns[name], dtype) for name, dtype in COLUMNS.items()})
        header = asdict(self.header)
        if not self.header.signals:  # as in files of older versions, so that their bytes stay the same
            del header["signals"]
        raw = json.dumps(header, sort_keys=True).encode()
        metadata = {HEADER_KEY: raw, CHECK_KEY: _checksum(raw, lambda name: [self.columns[name]])}
        sink = pa.BufferOutputStream()
        pq.write_table(arrow.replace_schema_metadata(metadata), sink, compression="zstd", write_page_checksum=True)
        return bytes(sink.getvalue().to_pybytes())


def _is_long_and_sound(data: bytes, where: str) -> bool:
    """Returns whether the content of a file is a recording of more than one part, sorted and without an error."""
    try:
        with pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True) as file:
            metadata = file.schema_arrow.metadata or {}
            if file.metadata.num_rows <= PART_ROWS or HEADER_KEY not in metadata:
                return False
            check_unpacked(file.metadata, len(data), where)
            header = _header(metadata[HEADER_KEY], where)
            rows = {name: np.empty(0, np.int64) for name in ("frame", "vehicle_id")}  # the last of each vehicle
            for batch in file.iter_batches(PART_ROWS):
                columns = _neutral(pa.Table.from_batches([batch]))
                if columns is None:
                    return False
                before = int(np.argmax(rows["frame"])) if len(rows["frame"]) else 0
                last = {name: values[before : before + 1] for name, values in rows.items()}
                if not _in_order(*(np.append(last[name], columns[name]) for name in rows)):
                    return False
                Recording.from_columns(header, columns, where)
                rows = {name: np.append(values, columns[name]) for name, values in rows.items()}
                _check_tracks(rows, where)
                latest = len(rows["frame"]) - 1 - np.unique(rows["vehicle_id"][::-1], return_index=True)[1]
                rows = {name: values[latest] for name, values in rows.items()}

            def column(name: str) -> Iterator[np.ndarray]:
                for batch in file.iter_batches(PART_ROWS, columns=[name]):
                    yield plain_columns(pa.Table.from_batches([batch]))[name]

            crc = _checksum(metadata[HEADER_KEY], column)
            return bool(metadata.get(CHECK_KEY, crc) == crc)
    except (InputError, *UNREADABLE):
        return False  # read at once, it tells of all that is wrong


def _header(raw: bytes, where: str) -> RecordingHeader:
    """Returns the header in the JSON text `raw`; fields of other versions are left out.

    Raises:
        InputError: it is no JSON, nested too deep, or a field is missing or of another type.
    """
    try:
        return TypeAdapter(RecordingHeader).validate_json(raw, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = "".join(f"field {part}: " for part in first["loc"][:1])
        raise InputError(
            f"{where}: malformed header in the Parquet metadata: {place}{first['msg']}, found {shown(first['input'])}"
        ) from error


def _neutral(arrow: pa.Table) -> dict[str, np.ndarray] | None:
    """Returns the columns of a table that is in the neutral schema already, types included; else None."""
    if not arrow.num_rows or sorted(arrow.column_names) != sorted(COLUMNS):
        return None
    columns = plain_columns(arrow)
    fit = all(name in columns and columns[name].dtype == dtype for name, dtype in COLUMNS.items())
    return columns if fit else None


def _arrow(values: np.ndarray, dtype: str) -> pa.Array:
    """Returns `values` as an Arrow array of type `dtype`, without nulls."""
    content = pa.py_buffer(np.ascontiguousarray(values, dtype))
    return pa.Array.from_buffers(pa.type_for_alias(dtype), len(values), [None, content])


def _numbers(column: pd.Series, what: str) -> FloatArray:
    """Returns the values of `column` as numbers, NaN where they are none.

    Raises:
        InputError: the type of the column is not numeric, such as times; `what` names the column.
    """
    from pandas import to_numeric

    if column.dtype.kind not in "mM":
        with suppress(TypeError, ValueError):
            return to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    raise InputError(f"{what} is of type {column.dtype}, expected numbers")


def _checksum(header: bytes, column: Callable[[str], Iterable[np.ndarray]]) -> bytes:
    """CRC-32 over the header and the columns of the neutral schema, each in parts, in hexadecimal digits."""
    crc = zlib.crc32(header)
    for name, dtype in COLUMNS.items():
        for values in column(name):
            crc = zlib.crc32(np.ascontiguousarray(values, np.dtype(dtype).newbyteorder("<")).data, crc)
    return b"%08x" % crc


def _in_order(frame: IntArray, vehicle: IntArray) -> bool:
    """Returns whether rows are sorted by frame and vehicle, as files of recordings are."""
    later = frame[1:] > frame[:-1]
    return bool((later | ((frame[1:] == frame[:-1]) & (vehicle[1:] >= vehicle[:-1]))).all())


def _check_tracks(columns: Mapping[str, np.ndarray], where: str) -> None:
    """Refuse duplicated rows and tracks with missing frames."""
    by_vehicle = np.lexsort((columns["frame"], columns["vehicle_id"]))
    vehicle, frame = columns["vehicle_id"][by_vehicle], columns["frame"][by_vehicle]
    same = vehicle[1:] == vehicle[:-1]
    step = frame[1:] - frame[:-1]
    for bad, what in ((same & (step == 0), "is duplicated"), (same & (step > 1), "is followed by a hole")):
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{where}: vehicle_id {vehicle[row]}: frame {frame[row]} {what} (next row: frame {frame[row + 1]}); "
                f"expected one row per frame from the first to the last; {int(bad.sum())} such places"
            )
