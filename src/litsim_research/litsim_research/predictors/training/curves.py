"""Pictures of learning curves, of all trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from litsim_sim.io.files import replacing

Lines = Mapping[str, str]
"""The lines of a panel: labels by the names of the history's entries."""

COLUMNS = 3
TRAINING, VALIDATION = "training", "validation"
STYLE: Mapping[str, Mapping[str, Any]] = {
    VALIDATION: {"marker": "o", "markersize": 3},
    TRAINING: {"alpha": 0.7, "linewidth": 1.0},
}
PANELS: Mapping[str, Lines] = {
    "RMSE [m]": {"rmse": "training, all steps"} | {f"val_rmse_{k}": f"{k} s" for k in (1, 3, 5)},
    "negative log-likelihood [nats]": {"nll": TRAINING, "val_nll": VALIDATION},
    "share of manoeuvres predicted right": {"val_maneuver": VALIDATION},
}
"""Curves of a predictor's training: by panel, the fields of its history."""


def plot_curves(
    history: Sequence[Mapping[str, float]],
    path: Path,
    panels: Mapping[str, Lines],
    *,
    along: str | None = None,
    log: bool = False,
) -> None:
    """Writes a PNG of `history`; a value is drawn for the entries that contain it, and a panel if one of its values is.

    Args:
        history: one entry per iteration, epoch or validation.
        path: of the picture.
        panels: lines that are drawn together, by title.
        along: name of the entry on the horizontal axis; None for the number of the entry.
        log: whether vertical axes are logarithmic.

    Raises:
        Unwritable: the picture cannot be written; what was there is kept.
    """
    measured = {name for entry in history for name in entry}
    drawn = {title: lines for title, lines in panels.items() if not measured.isdisjoint(lines)}
    rows = max(-(-len(drawn) // COLUMNS), 1)
    figure = Figure(figsize=(13, 3.25 * rows), layout="constrained")
    axes = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False)
    for axis in axes.ravel()[len(drawn) :]:
        axis.remove()
    for axis, (title, lines) in zip(axes.ravel(), drawn.items(), strict=False):
        for name, label in lines.items():
            entries = [i for i, entry in enumerate(history) if name in entry]
            counted = entries if along is None else [history[i][along] for i in entries]
            axis.plot(counted, [history[i][name] for i in entries], label=label, **STYLE.get(label, {}))
        axis.set_title(title, fontsize=10)
        axis.set_yscale("log" if log else "linear")
        axis.grid(alpha=0.3)
        if len(lines) > 1:
            axis.legend(fontsize=8)
    for axis in figure.axes[-COLUMNS:]:
        axis.set_xlabel("iteration" if along is None else along)
        axis.tick_params(labelbottom=True)
    with replacing(path) as new:
        figure.savefig(new, dpi=110, format="png")
