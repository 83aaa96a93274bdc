"""Columns and layouts of NGSIM's published files, recognised by content.

Two formats:

- text: numbers between blanks, no header, 18 columns (motorways) or 24 (streets: six more, see ``TEXT_COLUMNS``);
- CSV of the US DOT portal (25 columns, all sites in one file) or of its archives (18 columns), header in any order and
  spelling, numbers with or without thousands commas ("1,118,847,869,000").
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import packing_of, read_head

HEAD = 1 << 16  # [bytes] read for recognition

NAMES: dict[str, tuple[str, ...]] = {
    "vehicle_id": ("Vehicle_ID",),
    "frame": ("Frame_ID",),
    "total_frames": ("Total_Frames",),
    "time_ms": ("Global_Time",),
    "local_x": ("Local_X",),
    "local_y": ("Local_Y",),
    "global_x": ("Global_X",),
    "global_y": ("Global_Y",),
    "length": ("v_Length",),
    "width": ("v_Width",),
    "vehicle_class": ("v_Class",),
    "speed": ("v_Vel",),
    "acceleration": ("v_Acc",),
    "lane": ("Lane_ID",),
    "o_zone": ("O_Zone",),
    "d_zone": ("D_Zone",),
    "intersection": ("Int_ID",),
    "section": ("Section_ID",),
    "direction": ("Direction",),
    "movement": ("Movement",),
    "preceding": ("Preceding",),
    "following": ("Following",),
    "space_headway": ("Space_Headway", "Space_Hdwy", "Spacing"),
    "time_headway": ("Time_Headway", "Time_Hdwy", "Headway"),
    "location": ("Location",),
}
"""Names of columns in headers, by our names; case and punctuation are ignored."""

URBAN = ("o_zone", "d_zone", "intersection", "section", "direction", "movement")
UNUSED = (*URBAN, "preceding", "following", "space_headway", "time_headway", "total_frames")
"""Columns that are not read, and may be absent."""

MOTORWAY_COLUMNS = tuple(name for name in NAMES if name not in URBAN and name != "location")
STREET_COLUMNS = tuple(name for name in NAMES if name != "location")
TEXT_COLUMNS = {len(columns): columns for columns in (MOTORWAY_COLUMNS, STREET_COLUMNS)}
REQUIRED = tuple(name for name in MOTORWAY_COLUMNS if name not in UNUSED)

FEET = ("local_x", "local_y", "global_x", "global_y", "length", "width", "speed", "acceleration")
WHOLE = ("vehicle_id", "frame", "time_ms", "vehicle_class", "lane")


@dataclass(frozen=True)
class Layout:
    """Layout of a file.

    Attributes:
        columns: our names, in the order of the file.
        separator: comma, semicolon or tab of a CSV file; a blank for text.
        start: offset of the first byte of data.
        line: number of the first line of data.
    """

    columns: tuple[str, ...]
    separator: str
    start: int
    line: int

    @property
    def title(self) -> str:
        """Name of the format, with its number of columns."""
        kind = "text" if self.separator == " " else "portal CSV" if "location" in self.columns else "CSV"
        return f"official NGSIM {kind}, {len(self.columns)} columns"


def detect(path: Path) -> Layout | None:
    """Returns the layout of the file at `path`, from its first bytes; None if it is not NGSIM's.

    Raises:
        InputError: it cannot be read, or it resembles NGSIM's but columns are missing, unknown or of the wrong number.
    """
    head = read_head(path, HEAD)
    if b"\0" in head or packing_of(path):
        return None
    start = 3 if head.startswith(b"\xef\xbb\xbf") else 0
    line = 1
    for raw in head[start:].splitlines(keepends=True):
        if raw.strip():
            text = raw.decode("utf-8", "replace").strip()
            return _text_layout(text, start, line, path) or _csv_layout(text, start + len(raw), line + 1, path)
        start, line = start + len(raw), line + 1
    return None


def _text_layout(text: str, start: int, line: int, path: Path) -> Layout | None:
    fields = text.split()
    if len(fields) < 10 or not all(is_number(field) for field in fields):
        return None
    if len(fields) not in TEXT_COLUMNS:
        raise InputError(f"{path}: line {line}: {len(fields)} columns of numbers; NGSIM's text files have 18 or 24")
    return Layout(TEXT_COLUMNS[len(fields)], " ", start, line)


def _csv_layout(text: str, start: int, line: int, path: Path) -> Layout | None:
    separator = max(",;\t", key=text.count)
    fields = [field.strip().strip('"') for field in text.split(separator)]
    ours = {_plain(theirs): name for name, spellings in NAMES.items() for theirs in spellings}
    columns = [ours.get(_plain(field), "") for field in fields]
    if not {"vehicle_id", "frame", "time_ms"} <= set(columns):
        return None
    missing = [name for name in REQUIRED if name not in columns]
    unknown = [field for field, name in zip(fields, columns, strict=True) if not name]
    twice = sorted({name for name in columns if name and columns.count(name) > 1})
    if missing or unknown or twice:
        raise InputError(
            f"{path}: line {line - 1}: an NGSIM header with columns missing {missing}, unknown {unknown}, twice {twice}"
        )
    return Layout(tuple(columns), separator, start, line)


def _plain(field: str) -> str:
    return "".join(c for c in field.lower() if c.isalnum())


def is_number(text: str) -> bool:
    """Returns whether `text` is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
