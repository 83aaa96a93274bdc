"""Official NGSIM files, as they are published, to recordings.

One file may hold several recordings (the portal's holds all sites and periods), so a conversion goes over the file
once, in blocks, and lays its rows aside by recording; then every recording is made for itself. Memory is bounded by a
block and by the largest recording. Both steps can be interrupted: what is done is kept beside the result, in a folder
``<OUT>.partial``, until everything is done.

Formats: :mod:`litsim_sim.recordings.ngsim.formats`, read by :mod:`litsim_sim.recordings.ngsim.blocks`. The work itself:
:mod:`litsim_sim.recordings.ngsim.convert`. Frames and sites: :mod:`litsim_sim.recordings.ngsim.sites`. What is mended:
:mod:`litsim_sim.recordings.ngsim.tracks`. Accelerations and headings: :mod:`litsim_sim.recordings.cleaning.cleaning`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import Unwritable
from litsim_sim.recordings.cropping import Crop
from litsim_sim.recordings.ngsim import formats as ngsim_format
from litsim_sim.recordings.ngsim import tracks as ngsim_tracks
from litsim_sim.recordings.ngsim.blocks import BlockReader
from litsim_sim.recordings.ngsim.convert import Converted, Options, Work, bar_over, complete, recording_of
from litsim_sim.recordings.ngsim.formats import Layout
from litsim_sim.recordings.ngsim.periods import Clocks, Period
from litsim_sim.recordings.ngsim.sites import SITES
from litsim_sim.recordings.recording import Recording


def read(
    path: Path,
    *,
    site: str | None = None,
    period: str | None = None,
    columns: Sequence[str] | None = None,
    truncated: bool = False,
    progress: bool = False,
) -> pd.DataFrame:
    """The rows of an official file with all their columns, in SI units, neither mended nor cleaned: for fitting maps.

    Args:
        path: official file.
        site: name of ``SITES`` to which to keep; all if not given. The portal's whole file takes 3 GB otherwise.
        period: such as "0750"; all if not given.
        columns: of ``ngsim_format.NAMES`` that are needed; all if not given.
        truncated: whether a last line that is cut off is left out instead of refused.
        progress: show a bar on stderr.

    Returns:
        in the order of the file: the columns (metres, seconds; `global_x`, `global_y` in metres of the State Plane;
        whole numbers with -1 for unknown), and `recording` (such as us101_0750), `x`, `y` (FRONT centre, frame map
        [m]), `line`. `frame` counts from the same instant within a recording.

    Raises:
        InputError: it is no official file, a line of it cannot be used, or nothing of it is of that site and period.
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
    """Rows of one period with positions in frame map and frames of its clock."""
    x, y = period.site.map_from_global(table["global_x"].to_numpy(), table["global_y"].to_numpy())
    frame = ngsim_tracks.frames_of(table["time_ms"].to_numpy(), clocks.clocks[period.clock].origin_ms)
    return table.assign(frame=frame, recording=period.name, x=x, y=y)


def load(path: Path, crop: Crop | None = None) -> Recording:
    """The one recording that an official file holds, cleaned, in memory.

    Args:
        path: official file.
        crop: by column as :func:`read` names them, the [low, high] to keep.

    Raises:
        InputError: a line of it cannot be used, or it holds several recordings.
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
    """Convert an official file; what an earlier, interrupted call has done is taken up, what is complete is left.

    Args:
        source: official file.
        out: where it goes. A name that ends with .parquet is one file if the source holds one recording, and else the
            folder of that name without its ending; any other name is a folder. In a folder every recording has a file
            of its own, and ``conversion.json`` says what was found.
        cleaned: whether headings, speeds and accelerations are derived from smoothed positions, or stay as published.
        truncated: whether a last line that is cut off is left out instead of refused.
        crop: by column as :func:`read` names them, the [low, high] to keep.
        progress: show bars on stderr.

    Returns:
        the recordings, also those that were complete before; `mended` and `cleaning` are those of their conversion.

    Raises:
        InputError: a line of the file cannot be used, no recording can be made of its rows, or `out` cannot be written.
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
            raise  # what is laid aside is taken up by the next call
        except InputError:
            work.discard()
            raise
    except OSError as error:
        raise InputError(f"{error.filename or out}: cannot be written or read: {error.strerror or error}") from error


def layout_of(path: Path) -> Layout:
    """Find out how the official file at `path` is laid out.

    Raises:
        InputError: it is missing, cannot be read, or is no official file.
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
    """Columns of every block of the file that has rows, with a bar; as :class:`.blocks.Block`.

    Raises:
        InputError: a line cannot be used.
    """
    with bar_over(path, layout.start, progress=progress) as bar:
        for block in BlockReader(path, layout, wanted, truncated=truncated).blocks():
            bar.update(block.end - bar.n)
            if len(block.columns["line"]):
                yield dict(block.columns)
