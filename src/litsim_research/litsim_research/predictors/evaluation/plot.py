"""Diagrams of an evaluation: errors and calibration over the horizon, and predicted conflicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

SIZE, DPI = (15.0, 4.6), 100
ELLIPSE_STYLES = {"50": "--", "90": "-"}


def draw(result: dict[str, dict[str, Any]], path: Path) -> None:
    """Draw the measures by model, `result`, as a PNG.

    Raises:
        OSError: `path` cannot be written.
    """
    with_conflicts = all("conflicts" in measures for measures in result.values())
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3 if with_conflicts else 2)
    _errors(axes[0], result)
    _calibration(axes[1], result)
    if with_conflicts:
        _conflicts(axes[2], result)
    figure.savefig(path, dpi=DPI, format="png")


def _errors(axes: Axes, result: dict[str, dict[str, Any]]) -> None:
    for model, measures in result.items():
        axes.plot(*_line(measures["rmse"]), marker="o", label=model)
    axes.set(title="error of the most probable manoeuvre", xlabel="horizon, s", ylabel="RMSE, m", ylim=(0.0, None))
    axes.legend()


def _calibration(axes: Axes, result: dict[str, dict[str, Any]]) -> None:
    for number, measures in enumerate(result.values()):
        for ellipse, style in ELLIPSE_STYLES.items():
            seconds, shares = _line(measures["calibration_at"][ellipse])
            axes.plot(seconds, [100.0 * share for share in shares], style, marker="o", color=f"C{number}")
    for ellipse in ELLIPSE_STYLES:
        axes.axhline(float(ellipse), color="0.6", linewidth=0.8)
    axes.set(title="truth inside the 50 % and 90 % ellipses", xlabel="horizon, s", ylabel="%", ylim=(0.0, 100.0))


def _conflicts(axes: Axes, result: dict[str, dict[str, Any]]) -> None:
    for number, measures in enumerate(result.values()):
        for measure, style in (("precision", "--"), ("recall", "-")):
            values = {second: counts[measure] for second, counts in measures["conflicts"].items()}
            seconds, shares = _line({second: value for second, value in values.items() if value is not None})
            axes.plot(seconds, [100.0 * share for share in shares], style, marker="o", color=f"C{number}")
    title = "conflicts announced: recall, precision dashed"
    axes.set(title=title, xlabel="horizon, s", ylabel="%", ylim=(0.0, 102.0))


def _line(values: dict[str, float]) -> tuple[list[float], list[float]]:
    """Returns the times [s] and the values, from `values` by time."""
    return [float(second) for second in values], list(values.values())
