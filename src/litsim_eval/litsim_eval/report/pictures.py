"""A scene of a run as a PNG: the bird's-eye view around the ego."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

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


class Stage:
    """A bird's-eye view of one step of a run; the road lies across the picture, driving to the right."""

    def __init__(self, run: Run) -> None:
        self._tracks, self._ghosts, self._run = tracks_of(run), ghosts_of(run), run
        self._rotation = self._direction()
        self.figure = Figure(figsize=(SIZE_PX[0] / DPI, SIZE_PX[1] / DPI), dpi=DPI)
        self._axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        half_height = AROUND * SIZE_PX[1] / SIZE_PX[0]
        self._axes.set(xlim=(-AROUND, AROUND), ylim=(-half_height, half_height), facecolor=GROUND, xticks=(), yticks=())
        self._axes.spines[:].set_visible(False)
        self._surface, self._paint = _draw_road(self._axes, road(run, self._tracks))
        edge = {"edgecolors": INK, "linewidths": 0.8}
        self._boxes = self._axes.add_collection(PolyCollection([], zorder=4, **edge))
        self._walking = self._axes.add_collection(PolyCollection([], zorder=5, **edge))
        self._fronts = self._axes.add_collection(LineCollection([], colors=INK, linewidths=2.0, zorder=5))
        dashed = {"facecolors": "none", "linestyles": [(0, (3, 2))], "linewidths": 1.2}
        self._outlines = self._axes.add_collection(PolyCollection([], zorder=6, **dashed))
        at = {"transform": self._axes.transAxes, "ha": "right", "va": "top", "fontsize": 13, "color": INK}
        self._clock = self._axes.text(0.99, 0.96, "", **at)
        handles = [
            Patch(facecolor=c, edgecolor=INK, label=n)
            for mode, (c, n) in COLOURS.items()
            if (self._tracks.mode == mode).any()
        ]
        handles.append(Patch(facecolor="none", edgecolor=INK, linestyle="--", label="where the log has it"))
        self._axes.legend(
            handles=handles, loc="upper left", ncols=len(handles), fontsize=10, framealpha=0.9, edgecolor="none"
        )

    def show(self, step: int) -> None:
        """Move everything to a step of the run.

        Raises:
            InputError: the run has no such step.
        """
        tracks, frame = self._tracks, step - self._tracks.first
        if not 0 <= frame < tracks.frames:
            last = tracks.first + tracks.frames - 1
            raise InputError(f"{self._run.path}: step {step} is not in the run: its steps are {tracks.first} to {last}")
        centre = self._centre(frame)
        for collection, lines in (self._surface, self._paint):
            collection.set_verts([self._view(line, centre) for line in lines])
        here = tracks.present[:, frame]
        boxes = self._view(_corners(tracks, here, frame), centre)
        colours = np.array([COLOURS[Mode(m)][0] for m in tracks.mode[here, frame]], object)
        driving = ~is_obstacle(tracks.kind[here])
        self._boxes.set(verts=list(boxes[driving]), facecolors=colours[driving])
        self._fronts.set_segments(list(boxes[driving][:, [0, 3]]))
        self._walking.set(verts=[_ellipse(box) for box in boxes[~driving]], facecolors=colours[~driving])
        rows = np.array([tracks.row(agent) for agent in self._ghosts.id.tolist()], np.int64)
        mode = tracks.mode[rows, frame]
        gone = self._ghosts.present[:, frame] & (mode != Mode.LOG) & (mode != Mode.ABSENT)
        ghosts = self._view(_corners(self._ghosts, gone, frame), centre)
        self._outlines.set(verts=list(ghosts), edgecolors=[COLOURS[Mode(m)][0] for m in mode[gone]])
        self._clock.set_text(
            f"{self._run.info.scenario}, ego {self._run.info.ego_id}: {step * self._run.info.dt:.1f} s"
        )

    def _view(self, points: FloatArray, centre: FloatArray) -> FloatArray:
        """Points (..., 2) in frame map as seen from `centre`."""
        seen = to_body(points[..., 0] - centre[0], points[..., 1] - centre[1], np.asarray(self._rotation))
        return np.stack(seen, axis=-1)

    def _centre(self, frame: int) -> FloatArray:
        """Position of the ego, or its last one; without an ego, the middle of the traffic."""
        row, tracks = self._tracks.row(self._run.info.ego_id), self._tracks
        if row >= 0:
            return np.array([tracks.x[row, frame], tracks.y[row, frame]])
        here = tracks.present[:, frame]
        return np.array([np.median(v[here, frame]) if here.any() else 0.0 for v in (tracks.x, tracks.y)])

    def _direction(self) -> float:
        """Heading [rad] that points to the right in the picture: that of the ego's displacement over the run."""
        row, tracks = self._tracks.row(self._run.info.ego_id), self._tracks
        if row < 0:
            return 0.0
        dx, dy = tracks.x[row, -1] - tracks.x[row, 0], tracks.y[row, -1] - tracks.y[row, 0]
        return float(np.arctan2(dy, dx)) if np.hypot(dx, dy) > 5.0 else float(tracks.yaw[row, 0])


def write_png(run: Run, step: int, path: Path) -> None:
    """Draw one step of a run as a PNG of 1280 x 480 px.

    Raises:
        InputError: the run has no such step, or `path` cannot be written.
    """
    stage = Stage(run)
    stage.show(step)
    with replacing(path) as new:
        stage.figure.savefig(new, dpi=DPI, format="png")


_Lines = tuple[LineCollection, Sequence[FloatArray]]


def _draw_road(axes: Axes, content: dict[str, Any]) -> tuple[_Lines, _Lines]:
    """Empty collections for the surface and the paint of the road, with their lines in frame map."""
    points_per_metre = SIZE_PX[0] / (2.0 * AROUND) * POINTS_PER_INCH / DPI
    widths = [lane["width"] * points_per_metre for lane in content["lanes"]]
    surface = LineCollection([], colors=ROAD, linewidths=widths, capstyle="butt", zorder=1)
    dashes = [(0, (6, 10)) if line["dashed"] else "solid" for line in content["lines"]]
    paint = LineCollection([], colors=PAINT, linewidths=1.2, linestyles=dashes, zorder=2)
    for collection in (surface, paint):
        axes.add_collection(collection, autolim=False)
    lines = [[np.reshape(each["line"], (-1, 2)) for each in content[kind]] for kind in ("lanes", "lines")]
    return (surface, lines[0]), (paint, lines[1])


def _ellipse(box: FloatArray) -> FloatArray:
    """Points (m, 2) of the ellipse inside a box of corners (4, 2), for pedestrians and cyclists."""
    turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)[:, None]
    long, wide = 0.5 * (box[0] - box[1]), 0.5 * (box[1] - box[2])
    return np.asarray(box.mean(axis=0) + np.cos(turn) * long + np.sin(turn) * wide, np.float64)


def _corners(tracks: Tracks, rows: BoolArray, frame: int) -> FloatArray:
    pose = (tracks.x[rows, frame], tracks.y[rows, frame], tracks.yaw[rows, frame])
    return box_corners(*pose, tracks.length[rows], tracks.width[rows])
