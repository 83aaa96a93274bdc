"""Histograms of the severities of events, by kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from litsim_data.mining.events import EventKind
from litsim_sim.core.colours import FAINT, INK
from litsim_sim.io.files import replacing

ALL, TAKEN = "#b9c3d0", "#d62728"
WIDTH, HEIGHT, DPI = 4.2, 2.4, 110  # [inch] of one kind
COLUMNS, BINS = 3, np.linspace(0.0, 1.0, 21)
TARGET = 0.5  # severity at which a measure meets its criticality target


def plot_severities(
    found: Mapping[EventKind, Sequence[float]], taken: Mapping[EventKind, Sequence[float]], path: Path
) -> None:
    """Draws the severities, by kind, of all events and of those in a suite.

    Raises:
        InputError: `path` cannot be written.
        ValueError: its suffix is not that of a picture format.
    """
    kinds = [kind for kind in EventKind if kind in found]
    rows, columns = max(-(-len(kinds) // COLUMNS), 1), max(min(len(kinds), COLUMNS), 1)
    figure = Figure(figsize=(WIDTH * columns, HEIGHT * rows), dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for number, kind in enumerate(kinds):
        axes = figure.add_subplot(rows, columns, number + 1)
        axes.hist(found[kind], BINS, color=ALL, label=f"found, {len(found[kind])}")
        axes.hist(taken.get(kind, ()), BINS, color=TAKEN, label=f"in the suite, {len(taken.get(kind, ()))}")
        axes.axvline(TARGET, color=FAINT, linestyle=(0, (3, 2)), zorder=0)
        axes.set_title(str(kind).replace("_", " "), loc="left", fontsize=10, color=INK)
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("severity")
        axes.set_ylabel("events")
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)
    with replacing(path) as new:
        figure.savefig(new, dpi=DPI, format="png")
