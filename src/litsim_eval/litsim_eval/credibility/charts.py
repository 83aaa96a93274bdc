"""Line charts of the page: lines in the units of a chart, as points of an SVG drawing with ticks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from litsim_sim.core.scene import FloatArray

WIDTH, HEIGHT = 420.0, 190.0  # of a drawing, in its units
LEFT, BOTTOM, TOP, RIGHT = 40.0, 22.0, 6.0, 8.0  # room beside the lines
TICKS = 6  # most of an axis


@dataclass(frozen=True)
class Line:
    """A line of a chart.

    Attributes:
        name: of what it shows.
        colour: number of its colour; 0 for people.
        x, y: (m,) points; NaN interrupts the line.
    """

    name: str
    colour: int
    x: FloatArray
    y: FloatArray


@dataclass(frozen=True)
class Chart:
    """A chart.

    Attributes:
        title: with the unit.
        lines: drawn in order, the first one on top.
        x_range, y_range: lowest and highest value that is shown.
        mark: value of x with a vertical line; None for no such line.
    """

    title: str
    lines: Sequence[Line]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    mark: float | None = None

    def drawn(self) -> dict[str, Any]:
        """Returns the values that the template draws."""
        return {
            "title": self.title,
            "size": (WIDTH, HEIGHT),
            "frame": (LEFT, TOP, WIDTH - RIGHT, HEIGHT - BOTTOM),
            "lines": [
                {"name": line.name, "colour": line.colour, "points": points}
                for line in reversed(self.lines)
                for points in self._points(line)
            ],
            "x_ticks": [(self._x(value), f"{value:g}") for value in _ticks(self.x_range)],
            "y_ticks": [(self._y(value), f"{value:g}") for value in _ticks(self.y_range)],
            "mark": None if self.mark is None else self._x(self.mark),
        }

    def _points(self, line: Line) -> Iterator[str]:
        """Yields the unbroken pieces of a line as points of an SVG polyline."""
        finite = np.flatnonzero(np.isfinite(line.x) & np.isfinite(line.y))
        for piece in np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1):
            if len(piece) > 1:
                yield " ".join(f"{self._x(line.x[k])},{self._y(line.y[k])}" for k in piece.tolist())

    def _x(self, value: float) -> float:
        return _place(value, self.x_range, LEFT, WIDTH - RIGHT)

    def _y(self, value: float) -> float:
        return _place(value, self.y_range, HEIGHT - BOTTOM, TOP)


def shares_up_to(name: str, colour: int, values: FloatArray, x_range: tuple[float, float]) -> Line:
    """Returns the line of the share of all `values` that are at most x, over `x_range`; absent ones never are."""
    ranked = np.sort(values[~np.isnan(values)].ravel())
    inside = ranked[(ranked > x_range[0]) & (ranked < x_range[1])]
    steps = np.repeat(np.concatenate([[x_range[0]], inside, [x_range[1]]]), 2)
    before = np.searchsorted(ranked, steps, side="left") / max(values.size, 1)
    after = np.searchsorted(ranked, steps, side="right") / max(values.size, 1)
    return Line(name, colour, steps, np.where(np.arange(len(steps)) % 2 == 0, before, after))


def span(values: Sequence[FloatArray], share: float = 0.02) -> tuple[float, float]:
    """Returns the range that holds all but the outermost `share` of finite `values` at both ends, with some room."""
    finite = np.concatenate([part[np.isfinite(part)].ravel() for part in values])
    if not len(finite):
        return 0.0, 1.0
    low, high = np.quantile(finite, [share, 1.0 - share]).tolist()
    room = 0.05 * (high - low) or 0.5
    return low - room, high + room


def _place(value: float, within: tuple[float, float], first: float, last: float) -> float:
    """Returns where `value` of a range lies between `first` and `last`, at their ends if it is beyond."""
    share = (min(max(value, within[0]), within[1]) - within[0]) / (within[1] - within[0])
    return round(float(first + share * (last - first)), 1)


def _ticks(within: tuple[float, float]) -> list[float]:
    ticks = MaxNLocator(TICKS, steps=[1, 2, 5, 10]).tick_values(*within).tolist()
    return [tick for tick in ticks if within[0] <= tick <= within[1]]
