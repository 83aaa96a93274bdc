"""A picture of proposed traffic lights: where they are, and beside it when who stood and passed, and what they show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from litsim_data.maps.light_proposal import AMBER_S, Group, Lane, Proposal
from litsim_data.pictures.map_picture import LANE
from litsim_sim.core.colours import INK
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink

DPI = 110
WIDTH, ROW = 14.0, 0.22  # [inch] width of the picture, and height of a lane's row
AROUND_M = 40.0  # [m] around the stop lines that are drawn
GREEN, AMBER, STOOD = "#bfe5c7", "#f7dc92", "#9aa3ad"
LEFT_OUT = "#111111"


def draw_lights(path: Path, lane_map: LaneMap, proposal: Proposal) -> None:
    """Draws a proposal to a PNG file, with a colour for each group of signals.

    Raises:
        InputError: `path` has another suffix or cannot be written.
    """
    if path.suffix != ".png":
        raise InputError(f"{path}: expected a name that ends with .png")
    colour = {group.name: colormaps["tab10"](number % 10) for number, group in enumerate(proposal.groups)}
    rows: list[tuple[Group | None, Lane]] = []
    for group in proposal.groups:
        own = {link.from_lane for link in group.links}
        rows += [(group, lane) for lane in group.lanes if lane.name in own]
    rows += [(None, lane) for lane in proposal.unsure]
    figure = Figure((WIDTH, 5.0 + ROW * len(rows)), layout="constrained")
    place, times = figure.subplots(2, 1, height_ratios=[5.0, ROW * len(rows) + 0.8])
    _draw_place(place, lane_map, proposal, colour)
    for y, (of, lane) in enumerate(rows):
        if of is not None:
            opens = np.arange(of.green_s - of.cycle_s, proposal.duration_s, of.cycle_s)
            _bars(times, y, opens, np.full(len(opens), of.red_s - AMBER_S), GREEN)
            _bars(times, y, opens + of.red_s - AMBER_S, np.full(len(opens), AMBER_S), AMBER)
        _bars(times, y, lane.stands[:, 0], np.diff(lane.stands, axis=1)[:, 0], STOOD, height=0.3)
        shade = LEFT_OUT if of is None else colour[of.name]
        times.plot(lane.passes, np.full(len(lane.passes), y), "|", ms=8, color=shade)
    labels = [f"{lane.name} ({'no light' if of is None else of.name})" for of, lane in rows]
    times.set_yticks(range(len(rows)), labels, fontsize=8)
    times.set(xlim=(0.0, proposal.duration_s), ylim=(len(rows) - 0.4, -0.6), xlabel="time from frame 0 [s]")
    title = "proposed green and amber; gray: the first in the lane stands; stroke: a vehicle passes the stop line"
    times.set_title(title, loc="left", fontsize=10, color=INK)
    FigureCanvasAgg(figure)
    with replacing(path) as new:
        figure.savefig(new, format="png", dpi=DPI)


def _draw_place(axes: Axes, lane_map: LaneMap, proposal: Proposal, colour: dict[str, tuple[float, ...]]) -> None:
    """Draws the connections of each group, over the lanes around them; those left without a light in black."""
    axes.add_collection(LineCollection([lane.centerline for lane in lane_map.lanes], colors=LANE, linewidths=6))
    stops = []
    drawn: list[tuple[SignalLink, str | tuple[float, ...], str]]
    drawn = [(link, colour[group.name], group.name) for group in proposal.groups for link in group.links]
    drawn += [(link, LEFT_OUT, "") for lane in proposal.unsure for link in lane.links]
    named = set[str]()
    for link, shade, name in drawn:
        label = {"label": name} if name and name not in named else {}
        named.add(name)
        axes.plot(*_course(lane_map, link).T, color=shade, lw=2.0, ls="-" if name else ":", **label)
        axes.plot(*_line_of(link).T, color=shade, lw=4.0)
        stops.append(link.stop)
    low, high = np.min(stops, axis=0) - AROUND_M, np.max(stops, axis=0) + AROUND_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(loc="upper right", fontsize=8, frameon=False)
    cycles = sorted({(group.links[0].junction, group.cycle_s) for group in proposal.groups})
    text = ", ".join(f"junction {junction}: cycle {cycle:.1f} s" for junction, cycle in cycles)
    axes.set_title(f"proposed lights; {text}", loc="left", fontsize=10, color=INK)


def _course(lane_map: LaneMap, link: SignalLink) -> FloatArray:
    """Returns the centre line (k, 2) of a connection [m]."""
    inside = [lane_map.lanes[lane_map.row(name)].centerline for name in link.via]
    return np.concatenate([link.stop[None], *inside, link.exit[None]])


def _line_of(link: SignalLink) -> FloatArray:
    """Returns the ends (2, 2) of the stop line of a connection [m]."""
    left = 0.5 * link.width * np.array([-np.sin(link.heading), np.cos(link.heading)])
    return np.stack([link.stop + left, link.stop - left])


def _bars(axes: Axes, y: float, begin: FloatArray, length: FloatArray, colour: str, height: float = 0.8) -> None:
    """Draws bars from times `begin` (n,) for `length` (n,) [s] in the row `y`."""
    axes.barh(np.full(len(begin), y), length, left=begin, height=height, color=colour)
