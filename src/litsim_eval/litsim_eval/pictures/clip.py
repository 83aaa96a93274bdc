"""Clips: the road around the ego as a moving picture, of one run or of several, one below the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from tqdm import tqdm

from litsim_eval.analysis.collision import collisions
from litsim_eval.analysis.takeover import ledger
from litsim_eval.pictures.bird_view import AHEAD, BEHIND, COLOURS, View, boxes_of, draw_traffic, legend_handles
from litsim_eval.pictures.overview import notable_moment
from litsim_sim.core.colours import CONFLICT, INK
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

SUFFIXES = (".webp", ".gif", ".png")  # that Pillow writes as moving pictures
BEFORE_S, AFTER_S = 5.0, 9.0  # [s] around the telling moment
EVERY_S, SHOWN_MS = 0.2, 100  # a picture of every [s] is shown for [ms]: at twice the speed
WIDTH_IN, DPI = 10.0, 100
TITLE_IN, LEGEND_IN = 0.3, 0.45  # [inch] of height above each run, and below all


@dataclass(frozen=True)
class Strip:
    """A run in a clip: its lanes, and the agents that touch others, as (step from which on, ids)."""

    run: Run
    lane_map: LaneMap | None
    touching: tuple[tuple[int, frozenset[int]], ...]

    @classmethod
    def of(cls, run: Run) -> Strip:
        """Returns a run with what is drawn of it."""
        excess = run.once(collisions).excess
        return cls(run, lane_map_of(run), tuple((step, frozenset(pair)) for pair, step in excess.items()))

    def height_in(self, time_s: float) -> float:
        """Returns the height [inch] at which the road at `time_s` [s] fills the width."""
        axes = Figure().add_subplot()
        self.draw(axes, time_s)
        low, high = axes.get_ylim()
        return WIDTH_IN * (high - low) / (AHEAD + BEHIND)

    def draw(self, axes: Axes, time_s: float) -> None:
        """Draws the step at `time_s` [s]; agents that have run into others keep a thick edge."""
        index = int(np.argmin(np.abs(self.run.steps.step * self.run.info.dt - time_s)))
        table = self.run.tables[index]
        hit = {agent for first, pair in self.touching if first <= table.step for agent in pair}
        view = View.of_ego(table, self.run.info.ego_id, self.lane_map)
        draw_traffic(axes, view, table, self.lane_map)
        boxes = list(view.seen(boxes_of(table.take(np.isin(table.id, list(hit))))))
        axes.add_collection(PolyCollection(boxes, edgecolors=CONFLICT, facecolors="none", linewidths=2.6, zorder=8))
        axes.set_axis_off()
        name = self.run.info.policy + (f": {len(hit)} vehicles in contacts that are not in the log" if hit else "")
        title = {"fontsize": 11, "color": CONFLICT if hit else INK, "va": "bottom"}
        axes.text(0.005, 1.02, name, transform=axes.transAxes, **title)


def write_clip(runs: Sequence[Run], path: Path) -> None:
    """Writes a moving picture of `runs`, one below the other, around the telling moment of the last one.

    Raises:
        InputError: the file's name ends in none of SUFFIXES, or a net that is attached is no SUMO net.
        OSError: `path` cannot be written.
    """
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}")
    strips, last = [Strip.of(run) for run in runs], runs[-1]
    moment = notable_moment(last, last.once(ledger)).step * last.info.dt
    end = min(run.tables[-1].step * run.info.dt for run in runs)
    times = np.arange(max(0.0, moment - BEFORE_S), min(end, moment + AFTER_S), EVERY_S)
    first, *others = tqdm(_frames(strips, times), total=len(times), unit="picture", disable=None)
    options: dict[str, Any] = {"quality": 70, "method": 2} if path.suffix == ".webp" else {}
    with replacing(path) as new:
        first.save(
            new, format=path.suffix[1:], save_all=True, append_images=others, duration=SHOWN_MS, loop=0, **options
        )


def _frames(strips: Sequence[Strip], times: np.ndarray) -> Iterator[Image.Image]:
    """Yields a picture of all runs at each of `times` [s]."""
    height = [strip.height_in(float(times[0])) for strip in strips]
    whole = sum(height) + TITLE_IN * len(strips) + LEGEND_IN
    figure = Figure(figsize=(WIDTH_IN, whole), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    for time_s in times.tolist():
        figure.clear()
        top = whole
        for strip, high in zip(strips, height, strict=True):
            top -= TITLE_IN + high
            strip.draw(figure.add_axes((0.0, top / whole, 1.0, high / whole)), time_s)
        figure.legend(handles=legend_handles(COLOURS), loc="lower left", ncols=3, frameon=False, fontsize=10)
        figure.text(0.995, 0.1 / whole, f"{time_s:.1f} s", ha="right", fontsize=10, color=INK)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
