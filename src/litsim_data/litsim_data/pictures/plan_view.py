"""Plan view of an intersection: lanes, stop lines, paths of the agents, and a diagram of the signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from litsim_sim.core.colours import INK, ROAD
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller, FloatArray, IntArray
from litsim_sim.core.signals import SignalState
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_crossings import lane_crossings
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import stop_line_parts
from litsim_sim.scenario.signals import Signals

NEAR = 15.0  # [m] distance from a crossing of lanes within which a path goes over it
ROOM = 12.0  # [m] margin of the view
SIDE_MIN = 60.0  # [m] smallest width and height of the view
ISLAND = 200.0  # [m2] smallest hole between lanes that is no road; smaller ones are inside a junction
GROUND = "#ffffff"

LIGHTS = {
    SignalState.UNAVAILABLE: "#ffffff",
    SignalState.DARK: "#c9cdd3",
    SignalState.FLASHING_RED: "#e9a5a5",
    SignalState.RED: "#c62828",
    SignalState.RED_AMBER: "#d9692a",
    SignalState.GREEN_PERMISSIVE: "#9ccc9c",
    SignalState.GREEN: "#2e8b3d",
    SignalState.AMBER_PERMISSIVE: "#e7b416",
    SignalState.AMBER: "#e7b416",
    SignalState.FLASHING_AMBER: "#f1dc94",
}


@dataclass(frozen=True)
class Area:
    """Extent of a plan view in the map frame [m]."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def around(cls, points: FloatArray) -> Area:
        """Returns the rectangle around `points` (n, 2), with a margin and at least SIDE_MIN wide and high."""
        low, high = points.min(axis=0) - ROOM, points.max(axis=0) + ROOM
        more = np.maximum(0.0, SIDE_MIN - (high - low)) / 2
        return cls(low - more, high + more)

    def holds(self, points: FloatArray) -> np.ndarray:
        """Returns whether each of `points` (..., 2) lies in the area, (...)."""
        return np.asarray(((points >= self.low) & (points <= self.high)).all(axis=-1))


def crossed(lane_map: LaneMap | None, path: FloatArray) -> FloatArray:
    """Returns the crossings (k, 2) of lanes that a path (n, 2) goes over; none without a map."""
    if lane_map is None or not len(path):
        return np.empty((0, 2))
    points = lane_crossings(lane_map.lanes)
    if not len(points):
        return points
    line = shapely.LineString(path) if len(path) > 1 else shapely.Point(path[0])
    return points[shapely.distance(shapely.points(points), line) <= NEAR]


def draw_lanes(axes: Axes, lane_map: LaneMap, **style: Any) -> None:
    """Draws the surface of the road."""
    style = {"edgecolor": "none", "zorder": 0} | style
    surfaces = [shapely.LineString(lane.centerline).buffer(lane.width / 2, cap_style="flat") for lane in lane_map.lanes]
    for part in shapely.get_parts(shapely.union_all(surfaces)):
        axes.fill(*np.asarray(part.exterior.coords).T, facecolor=ROAD, **style)
        for hole in part.interiors:
            if shapely.Polygon(hole).area < ISLAND:
                continue
            axes.fill(*np.asarray(hole.coords).T, facecolor=GROUND, **style)


def draw_stop_lines(axes: Axes, signals: Signals, step: int) -> None:
    """Draws the stop lines, the part of each connection in the colour of its signal at `step`."""
    for ends, state in zip(stop_line_parts(signals.links), signals.of_links(step)[0].tolist(), strict=True):
        axes.plot(*ends.T, color=INK, lw=6.0, solid_capstyle="butt", zorder=2)
        axes.plot(*ends.T, color=LIGHTS[SignalState(state)], lw=4.0, solid_capstyle="butt", zorder=3)


def paths(steps: Steps, area: Area) -> dict[Controller, list[FloatArray]]:
    """Returns pieces (k, 2) of the paths of all agents in `area`, by controller."""
    lines: dict[Controller, list[FloatArray]] = {controller: [] for controller in Controller}
    for _, own in steps.groups(steps.ids.tolist()):
        table = own.stacked
        points = np.stack([table.x, table.y], axis=-1)
        order, follows = tracks(own)
        inside = area.holds(points[order])
        follows[1:] &= inside[1:] | inside[:-1]
        for controller, parts in pieces(points[order], follows, table.controller[order].astype(np.int64)).items():
            lines[Controller(controller)] += [part.copy() for part in parts]  # without the points outside of the area
    return lines


def tracks(steps: Steps) -> tuple[IntArray, BoolArray]:
    """Returns the rows of :attr:`Steps.stacked`, sorted by agent and step.

    Returns:
        The rows (m,), and whether each continues the one before (m,): the same agent at the next step.
    """
    number = steps.stacked.number
    order = np.lexsort((number, steps.agent))
    follows = np.zeros(len(order), np.bool_)
    follows[1:] = (np.diff(steps.agent[order]) == 0) & (np.diff(number[order]) == 1)
    return order, follows


def pieces(points: FloatArray, follows: BoolArray, kind: IntArray) -> dict[int, list[FloatArray]]:
    """Returns lines (k, 2) through `points` (m, 2), by `kind` (m,): a segment is of the kind of its end point.

    A line continues as long as each point `follows` (m,) the one before and is of the same kind.
    """
    begins = follows.copy()
    begins[1:] &= ~follows[:-1] | (np.diff(kind) != 0)
    ends = follows.copy()
    ends[:-1] &= ~follows[1:] | begins[1:]
    lines: dict[int, list[FloatArray]] = {}
    for begin, end in zip(np.flatnonzero(begins).tolist(), np.flatnonzero(ends).tolist(), strict=True):
        lines.setdefault(int(kind[begin]), []).append(points[begin - 1 : end + 1])
    return lines


def draw_boxes(axes: Axes, table: AgentTable, colours: list[str], **style: Any) -> None:
    """Draws the boxes of `table`, each with a bar at its front."""
    corners = box_corners(table.x, table.y, table.yaw, table.length, table.width)
    seen = {"transform": style["transform"]} if "transform" in style else {}
    style = {"facecolors": colours, "edgecolors": INK, "linewidths": 0.7, "zorder": 6} | style
    axes.add_collection(PolyCollection(list(corners), **style))
    axes.add_collection(LineCollection(list(corners[:, [0, 3]]), colors=INK, linewidths=1.8, zorder=7, **seen))


def plain(axes: Axes) -> None:
    """Draws `axes` without lines above and to the right, and with small figures."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=INK, labelsize=8)


def frame_stretched(axes: Axes, low: FloatArray, high: FloatArray, least: float) -> None:
    """Limits `axes` to `low` and `high` (2,) [m]; y is stretched below a share `least` of the width.

    A straight motorway would be a hairline in true proportions.
    """
    tall = (high - low)[1] > least * (high - low)[0]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal" if tall else "auto")
    axes.set(xlabel="x [m]", ylabel="y [m]" if tall else "y [m], stretched")


def frame(axes: Axes, area: Area) -> None:
    """Limits `axes` to `area`, with equal aspect."""
    axes.set(xlim=(area.low[0], area.high[0]), ylim=(area.low[1], area.high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")


def groups_in(signals: Signals, area: Area, first: list[str]) -> list[int]:
    """Returns indices of the signal groups named `first`, then of others with a stop line in `area`."""
    inside = {int(g) for g, link in zip(signals.link_group, signals.links, strict=True) if area.holds(link.stop)}
    order = [signals.groups.index(name) for name in dict.fromkeys(first) if name in signals.groups]
    return [*order, *sorted(inside - set(order))]


def draw_signals(axes: Axes, signals: Signals, groups: list[int], steps: int) -> None:
    """Draws the states of `groups` from step 0 to `steps`, one bar per group, the first at the top."""
    used: set[SignalState] = set()
    for row, group in enumerate(groups):
        shown = signals.states[group, : steps + 1]
        begins = np.flatnonzero(np.diff(shown.astype(int), prepend=-1))
        ends = np.append(begins[1:], len(shown))
        states = [SignalState(int(shown[k])) for k in begins]
        spans = [(STEP_S * float(b), STEP_S * float(e - b)) for b, e in zip(begins, ends, strict=True)]
        axes.broken_barh(spans, (row - 0.38, 0.76), facecolors=[LIGHTS[s] for s in states], edgecolors="none")
        used.update(states)
    axes.set(yticks=range(len(groups)), ylim=(len(groups) - 0.4, -0.6), xlim=(0.0, steps * STEP_S), xlabel="time [s]")
    axes.set_yticklabels([signals.groups[group] for group in groups])
    named = {LIGHTS[s]: s.name.lower().replace("_", " ") for s in sorted(used)}
    handles = [Patch(facecolor=colour, edgecolor=INK, lw=0.5, label=name) for colour, name in named.items()]
    axes.legend(handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5, frameon=False, fontsize=9)


def line_handle(colour: str, label: str, **style: Any) -> Line2D:
    """Returns a line for a legend."""
    return Line2D([], [], color=colour, label=label, **({"lw": 2.5} | style))
