"""Reading of NGSIM's official files in blocks of bounded size, from feet to SI units; errors name the line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pcsv
from tqdm import tqdm

from litsim_data.generic.mapping import FOOT
from litsim_data.ngsim.formats import FEET, NAMES, REQUIRED, WHOLE, Layout, detect, is_number
from litsim_data.ngsim.sites import SITES, site_at, site_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.io.input_files import require_file

BLOCK = 16 << 20  # [bytes] read at once
UNKNOWN = pa.array(["", "NA", "NULL", "null", "NaN"])  # cells without a value
LENGTHS_IN_FEET = (8.0, 45.0)  # [ft] plausible range of the median length of vehicles
LENGTHS_IN_METRES = (2.5, 8.0)  # the same in [m]


def row_error(path: Path, lines: IntArray, bad: BoolArray, what: str) -> InputError:
    """Returns an error that `what` is wrong with the first of the `bad` rows (n,); it has the number of the others.

    At least one is bad; `lines` (n,) are the line numbers of all rows.
    """
    more = int(bad.sum()) - 1
    also = f"; and {more} more such rows in this block" if more else ""
    return InputError(f"{path}: line {lines[int(np.argmax(bad))]}: {what}{also}")


def layout_of(path: Path) -> Layout:
    """Returns the layout of the official file at `path`.

    Raises:
        InputError: it is missing, cannot be read, or is not an official file.
    """
    require_file(path, "recording")
    layout = detect(path)
    if layout is None:
        raise InputError(f"{path}: no official NGSIM file")
    return layout


def blocks(path: Path) -> Iterator[pd.DataFrame]:
    """Yields the rows of an official file in its order, block by block, with a bar on a terminal.

    Columns are ``REQUIRED``, by our names and in SI units, `site`, the index in ``SITES``, and `line`.

    Raises:
        InputError: it is not an official file, a line cannot be read, units are not NGSIM's, or a site is unknown.
    """
    layout = layout_of(path)
    names = [name for name in layout.columns if name in (*REQUIRED, "location")]
    line, site, first = layout.line, None, True
    with (
        path.open("rb") as file,
        tqdm(total=path.stat().st_size, unit="B", unit_scale=True, desc=path.name, leave=False, disable=None) as bar,
    ):
        file.seek(layout.start)
        while data := file.read(BLOCK) + file.readline():
            bar.update(len(data))
            table = _parsed(path, layout, names, data, line)
            lines = _line_numbers(path, data, line, len(table))
            line += data.count(b"\n")
            if not len(table):
                continue
            rows = {name: _numbers(path, table.column(name), name, lines) for name in names if name != "location"}
            if first:
                _check_units(path, layout, rows["length"])
            rows |= {name: rows[name] * FOOT for name in FEET}
            if "location" in names:
                rows["site"] = _located(path, table.column("location"), lines)
            else:
                site = _first_site(path, layout, rows, lines) if first else site
                rows["site"] = np.full(len(lines), site)
            first = False
            yield pd.DataFrame({**rows, "line": lines})


def _parsed(path: Path, layout: Layout, names: list[str], data: bytes, line: int) -> pa.Table:
    """Returns the columns `names` of `data`, which begins at line `line`, as text.

    Raises:
        InputError: a line has too few or too many columns, or is no text.
    """
    blanks = layout.separator == " "
    if blanks:
        data = re.sub(rb"(?m)^ +| +$", b"", re.sub(rb"[ \t\r]+", b" ", data))
    try:
        return pcsv.read_csv(
            pa.BufferReader(data),
            read_options=pcsv.ReadOptions(column_names=list(layout.columns)),
            parse_options=pcsv.ParseOptions(delimiter=layout.separator, quote_char=False if blanks else '"'),
            convert_options=pcsv.ConvertOptions(column_types=dict.fromkeys(names, pa.string()), include_columns=names),
        )
    except pa.ArrowInvalid:
        pass
    quoted, expected = rb'"[^"]*"', len(layout.columns)
    for number, raw in enumerate(data.splitlines(keepends=True), line):
        count = re.sub(quoted, b"", raw.strip(b" \r\n")).count(layout.separator.encode()) + 1
        if raw.strip() and count != expected:
            text = raw.decode("utf-8", "replace").strip()
            shown = repr(text if len(text) <= 60 else text[:60] + "...")
            end = "" if raw.endswith(b"\n") else "; the file ends within this line: it is cut off"
            raise InputError(f"{path}: line {number}: {count} columns, expected {expected}: {shown}{end}")
    raise InputError(f"{path}: lines {line} and after: not readable as {layout.title}")


def _line_numbers(path: Path, data: bytes, line: int, rows: int) -> IntArray:
    """Returns the line number (n,) of each of the `rows` rows of `data`, which begins at line `line`.

    Raises:
        InputError: there are more lines than rows: an unclosed quotation mark joined several.
    """
    if data.count(b"\n") + (not data.endswith(b"\n")) == rows:
        return np.arange(line, line + rows)
    full = {number: raw for number, raw in enumerate(data.splitlines(), line) if raw.strip()}
    if len(full) != rows:
        opened = next((number for number, raw in full.items() if raw.count(b'"') % 2), line)
        raise InputError(f"{path}: line {opened}: a quotation mark that is not closed in this line")
    return np.array(list(full), np.int64)


def _numbers(path: Path, texts: pa.ChunkedArray, name: str, lines: IntArray) -> np.ndarray:
    """Returns a column of text as numbers (n,), int64 or float64.

    Raises:
        InputError: a cell is not a number, not an integer, or empty.
    """
    plain = pc.replace_substring(pc.utf8_trim_whitespace(texts), ",", "")
    plain = pc.if_else(pc.is_in(plain, UNKNOWN), None, plain)
    try:
        values = pc.cast(plain, pa.float64()).to_numpy()
    except pa.ArrowInvalid:
        bad = np.array([text is not None and not is_number(text) for text in plain.to_pylist()])
        cell = texts[int(np.argmax(bad))].as_py()
        raise row_error(path, lines, bad, f"column {NAMES[name][0]} is {cell!r}, no number") from None
    if (unknown := ~np.isfinite(values)).any():
        raise row_error(path, lines, unknown, f"column {NAMES[name][0]} is empty or not finite")
    if name not in WHOLE:
        return np.asarray(values, np.float64)
    with np.errstate(invalid="ignore"):  # values beyond int64 differ after the cast
        whole = values.astype(np.int64)
    if (cut := whole != values).any():
        what = f"column {NAMES[name][0]} is {values[int(np.argmax(cut))]:g}, no whole number"
        raise row_error(path, lines, cut, what)
    return whole


def _check_units(path: Path, layout: Layout, length: FloatArray) -> None:
    """Refuses a file in metres, by the median `length` (n,) of its first vehicles in the unit of the file."""
    median, (low, high) = float(np.median(length)), LENGTHS_IN_FEET
    if not low <= median <= high:
        metric = LENGTHS_IN_METRES[0] <= median < LENGTHS_IN_METRES[1]
        guess = "metres: NGSIM is published in feet, so use the generic import for this file" if metric else "no feet"
        raise InputError(
            f"{path}: line {layout.line} and after: column v_Length has median {median:g}, expected {low:g} to "
            f"{high:g} ft; this looks like {guess}"
        )


def _located(path: Path, location: pa.ChunkedArray, lines: IntArray) -> IntArray:
    """Returns the index in ``SITES`` (n,) of each value of column Location.

    Raises:
        InputError: one is not NGSIM's.
    """
    codes, spelled = pd.factorize(location.to_pandas())
    sites = [site_at(text) for text in spelled]
    index = np.array([list(SITES).index(site.name) if site else -1 for site in sites], np.int64)[codes]
    if (index < 0).any():
        locations = ", ".join(site.location for site in SITES.values())
        text = spelled[codes[int(np.argmax(index < 0))]]
        raise row_error(path, lines, index < 0, f"column Location is {text!r}, expected one of {locations}")
    return index


def _first_site(path: Path, layout: Layout, rows: dict[str, np.ndarray], lines: IntArray) -> int:
    """Returns the index in ``SITES`` of the site where the first row is, which is that of a file without locations.

    Raises:
        InputError: it is at none.
    """
    time_ms, x, y = (float(rows[name][0]) for name in ("time_ms", "global_x", "global_y"))
    site = site_of(time_ms, x, y, urban="direction" in layout.columns)
    if site is None:
        metric = any(other.holds(np.array([x / FOOT]), np.array([y / FOOT]))[0] for other in SITES.values())
        guess = "; these are metres: NGSIM is published in feet, use the generic import" if metric else ""
        where = f"{x / FOOT:.1f}, {y / FOOT:.1f}, at no NGSIM site in feet of the State Plane{guess}"
        raise row_error(path, lines, np.ones(len(lines), np.bool_), f"Global_X, Global_Y are {where}")
    return list(SITES).index(site.name)
