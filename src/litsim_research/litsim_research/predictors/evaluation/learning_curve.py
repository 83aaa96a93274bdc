"""Learning curves over the amount of data: validation errors by the share of the vehicles that were trained on."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from litsim_predictor.inference.weights import Provenance, read_weights
from litsim_sim.core.errors import InputError

SIZE, DPI = (10.0, 4.0), 100
VARIED = ("fraction", "seed")  # fields of a training configuration in which the trainings of one curve differ
MEASURES = {"val_error": "RMSE, mean over 1 to 5 s, m", "val_nll": "negative log-likelihood, nats"}

Curves = dict[str, dict[float, dict[str, float]]]
"""Measures by name of the configuration, share of the vehicles, and name of the measure."""


def learning_curves(files: Iterable[Path]) -> Curves:
    """The :data:`MEASURES` of trainings, from the metadata of `files` of weights; means over seeds.

    Raises:
        InputError: a file does not contain weights or figures of a training, or its training configuration differs from
            that of others of the same name in other fields than :data:`VARIED`.
    """
    found: dict[str, dict[float, list[dict[str, float]]]] = {}
    same: dict[str, dict[str, Any]] = {}
    for file in files:
        made = read_weights(str(file)).provenance
        name = _configuration(made, file)
        others = {field: value for field, value in made.training.items() if field not in VARIED}
        first = same.setdefault(name, others)
        for field in sorted(first | others):
            if first.get(field) != others.get(field):
                raise InputError(
                    f"{file}: field {field} of its training is {others.get(field)}, expected {first.get(field)} as in "
                    f"the first of {name}: trainings of one curve differ in {' and '.join(VARIED)} alone"
                )
        found.setdefault(name, {}).setdefault(made.training["fraction"], []).append(made.figures)
    return {
        name: {
            share: {key: sum(each[key] for each in seeds) / len(seeds) for key in MEASURES}
            for share, seeds in sorted(shares.items())
        }
        for name, shares in found.items()
    }


def _configuration(made: Provenance, file: Path) -> str:
    """Name of the training configuration, from the command of the training."""
    words = shlex.split(made.command)
    if "--config" not in words or "fraction" not in made.training or not set(MEASURES) <= set(made.figures):
        raise InputError(f"{file}: its metadata tell of no training, expected what `train` leaves")
    return words[words.index("--config") + 1].removesuffix(".yaml")


def draw(curves: Curves, path: Path) -> None:
    """Draw `curves` as a PNG.

    Raises:
        OSError: `path` cannot be written.
    """
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    for axes, (measure, title) in zip(figure.subplots(1, len(MEASURES)), MEASURES.items(), strict=True):
        for name, shares in curves.items():
            axes.plot([100.0 * share for share in shares], [of[measure] for of in shares.values()], "o-", label=name)
        ticks = sorted({100.0 * share for shares in curves.values() for share in shares})
        axes.set_xscale("log", base=2)
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set(title="validation", xlabel="vehicles trained on, %, logarithmic", ylabel=title)
        axes.grid(visible=True, alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=DPI, format="png")
