"""Rasters for SimNet: the road and the last half second of all agents, drawn around each driven agent.

After Bergamini et al. 2021: each agent is at [0.25, 0.5] of its own raster and heads along its first axis; one call
draws all agents of a step. Boxes have soft edges, so that a raster resolves positions within a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from litsim_policy.motion.stop_lines import IS_AMBER, IS_RED
from litsim_predictor.inference.raster import TURNS, DrawnNet
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.kernels.compiled import (
    Bools2,
    Bytes2,
    Floats,
    Floats2,
    Floats3,
    Ints,
    OutSingles2,
    OutSingles3,
    float32,
    int64,
    kernel,
    written_array,
)
from litsim_sim.scenario.signals import LinkSignals

Rasters = npt.NDArray[np.float32]

FRAMES = 6
"""Number of steps that are drawn, the present one last: half a second of history."""
CLOSENESS, COSINE, SINE, STOP, OWN = 0, 1, 2, 3, 4
OTHERS = OWN + FRAMES
CHANNELS = OTHERS + FRAMES
"""Closeness to a lane's centre line, cosine and sine of its direction, stop lines; the agent, then others, by frame.

All are within [-1, 1], and 0 where there is nothing.
"""
FROM_BEHIND, FROM_RIGHT = 0.25, 0.5
"""Position of the agent, as shares of the raster's length and width."""
STOP_DEPTH = 1.0  # [m] extent of a stop line along the lane

OutSingles4 = Annotated[npt.NDArray[np.float32], written_array(float32, 4)]
COSINES, SINES = np.cos(TURNS).astype(np.float32), np.sin(TURNS).astype(np.float32)


@dataclass(frozen=True)
class RasterShape:
    """The size of a raster.

    Attributes:
        rows: cells along the agent's heading.
        columns: cells across.
        cell: side of a cell [m].
    """

    rows: int
    columns: int
    cell: float


SMALL = RasterShape(96, 48, 1.0)


class Motions(NamedTuple):
    """The last FRAMES steps of n agents, the present one last.

    Attributes:
        pose: (n, FRAMES, 3) box centre x, y [m] and yaw [rad]; arbitrary if the agent was not on the road.
        there: (n, FRAMES) whether the agent was on the road.
        size: (n, 2) length and width [m].
        scene: (n,) scene; only agents of one scene are drawn together.
    """

    pose: Floats3
    there: Bools2
    size: Floats2
    scene: Ints


class RoadImage(NamedTuple):
    """The road as in :class:`DrawnNet`."""

    closeness: Bytes2
    angle: Bytes2


class Painter:
    """Draws rasters on one net.

    Args:
        net: as drawn.
        signals: on it; None for none.
    """

    def __init__(self, net: DrawnNet, signals: LinkSignals | None) -> None:
        self._road, self._signals = RoadImage(net.closeness, net.angle), signals
        self._sizes = np.array([*net.origin, net.cell, SMALL.cell])
        links = () if signals is None else signals.links
        lines = [(*link.stop, link.heading, link.width) for link in links]
        self._lines: FloatArray = np.array(lines, np.float64).reshape(-1, 4)
        self._rasters: Rasters = np.empty((0, CHANNELS, SMALL.rows, SMALL.columns), np.float32)

    def draw(self, step: int, everybody: Motions, rows: IntArray, own: FloatArray | None = None) -> Rasters:
        """Returns rasters (m, CHANNELS, rows, columns) of the agents in `rows` (m,) of `everybody` at `step`.

        They overwrite those of the previous call, since allocating memory costs more than drawing.

        Args:
            step: of the signals.
            everybody: all agents at that step.
            rows: in any order.
            own: (m, FRAMES, 3) assumed poses of these agents, the last of which is the origin of the raster; None for
                their actual ones.
        """
        if len(rows) > len(self._rasters):
            self._rasters = np.empty((len(rows), *self._rasters.shape[1:]), np.float32)
        rasters = self._rasters[: len(rows)]
        rasters[:] = 0.0
        own = everybody.pose[rows] if own is None else own
        pose, there, size, scene = everybody
        motions = Motions(np.ascontiguousarray(pose), np.ascontiguousarray(there), size, scene)
        lines, line_scene = self._closed_lines(step)
        own = np.ascontiguousarray(own)
        draw_rasters(own, rows, motions, lines, line_scene, self._road, self._sizes, rasters)
        return rasters

    def _closed_lines(self, step: int) -> tuple[FloatArray, IntArray]:
        """Returns the stop lines at which agents must stop.

        Returns:
            centre [m], heading [rad] and width [m] of each (k, 4), and its scene (k,).
        """
        if self._signals is None:
            return self._lines, np.empty(0, np.int64)
        scene, link = (IS_RED | IS_AMBER)[self._signals.of_links(step)].nonzero()
        return self._lines[link], scene


@kernel
def draw_box(
    plane: OutSingles2, ahead: float, left: float, cos: float, sin: float, half_length: float, half_width: float
) -> None:
    """Draw a box into a channel of a raster (rows, columns), where it covers more than the present value.

    Args:
        plane: written to.
        ahead, left: of the box centre, from the raster's corner, in cells.
        cos, sin: of its heading, relative to the raster's.
        half_length, half_width: in cells.
    """
    rows, columns = plane.shape
    reach_ahead = abs(cos) * half_length + abs(sin) * half_width + 1.0
    reach_left = abs(sin) * half_length + abs(cos) * half_width + 1.0
    if not (-reach_ahead < ahead < rows + reach_ahead and -reach_left < left < columns + reach_left):
        return
    first_row, last_row = max(0, math.floor(ahead - reach_ahead)), min(rows - 1, math.floor(ahead + reach_ahead))
    first, last = max(0, math.floor(left - reach_left)), min(columns - 1, math.floor(left + reach_left))
    for r in range(first_row, last_row + 1):
        for c in range(first, last + 1):
            da, dl = r + 0.5 - ahead, c + 0.5 - left
            along = min(max(half_length + 0.5 - abs(da * cos + dl * sin), 0.0), 1.0)
            across = min(max(half_width + 0.5 - abs(dl * cos - da * sin), 0.0), 1.0)
            plane[r, c] = max(plane[r, c], float32(along * across))


@kernel
def draw_road(raster: OutSingles3, x: float, y: float, cos: float, sin: float, cell: float, road: RoadImage) -> None:
    """Draw the road into a raster (CHANNELS, rows, columns).

    Args:
        raster: written to.
        x, y: its corner behind and to the right, from that of the net, in cells of the net.
        cos, sin: of its heading.
        cell: its cells, in those of the net.
        road: of the net.
    """
    closeness, angle = road
    last_row, last_column = closeness.shape[0] - 2, closeness.shape[1] - 2
    turn_cos, turn_sin = float32(cos), float32(sin)
    for r in range(raster.shape[1]):
        for c in range(raster.shape[2]):
            ahead, left = (r + 0.5) * cell, (c + 0.5) * cell
            at_x, at_y = x + cos * ahead - sin * left, y + sin * ahead + cos * left
            if not (0.5 <= at_x < last_column + 0.5 and 0.5 <= at_y < last_row + 0.5):
                continue
            column, row = int64(at_x - 0.5), int64(at_y - 0.5)
            u, v = float32(at_x - 0.5 - column), float32(at_y - 0.5 - row)
            below = (float32(1.0) - u) * float32(closeness[row, column]) + u * float32(closeness[row, column + 1])
            above = (float32(1.0) - u) * float32(closeness[row + 1, column]) + u * float32(
                closeness[row + 1, column + 1]
            )
            raster[CLOSENESS, r, c] = ((float32(1.0) - v) * below + v * above) / float32(255.0)
            near_row, near_column = int64(at_y), int64(at_x)
            if closeness[near_row, near_column] > 0:
                lane = angle[near_row, near_column]
                raster[COSINE, r, c] = COSINES[lane] * turn_cos + SINES[lane] * turn_sin
                raster[SINE, r, c] = SINES[lane] * turn_cos - COSINES[lane] * turn_sin


@kernel
def draw_rasters(
    own: Floats3,
    rows: Ints,
    motions: Motions,
    lines: Floats2,
    line_scene: Ints,
    road: RoadImage,
    sizes: Floats,
    rasters: OutSingles4,
) -> None:
    """Draw into `rasters` (m, CHANNELS, rows, columns), which are empty; see :meth:`Painter.draw`.

    Args:
        own, rows: as there.
        motions: of all agents.
        lines, line_scene: from :meth:`Painter._closed_lines`.
        road: of the net.
        sizes: the net's origin x and y [m], its cells and those of the rasters [m].
        rasters: written to.
    """
    pose, there, size, scene = motions
    cell = sizes[3]
    origin_ahead, origin_left = FROM_BEHIND * rasters.shape[2], FROM_RIGHT * rasters.shape[3]
    for i in range(len(rows)):
        raster, x, y, yaw = rasters[i], own[i, FRAMES - 1, 0], own[i, FRAMES - 1, 1], own[i, FRAMES - 1, 2]
        cos, sin = math.cos(yaw), math.sin(yaw)
        corner_x = x - (cos * origin_ahead - sin * origin_left) * cell
        corner_y = y - (sin * origin_ahead + cos * origin_left) * cell
        draw_road(
            raster,
            (corner_x - sizes[0]) / sizes[2],
            (corner_y - sizes[1]) / sizes[2],
            cos,
            sin,
            cell / sizes[2],
            road,
        )
        for k in range(len(lines)):
            if line_scene[k] != scene[rows[i]]:
                continue
            dx, dy = lines[k, 0] - x, lines[k, 1] - y
            draw_box(
                raster[STOP],
                origin_ahead + (cos * dx + sin * dy) / cell,
                origin_left + (cos * dy - sin * dx) / cell,
                math.cos(lines[k, 2] - yaw),
                math.sin(lines[k, 2] - yaw),
                0.5 * STOP_DEPTH / cell,
                0.5 * lines[k, 3] / cell,
            )
        for j in range(len(pose)):
            if scene[j] != scene[rows[i]]:
                continue
            mine = j == rows[i]
            for f in range(FRAMES):
                if there[j, f]:
                    box = own[i, f] if mine else pose[j, f]
                    dx, dy = box[0] - x, box[1] - y
                    draw_box(
                        raster[(OWN if mine else OTHERS) + f],
                        origin_ahead + (cos * dx + sin * dy) / cell,
                        origin_left + (cos * dy - sin * dx) / cell,
                        math.cos(box[2] - yaw),
                        math.sin(box[2] - yaw),
                        0.5 * size[j, 0] / cell,
                        0.5 * size[j, 1] / cell,
                    )
