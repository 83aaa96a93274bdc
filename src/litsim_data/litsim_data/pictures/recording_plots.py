"""Pictures of recordings: space-time diagrams by lane and a map of the tracks; of intersections, a plan and signals."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_hex
from matplotlib.figure import Figure, FigureBase

from litsim_data.pictures.plan_view import (
    NEAR,
    Area,
    draw_boxes,
    draw_lanes,
    draw_signals,
    draw_stop_lines,
    frame_stretched,
    groups_in,
    plain,
)
from litsim_data.pictures.plan_view import frame as show_area
from litsim_sim.core.colours import INK
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_crossings import lane_crossings
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.signals import Signals

DPI = 100
LANES_MAX = 12  # diagrams; the busiest lanes
PIECES_MAX = 60_000  # of tracks per diagram; above, frames are left out
WIDTH, DIAGRAM, MAP = 14.0, 1.6, 4.5  # [inch] of everything; heights of one diagram and of the map
BALANCE = 0.2  # share by which one direction must prevail to be the main one
LANE = "#d5d8dc"
SPEEDS = "turbo_r"
UNKNOWN_LANE = "#8a9099"


def draw(
    recording: Recording,
    path: Path,
    text: str,
    lane_map: LaneMap | None = None,
    signals: Signals | None = None,
    moments: Sequence[float] = (),
) -> None:
    """Draws `recording` to a PNG, or to a self-contained HTML page if `path` ends so.

    Where lanes of the net cross under the tracks, it is an intersection: its plan is drawn, in true proportions, and
    below it what the signals showed; else space-time diagrams by lane, and a map of the tracks.

    Args:
        recording: what to draw.
        path: .png, .html or .htm.
        text: what the page says of the recording.
        lane_map: lanes under the tracks.
        signals: signals of the recording, from its first frame on.
        moments: [s] from the first frame on, at which an intersection is drawn as it was then.

    Raises:
        InputError: `path` has another ending or cannot be written, or the recording has no such moments, or shows no
            intersection.
    """
    if path.suffix not in (".png", ".html", ".htm"):
        raise InputError(f"{path}: expected a name that ends with .png or .html")
    if lane_map is not None and _is_intersection(recording, lane_map):
        figure = _intersection(recording, lane_map, signals, moments)
    elif moments:
        raise InputError(f"{path}: moments are drawn of an intersection, and no lanes of a net cross under the tracks")
    else:
        figure = _road(recording, lane_map)
    name = recording.header.name
    title = f"{name}   {recording.header.source}"
    figure.suptitle(title, x=0.012, ha="left", fontsize=11, color=INK, parse_math=False)
    FigureCanvasAgg(figure)
    sink = io.BytesIO()
    figure.savefig(sink, format="png", dpi=DPI)
    content = sink.getvalue()
    if path.suffix != ".png":
        environment = Environment(
            loader=PackageLoader("litsim_data.pictures"), autoescape=True, undefined=StrictUndefined
        )
        picture = base64.b64encode(content).decode()
        content = environment.get_template("recording.html.j2").render(name=name, text=text, picture=picture).encode()
    with replacing(path) as new:
        new.write_bytes(content)


def _main_direction(table: pd.DataFrame) -> float:
    """Returns the direction [rad] of most of the way driven, there or back: as clearly more of it goes, else nearer to
    +x.
    """
    yaw, weight = table["yaw"].to_numpy(), table["speed"].to_numpy() + 1e-3
    axis = 0.5 * float(np.arctan2((weight * np.sin(2 * yaw)).sum(), (weight * np.cos(2 * yaw)).sum()))
    ahead = float((weight * np.cos(yaw - axis)).sum() / weight.sum())
    turned = ahead < -BALANCE or (abs(ahead) <= BALANCE and np.cos(axis) < 0.0)
    return float(wrap_angle(np.array([axis + np.pi]))[0]) if turned else axis


def _intersection(recording: Recording, lane_map: LaneMap, signals: Signals | None, moments: Sequence[float]) -> Figure:
    """Draws all tracks in frame map, coloured by speed, over lanes and stop lines; below, the signals over time.

    Between them, one plan with boxes and stop lines for each of the `moments` [s] from the first frame on.

    Raises:
        InputError: the recording is shorter than a moment says.
    """
    table = recording.table
    tracks = table.sort_values(["vehicle_id", "frame"], ignore_index=True)
    first, steps = int(table["frame"].min()), int(table["frame"].max() - table["frame"].min())
    shown = [round(moment / STEP_S) for moment in moments]
    for moment, step in zip(moments, shown, strict=True):
        if not 0 <= step <= steps:
            raise InputError(
                f"moment {moment:g}: expected 0 to {steps * STEP_S:g} s from the first frame that is drawn"
            )
    area = Area.around(table[["x", "y"]].to_numpy())
    groups = [] if signals is None else groups_in(signals, area, [])
    wide, high = area.high - area.low
    plan = float(np.clip(WIDTH * high / wide, 4.0, 14.0))
    heights = [*[plan] * (1 + len(shown)), *([0.9 + 0.22 * len(groups)] if groups else [])]
    figure = Figure(figsize=(WIDTH, sum(heights) + 0.6), dpi=DPI, layout="constrained", facecolor="white")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    plans = [figure.add_subplot(grid[k]) for k in range(1 + len(shown))]
    speeds = Normalize(0.0, max(1.0, float(table["speed"].quantile(0.98))))
    for axes, instant in zip(plans, (None, *shown), strict=True):
        draw_lanes(axes, lane_map)
        if instant is None:
            _coloured(axes, tracks, np.ones(len(tracks), np.bool_), tracks[["x", "y"]].to_numpy(), speeds, zorder=4)
        else:
            agents = Log.from_recording(recording, first + instant, 1).table(0)
            draw_boxes(axes, agents, [to_hex(colour) for colour in colormaps[SPEEDS](speeds(agents.speed))])
            axes.set_title(f"{instant * STEP_S:.1f} s, frame {first + instant}", loc="left", fontsize=9, color=INK)
        if signals is not None:
            draw_stop_lines(axes, signals, instant or 0)
        show_area(axes, area)
        plain(axes)
    figure.colorbar(
        ScalarMappable(speeds, SPEEDS), ax=plans, label="speed [m/s]", shrink=0.8, pad=0.01, aspect=20 * len(plans)
    )
    if signals is not None and groups:
        lower = figure.add_subplot(grid[-1])
        draw_signals(lower, signals, groups, steps)
        for step in shown:
            lower.axvline(step * STEP_S, color=INK, lw=1.2)
        lower.set_title(f"Signals; time from frame {first}", loc="left", fontsize=9, color=INK)
        plain(lower)
    else:
        plans[0].set_title("no signals are known", loc="left", fontsize=9, color=INK)
    return figure


def _coloured(
    axes: Axes, table: pd.DataFrame, rows: BoolArray, points: FloatArray, speeds: Normalize, zorder: int = 2
) -> None:
    """Draws the tracks of the chosen `rows` of `table` through `points` (n, 2), coloured by speed."""
    pieces, piece_rows = _pieces(table, rows, points)
    colour = table["speed"].to_numpy()[piece_rows]
    axes.add_collection(LineCollection(pieces, array=colour, cmap=SPEEDS, norm=speeds, linewidths=0.7, zorder=zorder))


def _is_intersection(recording: Recording, lane_map: LaneMap) -> bool:
    """Returns whether any track goes over a crossing of lanes."""
    crossings = lane_crossings(lane_map.lanes)
    if not len(crossings):
        return False
    tracks = shapely.multipoints(recording.table[["x", "y"]].to_numpy()[::10])
    return bool((shapely.distance(shapely.points(crossings), tracks) <= NEAR).any())


def _road(recording: Recording, lane_map: LaneMap | None) -> Figure:
    """Draws space-time diagrams by lane and direction, the busiest, and a map of the tracks below them."""
    table = recording.table.sort_values(["vehicle_id", "frame"], ignore_index=True)
    direction = _main_direction(table)
    against = np.asarray(np.cos(table["yaw"].to_numpy() - direction) < 0, np.bool_)
    counts = pd.Series(list(zip(against.tolist(), table["lane"].tolist(), strict=True))).value_counts()
    diagrams = DIAGRAM * min(len(counts), LANES_MAX) + 0.6
    figure = Figure(figsize=(WIDTH, diagrams + MAP), dpi=DPI, layout="constrained", facecolor="white")
    upper, lower = figure.subfigures(2, 1, height_ratios=(diagrams, MAP))
    _space_time(upper, table, direction, against, list(counts.index))
    _tracks(lower.add_subplot(), table, lane_map)
    return figure


def _space_time(
    figure: FigureBase, table: pd.DataFrame, direction: float, turned: BoolArray, groups: list[tuple[bool, int]]
) -> None:
    """Draws a diagram for each of the busiest `groups`: place along `direction` [rad] over time, coloured by speed.

    A group is a lane, and whether its vehicles go against that direction, as the mask `turned` (n,) says of each row.
    """
    shown = sorted(groups[:LANES_MAX])
    along = np.cos(direction) * table["x"].to_numpy() + np.sin(direction) * table["y"].to_numpy()
    lane = table["lane"].to_numpy()
    axes = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    speeds = Normalize(0.0, max(1.0, float(table["speed"].quantile(0.98))))
    time = STEP_S * (table["frame"].to_numpy() - table["frame"].min())
    for axis, (against, number) in zip(axes, shown, strict=True):
        rows = (turned == against) & (lane == number)
        _coloured(axis, table, rows, np.column_stack([time, along]), speeds)
        name = f"lane {number}" if number >= 0 else "lane unknown"
        axis.set_title(f"{name}{', opposite direction' if against else ''}", loc="left", fontsize=9, color=INK)
        axis.set_ylabel("along [m]", fontsize=8)
        plain(axis)
    if len(groups) > len(shown):
        axes[0].set_title(f"the {len(shown)} busiest of {len(groups)} lanes", loc="right", fontsize=9, color=INK)
    axes[0].set(xlim=(0.0, max(STEP_S, float(time.max()))), ylim=(float(along.min()) - 1.0, float(along.max()) + 1.0))
    axes[-1].set_xlabel(f"time [s] from frame {table['frame'].min()}", fontsize=9)
    figure.colorbar(ScalarMappable(speeds, SPEEDS), ax=list(axes), label="speed [m/s]", shrink=0.8, pad=0.01)


def _tracks(axes: Axes, table: pd.DataFrame, lane_map: LaneMap | None) -> None:
    lane = table["lane"].to_numpy()
    for map_lane in lane_map.lanes if lane_map is not None else ():
        axes.plot(*map_lane.centerline.T, color=LANE, lw=3.0, zorder=0, solid_capstyle="butt")
    points = table[["x", "y"]].to_numpy()
    for number in np.unique(lane):
        pieces, _ = _pieces(table, lane == number, points)
        colour = f"C{(number - 1) % 10}" if number >= 0 else UNKNOWN_LANE
        axes.add_collection(LineCollection(pieces, colors=colour, linewidths=0.5, alpha=0.6))
        axes.plot([], [], color=colour, label=f"lane {number}" if number >= 0 else "lane unknown")
    frame_stretched(axes, points.min(axis=0) - 5.0, points.max(axis=0) + 5.0, 0.2)
    axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=12, frameon=False, fontsize=8)
    plain(axes)


def _pieces(table: pd.DataFrame, rows: BoolArray, points: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Returns pieces (k, 2, 2) of tracks between consecutive `points` of chosen rows, and the row (k,) at which each
    begins.
    """
    vehicle, frame = table["vehicle_id"].to_numpy(), table["frame"].to_numpy()
    chosen = np.flatnonzero(rows)
    stride = max(1, len(chosen) // PIECES_MAX)
    chosen = chosen[(frame[chosen] % stride == 0)]
    joined = (vehicle[chosen[1:]] == vehicle[chosen[:-1]]) & (np.diff(frame[chosen]) == stride)
    begin, end = chosen[:-1][joined], chosen[1:][joined]
    return np.stack([points[begin], points[end]], axis=1), begin
