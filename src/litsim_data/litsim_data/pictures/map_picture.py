"""A picture of a net's check: the lanes, the tracks on them, and the tracks' positions on no lane."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from string import ascii_uppercase

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from litsim_data.maps.check import NetCheck
from litsim_data.maps.lane_graph import around
from litsim_data.maps.placement import Miss
from litsim_data.pictures.plan_view import frame_stretched, plain
from litsim_sim.core.colours import INK
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap

DPI = 110
WIDTH, LEGEND = 14.0, 0.9  # [inch] width of the picture, and height of the legend
HEIGHTS = (2.5, 8.0)  # [inch] bounds of the overview's height
STRETCHED = 0.15  # height to width below which y is stretched
DETAILS = 4  # most places that are drawn enlarged
DETAIL_M = 40.0  # [m] side of each
PLACES_APART = 40.0  # [m] smallest distance between them
MARGIN = 10.0  # [m] around the tracks
NARROW = 0.7  # smallest width to height of the extent drawn
POINTS_MAX = 200_000  # most points of tracks; of more, only every n-th row is drawn
LANE, INSIDE, EDGE = "#dfe3e8", "#edf0f4", "#b4bbc4"
TRACK, MISS, FITTED, NO_WAY_IN, NO_EXIT, CROSSES = "#3b7dd8", "#d62728", "#2a9d57", "#e07b00", "#7b3fb5", "#111111"


def draw(path: Path, lane_map: LaneMap, parts: Mapping[str, pd.DataFrame], check: NetCheck) -> None:
    """Draws the lanes, the tracks of all `parts` and the findings of `check` to a PNG file.

    Raises:
        InputError: `path` has another suffix or cannot be written.
    """
    if path.suffix != ".png":
        raise InputError(f"{path}: expected a name that ends with .png")
    ordered = (table.sort_values(["vehicle_id", "frame"], ignore_index=True) for table in parts.values())
    tables = [table.iloc[:: max(1, len(table) // POINTS_MAX)] for table in ordered]
    misses = _places([miss for part in check.placements.values() for miss in part.worst])
    low, high = _extent(lane_map, tables)
    figure, overview, details = _panels((high - low)[1] / (high - low)[0], len(misses))
    _scene(overview, lane_map, tables, check)
    frame_stretched(overview, low, high, STRETCHED)
    shares = [f"{name}: {part.inside:.1%} on lanes" for name, part in check.placements.items()]
    more = f" and {len(shares) - 4} more" if len(shares) > 4 else ""
    overview.set_title(", ".join(shares[:4]) + more, loc="left", fontsize=10, color=INK)
    for name, miss, detail in zip(ascii_uppercase, misses, details, strict=False):
        style = {"textcoords": "offset points", "color": MISS, "weight": "bold", "zorder": 7}
        overview.annotate(name, (miss.x, miss.y), xytext=(6, 4), **style)
        overview.plot(miss.x, miss.y, "o", ms=9, mfc="none", mec=MISS, mew=1.2, zorder=6)
        _scene(detail, lane_map, tables, check)
        half = 0.5 * DETAIL_M
        detail.set(xlim=(miss.x - half, miss.x + half), ylim=(miss.y - half, miss.y + half), aspect="equal")
        text = f"{name}: vehicle {miss.vehicle} at {miss.time_s:.1f} s, {miss.beyond:.1f} m off"
        detail.set_title(text, loc="left", fontsize=9, color=INK)
        detail.plot(miss.x, miss.y, "o", ms=14, mfc="none", mec=MISS, mew=1.5, zorder=6)
    figure.legend(handles=_legend(check), loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    FigureCanvasAgg(figure)
    with replacing(path) as new:
        figure.savefig(new, format="png", dpi=DPI)


def _panels(ratio: float, details: int) -> tuple[Figure, Axes, list[Axes]]:
    """Returns a figure with an overview of an extent of a height-to-width `ratio`, and `details` panels below."""
    height, size = min(max(WIDTH * ratio, HEIGHTS[0]), HEIGHTS[1]), WIDTH / DETAILS
    rows = 1 + bool(details)
    figure = Figure((WIDTH, height + LEGEND + size * bool(details)), DPI, facecolor="white")
    grid = figure.add_gridspec(rows, max(details, 1), height_ratios=(height, size)[:rows])
    figure.set_layout_engine("constrained", w_pad=0.12, h_pad=0.06)
    return figure, figure.add_subplot(grid[0, :]), [figure.add_subplot(grid[1, column]) for column in range(details)]


def _extent(lane_map: LaneMap, tables: list[pd.DataFrame]) -> tuple[FloatArray, FloatArray]:
    """Returns corners (2,) of the extent drawn: the tracks with a margin; without tracks the net."""
    if not tables:
        bounds = np.array(lane_map.bounds)
        return bounds[:2] - MARGIN, bounds[2:] + MARGIN
    points = np.concatenate([table[["x", "y"]].to_numpy() for table in tables])
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    wider = np.array([max(0.0, 0.5 * (NARROW * (high - low)[1] - (high - low)[0])), 0.0])
    return low - wider, high + wider


def _places(misses: list[Miss]) -> list[Miss]:
    """Returns the worst misses at up to DETAILS places at least PLACES_APART apart."""
    chosen: list[Miss] = []
    for miss in sorted(misses, key=attrgetter("beyond"), reverse=True):
        if len(chosen) < DETAILS and all(
            math.hypot(miss.x - other.x, miss.y - other.y) > PLACES_APART for other in chosen
        ):
            chosen.append(miss)
    return chosen


def _scene(axes: Axes, lane_map: LaneMap, tables: list[pd.DataFrame], check: NetCheck) -> None:
    """Draws lanes, tracks, misses and marks."""
    for internal, colour in ((True, INSIDE), (False, LANE)):
        sides = [around(lane.centerline, lane.width) for lane in lane_map.lanes if lane.is_internal == internal]
        areas = [np.vstack([right, left[::-1]]) for left, right in sides]
        axes.add_collection(
            PolyCollection(areas, facecolors=colour, edgecolors=EDGE, linewidths=0.4, zorder=1 - internal)
        )
    for table, fitted in zip(tables, check.alignments.values(), strict=True):
        x, y = table["x"].to_numpy(), table["y"].to_numpy()
        new = np.flatnonzero(np.diff(table["vehicle_id"].to_numpy())) + 1
        axes.add_collection(_lines(x, y, new, TRACK, 2))
        if not fitted.in_place:
            axes.add_collection(_lines(*fitted.apply(x, y), new, FITTED, 3))
        off = ~lane_map.inside_road(x, y)
        axes.plot(x[off], y[off], ".", ms=2.5, color=MISS, zorder=4)
    connectivity = check.connectivity
    for names, marker, colour, vertex in (
        ((*(gap.lane for gap in connectivity.gaps), *connectivity.unreached), ">", NO_WAY_IN, 0),
        (connectivity.stuck, "s", NO_EXIT, -1),
    ):
        points = np.array([lane_map.lanes[lane_map.row(name)].centerline[vertex] for name in names]).reshape(-1, 2)
        axes.plot(*points.T, marker, ms=8, mfc=colour, mec="white", ls="none", zorder=5)
    places = np.array([(crossing.x, crossing.y) for crossing in connectivity.crossings]).reshape(-1, 2)
    axes.plot(*places.T, "x", ms=9, mew=2.5, color=CROSSES, zorder=5)
    plain(axes)


def _lines(x: FloatArray, y: FloatArray, new: np.ndarray, colour: str, order: int) -> LineCollection:
    """Returns tracks as lines; `new` are the rows at which another vehicle begins."""
    return LineCollection(
        np.split(np.column_stack([x, y]), new), colors=colour, linewidths=0.6, alpha=0.55, zorder=order
    )


def _legend(check: NetCheck) -> list[Line2D | Patch]:
    """Returns the entries of the legend: what is drawn, and how much of it."""
    connectivity = check.connectivity
    missing = sum(part.missing for part in check.placements.values())
    entries: list[Line2D | Patch] = [
        Patch(fc=LANE, ec=EDGE, label="lane"),
        Patch(fc=INSIDE, ec=EDGE, label="lane inside a junction"),
        Line2D([], [], color=TRACK, label="track"),
        Line2D([], [], color=MISS, marker=".", ls="none", label=f"centre on no lane ({missing} vehicles)"),
    ]
    if any(not alignment.in_place for alignment in check.alignments.values()):
        entries.append(Line2D([], [], color=FITTED, label="tracks, moved to their best fit"))
    for count, marker, colour, text in (
        (len(connectivity.gaps) + len(connectivity.unreached), ">", NO_WAY_IN, "lane without a way in"),
        (len(connectivity.stuck), "s", NO_EXIT, "lane without exit"),
        (len(connectivity.crossings), "x", CROSSES, "edges cross"),
    ):
        if count:
            entries.append(Line2D([], [], color=colour, marker=marker, ls="none", ms=8, label=f"{text} ({count})"))
    return entries
