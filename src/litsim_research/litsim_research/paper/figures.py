"""The figure of the paper's experiments, made from a campaign, as PNG and SVG."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from litsim_research.paper.measures import count
from litsim_research.paper.tables import Methods
from litsim_sim.io.files import replacing

DPI = 110
WIDTH = 7.5  # [in]
FAULTS = {
    "fault_background": ("background", "#7a8ca3"),
    "fault_ego_avoidable": ("ego, avoidable by the other", "#e0a458"),
    "fault_ego": ("ego alone", "#b5483f"),
}
ENDINGS = ("png", "svg")


def save(canvas: Canvas, folder: Path, name: str) -> None:
    """Write `canvas` to `folder` as PNG and SVG; equal figures give equal files.

    Raises:
        InputError: they cannot be written.
    """
    FigureCanvasAgg(canvas)
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        for ending in ENDINGS:
            with replacing(folder / f"{name}.{ending}") as new:
                metadata = {"Date": None} if ending == "svg" else {"Software": None}
                canvas.savefig(new, dpi=DPI, metadata=metadata)


def contacts_by_fault(by_set: Mapping[str, Methods]) -> Canvas:
    """Draws contacts that are not in the log, by fault, for each method; a panel for each named set of roads."""
    canvas = Canvas((WIDTH, 1.4 + 1.5 * len(by_set)), layout="constrained")
    panels = canvas.subplots(len(by_set), 1, squeeze=False, sharex=True)[:, 0]
    for axes, (name, methods) in zip(panels, by_set.items(), strict=True):
        bottom = np.zeros(len(methods))
        for key, (label, colour) in FAULTS.items():
            values = np.array([count(runs, key) for runs in methods.values()])
            axes.bar(range(len(methods)), values, bottom=bottom, color=colour, label=label)
            bottom += values
        for k, total in enumerate(bottom):
            axes.annotate(f"{total:.0f}", (k, total), ha="center", va="bottom", fontsize=8)
        axes.set_xticks(range(len(methods)), list(methods), rotation=40, ha="right")
        axes.set_title(name, loc="left", fontsize=9)
        axes.set_ylim(0.0, 1.15 * max(float(bottom.max(initial=0.0)), 1.0))
        _plain(axes)
    canvas.supylabel("contacts that are not in the log", fontsize=9)
    marks, labels = panels[0].get_legend_handles_labels()
    canvas.legend(marks, labels, frameon=False, fontsize=8, ncols=len(labels), loc="outside upper center")
    return canvas


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
