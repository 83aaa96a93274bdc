"""Figures of the paper's experiments, made from campaigns, each as PNG and SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_research.paper.measures import ade_parts, count, figure, run_parts
from litsim_research.paper.tables import Methods
from litsim_sim.io.files import replacing

DPI = 110
WIDTH = 7.5  # [in]
FAULTS = {
    "fault_background": ("background", "#7a8ca3"),
    "fault_ego_avoidable": ("ego, avoidable by the other", "#e0a458"),
    "fault_ego": ("ego alone", "#b5483f"),
}
COLOURS = ("#8a8f98", "#4c78a8", "#f58518", "#b279a2", "#72b7b2", "#2e8b3d", "#9ccc9c", "#d9692a")
ENDINGS = ("png", "svg")


def save(canvas: Canvas, folder: Path, name: str) -> list[Path]:
    """Write `canvas` to `folder` as PNG and SVG; equal figures give equal files. Returns their paths.

    Raises:
        InputError: they cannot be written.
    """
    FigureCanvasAgg(canvas)
    paths = []
    with rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        for ending in ENDINGS:
            paths.append(folder / f"{name}.{ending}")
            with replacing(paths[-1]) as new:
                metadata = {"Date": None} if ending == "svg" else {"Software": None}
                canvas.savefig(new, dpi=DPI, metadata=metadata)
    return paths


def contacts_by_fault(by_ego: Mapping[str, Methods]) -> Canvas:
    """Draws contacts that are not in the log, by fault, for each method; a panel per ego."""
    canvas = Canvas((WIDTH, 0.9 + 2.1 * len(by_ego)), layout="constrained")
    panels = canvas.subplots(len(by_ego), 1, squeeze=False)[:, 0]
    for axes, (ego, methods) in zip(panels, by_ego.items(), strict=True):
        bottom = np.zeros(len(methods))
        for key, (label, colour) in FAULTS.items():
            values = np.array([count(runs, key) for runs in methods.values()])
            axes.bar(range(len(methods)), values, bottom=bottom, color=colour, label=label)
            bottom += values
        for k, total in enumerate(bottom):
            axes.annotate(f"{total:.0f}", (k, total), ha="center", va="bottom", fontsize=8)
        axes.set_xticks(range(len(methods)), list(methods))
        axes.set_title(f"ego {ego}", loc="left", fontsize=9)
        _plain(axes)
    canvas.supylabel("contacts that are not in the log", fontsize=9)
    panels[0].legend(frameon=False, title="whose fault", fontsize=8, title_fontsize=8)
    return canvas


def ade_over_time(by_ego: Mapping[str, Mapping[str, Methods]]) -> Canvas:
    """Draws ADE over the horizon, paired over the agents that any method drives; a row per ego, a column per set."""
    canvas = Canvas((WIDTH, 0.5 + 2.4 * len(by_ego)), layout="constrained")
    sets = list(next(iter(by_ego.values())))
    grid = canvas.subplots(len(by_ego), len(sets), sharex=True, sharey="row", squeeze=False)
    for row, (ego, by_set) in zip(grid, by_ego.items(), strict=True):
        for axes, (name, methods) in zip(row, by_set.items(), strict=True):
            parts = {horizon: ade_parts(methods, horizon, "driven") for horizon in HORIZONS_S}
            for k, method in enumerate(methods):
                points = [(h, value.value) for h in HORIZONS_S if (value := figure(parts[h][method]))]
                if points:
                    colour = COLOURS[k % len(COLOURS)]
                    axes.plot(*zip(*points, strict=True), marker="o", ms=3, color=colour, label=method)
            axes.set_title(f"ego {ego}, {name}", fontsize=9)
            axes.set_xticks(HORIZONS_S)
            _plain(axes)
        row[0].set_ylabel("ADE, m")
    for axes in grid[-1]:
        axes.set_xlabel("horizon, s")
    grid[0, -1].legend(frameon=False, fontsize=7)
    return canvas


def takeovers(methods: Methods, names: Sequence[str]) -> Canvas:
    """Draws time off the log and distance from it at release [s, m], as histograms for the methods `names`."""
    canvas = Canvas((WIDTH, 3.0), layout="constrained")
    for axes, (field, label) in zip(
        canvas.subplots(1, 2),
        (("held_s", "time off the log, s"), ("residual_m", "distance from the log at release, m")),
        strict=True,
    ):
        ledgers = {name: _ledger(methods[name], field) for name in names if name in methods}
        longest = max((max(values, default=0.0) for values in ledgers.values()), default=0.0)
        edges = np.linspace(0.0, max(longest, 0.1), 21)
        for name, values in ledgers.items():
            colour = COLOURS[list(methods).index(name) % len(COLOURS)]
            axes.hist(values, edges, histtype="step", color=colour, label=f"{name} ({len(values)})")
        axes.set_xlabel(label)
        axes.legend(frameon=False, fontsize=7)
        _plain(axes)
    canvas.axes[0].set_ylabel("takeovers")
    return canvas


def realism(by_set: Mapping[str, Methods]) -> Canvas:
    """Draws realism of the agents near the ego's log, with its spread over draws; a mark per method, by set."""
    canvas = Canvas((WIDTH, 3.0), layout="constrained")
    axes = canvas.add_subplot()
    names = list(dict.fromkeys(name for methods in by_set.values() for name in methods))
    for k, name in enumerate(names):
        figures = [figure(run_parts(methods.get(name, {}), "realism")) for methods in by_set.values()]
        shift = 0.7 * ((k + 0.5) / len(names) - 0.5)
        marks = [(at + shift, value) for at, value in enumerate(figures) if value is not None]
        axes.errorbar(
            [place for place, _ in marks],
            [value.value for _, value in marks],
            [value.spread or 0.0 for _, value in marks],
            fmt="o",
            ms=5,
            lw=1.2,
            color=COLOURS[k % len(COLOURS)],
            label=name,
        )
    axes.set_xticks(range(len(by_set)), list(by_set))
    axes.set_xlim(-0.5, len(by_set) - 0.5)
    axes.set_ylabel("realism score")
    canvas.legend(frameon=False, fontsize=8, ncols=len(names), loc="outside upper center")
    _plain(axes)
    return canvas


def _ledger(runs: Mapping[Any, Any], field: str) -> list[float]:
    """Returns values of `field` over all takeovers of a method; for the residual, only those that were released."""
    return [
        entry[field]
        for metrics in runs.values()
        if metrics is not None
        for entry in metrics["ledger"]
        if entry[field] is not None and (field != "residual_m" or entry["released_step"] is not None)
    ]


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
