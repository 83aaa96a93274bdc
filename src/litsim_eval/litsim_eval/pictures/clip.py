"""Clips: the road around the ego as a moving picture, of one run or of several, one below the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from tqdm import tqdm

from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.takeover import ledger
from litsim_eval.pictures.bird_view import AHEAD, BEHIND, COLOURS, View, boxes_of, draw_traffic, legend_handles
from litsim_eval.pictures.overview import notable_moment
from litsim_sim.core.colours import CONFLICT, INK
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

SUFFIXES = (".webp", ".gif", ".png")  # that Pillow writes as moving pictures
BEFORE_S, AFTER_S = 5.0, 9.0  # [s] around the telling moment
EVERY_S, SHOWN_MS = 0.2, 100  # a picture of every [s] is shown for [ms]: at twice the speed
WIDTH_IN, DPI = 10.0, 100
TITLE_IN, LEGEND_IN = 0.3, 0.45  # [inch] of height above each run, and below all


def _draw(axes: Axes, run: Run, lane_map: LaneMap | None, time_s: float) -> None:
    """Draws a run at `time_s` [s]; agents that have run into others, unlike in the log, keep a thick edge."""
    table = run.tables[int(np.argmin(np.abs(run.steps.step * run.info.dt - time_s)))]
    hit = {agent for pair, first in run.once(collisions).excess.items() if first <= table.step for agent in pair}
    view = View.of_ego(table, run.info.ego_id, lane_map)
    draw_traffic(axes, view, table, lane_map)
    boxes = list(view.seen(boxes_of(table.take(np.isin(table.id, list(hit))))))
    axes.add_collection(PolyCollection(boxes, edgecolors=CONFLICT, facecolors="none", linewidths=2.6, zorder=8))
    axes.set_axis_off()
    name = run.info.policy + (f": {len(hit)} vehicles in contacts that are not in the log" if hit else "")
    title = {"fontsize": 11, "color": CONFLICT if hit else INK, "va": "bottom"}
    axes.text(0.005, 1.02, name, transform=axes.transAxes, **title)


def _height_in(run: Run, lane_map: LaneMap | None, time_s: float) -> float:
    """Returns the height [inch] at which the road of a run at `time_s` [s] fills the width."""
    axes = Figure().add_subplot()
    _draw(axes, run, lane_map, time_s)
    low, high = axes.get_ylim()
    return WIDTH_IN * (high - low) / (AHEAD + BEHIND)


def write_clip(runs: Sequence[Run], path: Path) -> None:
    """Writes a moving picture of `runs`, one below the other, around the telling moment of the last one.

    Raises:
        InputError: the file's name ends in none of SUFFIXES, or a net that is attached is no SUMO net.
        OSError: `path` cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")
    last = runs[-1]
    moment = notable_moment(last, last.once(ledger)).step * last.info.dt
    end = min(run.tables[-1].step * run.info.dt for run in runs)
    times = np.arange(max(0.0, moment - BEFORE_S), min(end, moment + AFTER_S), EVERY_S)
    first, *others = tqdm(_frames(runs, times), total=len(times), unit="picture", disable=None)
    options: dict[str, Any] = {"quality": 70, "method": 2} if path.suffix == ".webp" else {}
    with replacing(path) as new:
        first.save(
            new, format=path.suffix[1:], save_all=True, append_images=others, duration=SHOWN_MS, loop=0, **options
        )


def _frames(runs: Sequence[Run], times: FloatArray) -> Iterator[Image.Image]:
    """Yields a picture of all runs at each of `times` [s]."""
    lane_maps = [lane_map_of(run) for run in runs]
    height = [_height_in(run, lane_map, float(times[0])) for run, lane_map in zip(runs, lane_maps, strict=True)]
    whole = sum(height) + TITLE_IN * len(runs) + LEGEND_IN
    figure = Figure(figsize=(WIDTH_IN, whole), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for time_s in times.tolist():
        figure.clear()
        top = whole
        for run, lane_map, high in zip(runs, lane_maps, height, strict=True):
            top -= TITLE_IN + high
            _draw(figure.add_axes((0.0, top / whole, 1.0, high / whole)), run, lane_map, time_s)
        figure.legend(handles=legend_handles(COLOURS), loc="lower left", ncols=3, frameon=False, fontsize=10)
        figure.text(0.995, 0.1 / whole, f"{time_s:.1f} s", ha="right", fontsize=10, color=INK)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
