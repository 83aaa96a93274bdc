"""Reading and conversion of official NGSIM files, as published.

A file may hold several recordings (the portal's holds all sites and periods). A conversion reads the file once, in
blocks, and spools its rows by clock; then the recordings are made one by one. Memory is bounded by a block and by the
largest recording. Both steps can be interrupted: the progress is kept in a folder ``<OUT>.partial`` beside the result.

Formats: :mod:`litsim_data.ngsim.formats`, read by :mod:`litsim_data.ngsim.blocks`. Conversion:
:mod:`litsim_data.ngsim.convert`. Sites and frames: :mod:`litsim_data.ngsim.sites`. Repairs:
:mod:`litsim_data.ngsim.tracks`. Accelerations and headings: :mod:`litsim_data.cleaning.cleaning`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.ngsim import formats as ngsim_format
from litsim_data.ngsim import tracks as ngsim_tracks
from litsim_data.ngsim.blocks import BlockReader
from litsim_data.ngsim.convert import Converted, Options, Work, bar_over, complete, recording_of
from litsim_data.ngsim.formats import Layout
from litsim_data.ngsim.periods import Clocks, Period
from litsim_data.ngsim.sites import SITES
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import Unwritable
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.recording import Recording


def read(
    path: Path,
    *,
    site: str | None = None,
    period: str | None = None,
    columns: Sequence[str] | None = None,
    truncated: bool = False,
    progress: bool = False,
) -> pd.DataFrame:
    """The rows of an official file in SI units, neither repaired nor cleaned, for fitting maps.

    Args:
        path: official file.
        site: key of ``SITES`` to keep; default: all, which takes 3 GB of memory for the portal's file.
        period: period to keep, such as "0750"; default: all.
        columns: names in ``ngsim_format.NAMES`` to read; default: all.
        truncated: whether an incomplete last line is left out instead of refused.
        progress: show a bar on stderr.

    Returns:
        In the order of the file: the columns (metres, seconds; `global_x`, `global_y` in metres of the State Plane;
        -1 for unknown integers), and `recording` (such as us101_0750), `x`, `y` (FRONT centre, frame map [m]), `line`.
        `frame` counts from the same instant within a recording.

    Raises:
        InputError: it is not an official file, a line cannot be used, or no row is of that site and period.
    """
    if site is not None and site not in SITES:
        raise InputError(f"site {site!r} is unknown, expected one of {', '.join(SITES)}")
    layout = layout_of(path)
    wanted = columns if columns is not None else list(ngsim_format.NAMES)
    names = list(SITES)
    kept: list[pd.DataFrame] = []
    clocks = Clocks()
    for block in blocks_of(path, layout, ["vehicle_id", "frame", *wanted], truncated=truncated, progress=progress):
        if site is not None:
            here = block["site"] == names.index(site)
            block = {name: values[here] for name, values in block.items()}  # noqa: PLW2901
        block["clock"] = clocks.assign(block, str(path))
        kept.append(pd.DataFrame(block))
    table = pd.concat(kept, ignore_index=True) if kept else pd.DataFrame()
    parts = []
    for found in clocks.periods():
        if period is None or found.name.partition("_")[2] == period:
            mine = (table["clock"] == found.clock).to_numpy() & found.holds(table["time_ms"].to_numpy())
            parts.append(_placed(table[mine], found, clocks))
    if not parts:
        held = ", ".join(found.name for found in clocks.periods())
        raise InputError(f"{path}: holds nothing of site {site}, period {period}; it holds {held or 'no rows'}")
    return pd.concat(parts).sort_index(ignore_index=True).drop(columns=["clock", "site"])


def _placed(table: pd.DataFrame, period: Period, clocks: Clocks) -> pd.DataFrame:
    """Rows of one period with positions in frame map and frame numbers of its clock."""
    x, y = period.site.map_from_global(table["global_x"].to_numpy(), table["global_y"].to_numpy())
    frame = ngsim_tracks.frames_of(table["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms)
    return table.assign(frame=frame, recording=period.name, x=x, y=y)


def load(path: Path, crop: Crop | None = None) -> Recording:
    """The only recording of an official file, cleaned.

    Args:
        path: official file.
        crop: the [low, high] to keep, by column under the names of :func:`read`.

    Raises:
        InputError: a line cannot be used, or the file holds several recordings.
    """
    layout = layout_of(path)
    clocks = Clocks()
    kept = []
    for block in blocks_of(path, layout, [*ngsim_tracks.NEEDED, *(crop or {})]):
        block["clock"] = clocks.assign(block, str(path))
        kept.append(pd.DataFrame(block))
        if len(periods := clocks.periods()) > 1:
            raise InputError(
                f"{path}: holds several recordings ({', '.join(period.name for period in periods)} and maybe more): "
                f"convert it first, data convert {path.name} FOLDER"
            )
    if not clocks.clocks:
        raise InputError(f"{path}: holds no rows")
    raw = pd.concat(kept, ignore_index=True)
    recording, _, _ = recording_of(raw, clocks, clocks.periods()[0], path, Options(cleaned=True, crop=crop))
    return recording


def convert(
    source: Path,
    out: Path,
    *,
    cleaned: bool = True,
    truncated: bool = False,
    crop: Crop | None = None,
    progress: bool = False,
) -> list[Converted]:
    """Convert an official file, resuming an interrupted conversion; completed recordings are kept.

    Args:
        source: official file.
        out: a folder, or a file if the name ends with .parquet and the source holds one recording; with several, the
            folder of that name without its suffix. A folder gets one file per recording and ``conversion.json``.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions, or kept as published.
        truncated: whether an incomplete last line is left out instead of refused.
        crop: the [low, high] to keep, by column under the names of :func:`read`.
        progress: show bars on stderr.

    Returns:
        All recordings, including those completed before.

    Raises:
        InputError: a line cannot be used, a recording cannot be made, or `out` cannot be written.
    """
    layout = layout_of(source)
    options = Options(cleaned, truncated, crop)
    try:
        done = complete(source, out, options)
        if done is not None:
            return done
        work = Work(source, out, options)
        try:
            work.spool(layout, progress=progress)
            return work.make(progress=progress)
        except Unwritable:
            raise  # the next call resumes from the spooled rows
        except InputError:
            work.discard()
            raise
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written or read: {error.strerror or error}") from error


def layout_of(path: Path) -> Layout:
    """Layout of the official file at `path`.

    Raises:
        InputError: it is missing, cannot be read, or is not an official file.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such recording")
    layout = ngsim_format.detect(path)
    if layout is None:
        raise InputError(f"{path}: no official NGSIM file")
    return layout


def blocks_of(
    path: Path, layout: Layout, wanted: Sequence[str], *, truncated: bool = False, progress: bool = False
) -> Iterable[dict[str, np.ndarray]]:
    """Columns of every non-empty block of the file, see :class:`.blocks.Block`; with a progress bar.

    Raises:
        InputError: a line cannot be used.
    """
    with bar_over(path, layout.start, progress=progress) as bar:
        for block in BlockReader(path, layout, wanted, truncated=truncated).blocks():
            bar.update(block.end - bar.n)
            if len(block.columns["line"]):
                yield dict(block.columns)
