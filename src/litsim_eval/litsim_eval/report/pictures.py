"""A scene of a run as a PNG: the bird's-eye view around the ego."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from litsim_eval.report.content import road
from litsim_eval.report.tracks import Tracks, ghosts_of, tracks_of
from litsim_sim.core.colours import COLOURS, Mode
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import box_corners, to_body
from litsim_sim.core.scene import BoolArray, FloatArray, is_obstacle
from litsim_sim.io.files import replacing
from litsim_sim.record.run import Run

GROUND, ROAD, PAINT, INK = "#eceeea", "#cfd3d8", "#ffffff", "#2b3038"
SIZE_PX, DPI = (1280, 480), 100
AROUND = 60.0  # [m] length of road ahead of the ego and behind it
POINTS_PER_INCH = 72.0

Pose = tuple[FloatArray, float]
"""Centre (2,) of the picture in frame map [m], and the heading that points to its right [rad]."""


def write_png(run: Run, step: int, path: Path) -> None:
    """Draws one step of a run as a PNG of 1280 x 480 px; the road lies across the picture, driving to the right.

    Raises:
        InputError: the run has no such step, or `path` cannot be written.
    """
    tracks, ghosts = tracks_of(run), ghosts_of(run)
    frame = step - tracks.first
    if not 0 <= frame < tracks.frames:
        last = tracks.first + tracks.frames - 1
        raise InputError(f"{run.path}: step {step} is not in the run: its steps are {tracks.first} to {last}")
    figure = Figure(figsize=(SIZE_PX[0] / DPI, SIZE_PX[1] / DPI), dpi=DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    half_height = AROUND * SIZE_PX[1] / SIZE_PX[0]
    axes.set(xlim=(-AROUND, AROUND), ylim=(-half_height, half_height), facecolor=GROUND, xticks=(), yticks=())
    axes.spines[:].set_visible(False)
    pose = _pose(tracks, run.info.ego_id, frame)
    _draw_road(axes, run, tracks, pose)
    _draw_agents(axes, tracks, frame, pose)
    _draw_ghosts(axes, tracks, ghosts, frame, pose)
    time = f"{run.info.scenario}, ego {run.info.ego_id}: {step * run.info.dt:.1f} s"
    axes.text(0.99, 0.96, time, transform=axes.transAxes, ha="right", va="top", fontsize=13, color=INK)
    shown = [(colour, name) for mode, (colour, name) in COLOURS.items() if (tracks.mode == mode).any()]
    handles = [Patch(facecolor=colour, edgecolor=INK, label=name) for colour, name in shown]
    handles.append(Patch(facecolor="none", edgecolor=INK, linestyle="--", label="where the log has it"))
    axes.legend(handles=handles, loc="upper left", ncols=len(handles), fontsize=10, framealpha=0.9, edgecolor="none")
    with replacing(path) as new:
        figure.savefig(new, dpi=DPI, format="png")


def _pose(tracks: Tracks, ego: int, frame: int) -> Pose:
    """Returns where the ego is, or was last, and the heading of its way over the whole run.

    Without an ego these are the middle of the traffic and 0.
    """
    row = tracks.row(ego)
    if row < 0:
        here = tracks.present[:, frame]
        return np.array([np.median(v[here, frame]) if here.any() else 0.0 for v in (tracks.x, tracks.y)]), 0.0
    dx, dy = tracks.x[row, -1] - tracks.x[row, 0], tracks.y[row, -1] - tracks.y[row, 0]
    heading = np.arctan2(dy, dx) if np.hypot(dx, dy) > 5.0 else tracks.yaw[row, 0]
    return np.array([tracks.x[row, frame], tracks.y[row, frame]]), float(heading)


def _view(points: FloatArray, pose: Pose) -> FloatArray:
    """Returns points (..., 2) in frame map as they are in the picture [m]."""
    (x, y), heading = pose
    return np.stack(to_body(points[..., 0] - x, points[..., 1] - y, np.asarray(heading)), axis=-1)


def _draw_road(axes: Axes, run: Run, tracks: Tracks, pose: Pose) -> None:
    """Draws the surface and the paint of the road."""
    points_per_metre = SIZE_PX[0] / (2.0 * AROUND) * POINTS_PER_INCH / DPI
    content = road(run, tracks)
    lanes, lines = ([_view(np.reshape(e["line"], (-1, 2)), pose) for e in content[kind]] for kind in ("lanes", "lines"))
    widths = [lane["width"] * points_per_metre for lane in content["lanes"]]
    dashes = [(0, (6, 10)) if line["dashed"] else "solid" for line in content["lines"]]
    for collection in (
        LineCollection(lanes, colors=ROAD, linewidths=widths, capstyle="butt", zorder=1),
        LineCollection(lines, colors=PAINT, linewidths=1.2, linestyles=dashes, zorder=2),
    ):
        axes.add_collection(collection, autolim=False)


def _draw_agents(axes: Axes, tracks: Tracks, frame: int, pose: Pose) -> None:
    """Draws vehicles as boxes with a bold front, pedestrians and cyclists as ellipses."""
    here = tracks.present[:, frame]
    boxes = _view(_corners(tracks, here, frame), pose)
    colours = np.array([COLOURS[Mode(m)][0] for m in tracks.mode[here, frame]], object)
    driving = ~is_obstacle(tracks.kind[here])
    edge = {"edgecolors": INK, "linewidths": 0.8}
    axes.add_collection(PolyCollection(list(boxes[driving]), facecolors=colours[driving], zorder=4, **edge))
    ellipses = [_ellipse(box) for box in boxes[~driving]]
    axes.add_collection(PolyCollection(ellipses, facecolors=colours[~driving], zorder=5, **edge))
    axes.add_collection(LineCollection(list(boxes[driving][:, [0, 3]]), colors=INK, linewidths=2.0, zorder=5))


def _draw_ghosts(axes: Axes, tracks: Tracks, ghosts: Tracks, frame: int, pose: Pose) -> None:
    """Draws outlines where the log has the agents that are off it."""
    mode = tracks.mode[np.array([tracks.row(agent) for agent in ghosts.id.tolist()], np.int64), frame]
    off_log = ghosts.present[:, frame] & (mode != Mode.LOG) & (mode != Mode.ABSENT)
    boxes = _view(_corners(ghosts, off_log, frame), pose)
    colours = [COLOURS[Mode(m)][0] for m in mode[off_log]]
    dashed = {"facecolors": "none", "linestyles": [(0, (3, 2))], "linewidths": 1.2}
    axes.add_collection(PolyCollection(list(boxes), edgecolors=colours, zorder=6, **dashed))


def _ellipse(box: FloatArray) -> FloatArray:
    """Returns points (m, 2) of the ellipse inside a box of corners (4, 2)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)[:, None]
    long, wide = 0.5 * (box[0] - box[1]), 0.5 * (box[1] - box[2])
    return np.asarray(box.mean(axis=0) + np.cos(turn) * long + np.sin(turn) * wide, np.float64)


def _corners(tracks: Tracks, rows: BoolArray, frame: int) -> FloatArray:
    pose = (tracks.x[rows, frame], tracks.y[rows, frame], tracks.yaw[rows, frame])
    return box_corners(*pose, tracks.length[rows], tracks.width[rows])
