"""Assignment of rows of NGSIM's official files to sites, with a check of their positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from litsim_data.ngsim.formats import Layout
from litsim_data.ngsim.lines import row_error
from litsim_data.ngsim.sites import FOOT, SITES, site_at, site_of
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, IntArray

OFF_SITE_MAX = 0.01  # largest share of rows of a block that may be far from their site; they are left out


class SiteFinder:
    """Finds the sites of the rows of one file: by column location, or by the first position of the file."""

    def __init__(self, path: Path, layout: Layout) -> None:
        self._path, self._layout = path, layout
        self._site: int | None = None  # for files without column location

    def sites(self, table: pa.Table, columns: dict[str, np.ndarray], lines: IntArray) -> IntArray:
        """Index in ``SITES`` of the site of every row (n,).

        Args:
            table: rows with column `location` as text, if the file has it.
            columns: (n,) `time_ms` [ms], `global_x` and `global_y` [m] of the rows.
            lines: (n,) line numbers of the rows.

        Raises:
            InputError: a location is not one of NGSIM's, or the first position of a file without locations is at none.
        """
        names = list(SITES)
        if "location" not in self._layout.columns:
            if self._site is None:
                first = (float(columns[name][0]) for name in ("time_ms", "global_x", "global_y"))
                site = site_of(*first, urban="direction" in self._layout.columns)
                if site is None:
                    raise self._position_error(columns, lines, np.ones(len(lines), np.bool_))
                self._site = names.index(site.name)
            return np.full(len(lines), self._site, np.int64)
        encoded = table.column("location").combine_chunks().dictionary_encode()
        spelled = [text or "" for text in encoded.dictionary.to_pylist()]
        sites = [site_at(text) for text in spelled]
        codes = np.array([names.index(site.name) if site else -1 for site in sites], np.int64)
        index = codes[encoded.indices.fill_null(0).to_numpy(zero_copy_only=False)]
        if (index < 0).any():
            text = spelled[int(encoded.indices[int(np.argmax(index < 0))].as_py() or 0)]
            known = ", ".join(site.location for site in SITES.values())
            raise row_error(self._path, lines, index < 0, f"column Location is {text!r}, expected one of {known}")
        return index

    def on_site(self, columns: dict[str, np.ndarray], lines: IntArray) -> BoolArray:
        """Mask (n,) of the rows with a position on their site; `columns` are those of :meth:`sites`, and `site`.

        Raises:
            InputError: a share of more than OFF_SITE_MAX has not.
        """
        keep = np.zeros(len(lines), np.bool_)
        for index, site in enumerate(SITES.values()):
            here = columns["site"] == index
            keep[here] = site.holds(columns["global_x"][here], columns["global_y"][here])
        if (~keep).mean() > OFF_SITE_MAX:
            raise self._position_error(columns, lines, ~keep)
        return keep

    def _position_error(self, columns: dict[str, np.ndarray], lines: IntArray, bad: BoolArray) -> InputError:
        at = int(np.argmax(bad))
        x, y = (float(columns[name][at]) / FOOT for name in ("global_x", "global_y"))
        metric = any(site.holds(np.array([x]), np.array([y]))[0] for site in SITES.values())
        guess = "; these are metres: NGSIM is published in feet, use the generic import" if metric else ""
        return row_error(
            self._path,
            lines,
            bad,
            f"Global_X, Global_Y are {x:.1f}, {y:.1f}, at no NGSIM site in feet of the State Plane{guess}",
        )
