"""The picture of a training: error, likelihood and recognised manoeuvres, by epoch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

PANELS: tuple[tuple[str, str, dict[str, str]], ...] = (
    ("Error", "RMSE [m]", {"rmse": "training, all steps"} | {f"val_rmse_{k}": f"{k} s" for k in (1, 3, 5)}),
    ("Likelihood", "negative log-likelihood [nats]", {"nll": "training", "val_nll": "validation"}),
    ("Manoeuvres", "share right (validation)", {"val_maneuver": "predicted"}),
)
"""Title, unit, and the labels of the lines by the figures of an epoch that they show."""


def plot_curves(history: Sequence[Mapping[str, float]], path: Path) -> None:
    """Draw the figures of the epochs in `history` into the image `path`."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    epochs = [entry["epoch"] for entry in history]
    for axes, (title, unit, lines) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
        for key, label in lines.items():
            axes.plot(epochs, [entry[key] for entry in history], marker=".", label=label)
        axes.set(title=title, xlabel="epoch", ylabel=unit)
        axes.grid(visible=True, alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(path, dpi=110)
