"""Reading of NGSIM's official files block by block, converted from feet to SI units; errors name the line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from litsim_data.ngsim.formats import FEET, Layout
from litsim_data.ngsim.lines import LineParser, line_numbers
from litsim_data.ngsim.row_sites import SiteFinder
from litsim_data.ngsim.sites import FOOT
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

BLOCK = 16 << 20  # [bytes] read at once
LENGTHS_IN_FEET = (8.0, 45.0)  # [ft] plausible range of the median length of vehicles
METRES_BELOW = 8.0  # a median length between 2.5 and this is in metres


@dataclass(frozen=True)
class Block:
    """Consecutive rows of a file.

    Attributes:
        columns: arrays (n,) in SI units by our names; `site` holds indices of ``SITES``, `line` the line numbers.
        end: offset of the byte after the block.
        end_line: number of the line after the block.
        off_site: number of rows left out because their position is far from their site.
    """

    columns: dict[str, np.ndarray]
    end: int
    end_line: int
    off_site: int


class BlockReader:
    """Reads a file block by block.

    Args:
        path: the file.
        layout: see :func:`litsim_data.ngsim.formats.detect`.
        wanted: our names of the columns to read; those that the file lacks are left out.
        truncated: whether an incomplete last line is left out instead of refused.
    """

    def __init__(self, path: Path, layout: Layout, wanted: Sequence[str], *, truncated: bool = False) -> None:
        """Prepare to read; nothing is read yet."""
        needed = {*wanted, "time_ms", "global_x", "global_y", "length"} | ({"location"} & set(layout.columns))
        self.path, self.layout = path, layout
        self._wanted = [name for name in layout.columns if name in needed]
        self._truncated = truncated
        self._parser = LineParser(path, layout, self._wanted)
        self._finder = SiteFinder(path, layout)
        self._units_known = False

    def blocks(self, start: int | None = None, line: int | None = None) -> Iterator[Block]:
        """The blocks from byte `start` on, where line `line` begins; default: from the first row.

        Raises:
            InputError: a line cannot be read, units or positions are not NGSIM's, or the file ends within a line.
        """
        start = self.layout.start if start is None else start
        line = self.layout.line if line is None else line
        with self.path.open("rb") as file:
            file.seek(start)
            while data := file.read(BLOCK):
                cut = data.rfind(b"\n") + 1
                if len(data) < BLOCK:
                    data += file.read()  # usually nothing; else bytes appended in the meantime
                    cut = len(data)
                elif not cut:
                    raise InputError(f"{self.path}: line {line}: no end of line within {BLOCK} bytes")
                block, data_end = data[:cut], start + cut
                file.seek(data_end)
                yield self._block(block, data_end, line)
                start, line = data_end, line + block.count(b"\n") + (not block.endswith(b"\n"))

    def _block(self, data: bytes, end: int, line: int) -> Block:
        end_line = line + data.count(b"\n") + (not data.endswith(b"\n"))
        if not data.endswith(b"\n"):
            data = self._complete(data, end_line - 1)
        if not data.strip():
            return Block({name: np.empty(0) for name in (*self._wanted, "site", "line")}, end, end_line, 0)
        table = self._parser.parse(data, line)
        lines = line_numbers(self.path, data, line, len(table))
        columns = {name: self._parser.numbers(table, name, lines) for name in self._wanted if name != "location"}
        self._check_units(columns["length"])
        for name in FEET:
            if name in columns:
                columns[name] = columns[name] * FOOT
        columns["site"] = self._finder.sites(table, columns, lines)
        columns["line"] = lines
        keep = self._finder.on_site(columns, lines)
        off_site = int((~keep).sum())
        if off_site:
            columns = {name: values[keep] for name, values in columns.items()}
        return Block(columns, end, end_line, off_site)

    def _complete(self, data: bytes, line: int) -> bytes:
        """`data` with its unterminated last line completed, or removed or refused if it has too few columns."""
        head, _, tail = data.rpartition(b"\n")
        count = len(self._parser.split(tail.decode("utf-8", "replace")))
        if not tail.strip() or count == len(self.layout.columns):
            return data + b"\n"
        if self._truncated:
            return head + b"\n" if head else b""
        raise InputError(
            f"{self.path}: line {line}: the file ends within this line, after {count} of {len(self.layout.columns)} "
            f"columns: it is cut off; fetch it again, or read it as it is with --truncated"
        )

    def _check_units(self, length: FloatArray) -> None:
        """Refuse a file in metres, by the median `length` (n,) of its vehicles in the unit of the file."""
        if self._units_known or len(length) == 0:
            return
        median = float(np.median(length))
        low, high = LENGTHS_IN_FEET
        if not low <= median <= high:
            metric = 2.5 <= median < METRES_BELOW
            guess = (
                "metres: NGSIM is published in feet, so use the generic import for this file" if metric else "no feet"
            )
            raise InputError(
                f"{self.path}: line {self.layout.line} and after: column v_Length has median {median:g}, expected "
                f"{low:g} to {high:g} ft; this looks like {guess}"
            )
        self._units_known = True
