"""The road around the ego at a step, from above, in a frame whose x axis points along the ego's lane."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Patch

from litsim_sim.core.colours import INK, ROAD, colour_of
from litsim_sim.core.geometry import box_corners, to_body
from litsim_sim.core.scene import AgentTable, Controller, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap

AHEAD, BEHIND, BESIDE = 70.0, 70.0, 40.0  # [m] of road around the ego; to the sides at most
MARGIN, WIDTH_MIN = 1.5, 6.0  # [m] beside the road, and of the view to either side without a road
NAMES = {
    Controller.EGO: "ego",
    Controller.POLICY: "taken over",
    Controller.LOG: "log replay",
}
COLOURS = {controller: colour_of(controller) for controller in NAMES}
PAINT = "#ffffff"


@dataclass(frozen=True)
class View:
    """A frame of view: its origin `x`, `y` [m] in frame map, and the direction `yaw` [rad] of its x axis."""

    x: float
    y: float
    yaw: float

    @classmethod
    def of_ego(cls, table: AgentTable, ego: int, lane_map: LaneMap | None) -> View:
        """Returns the view along the lane of the agent `ego`; around the middle of all agents if it is absent."""
        row = table.row(ego)
        pose = (table.x, table.y, table.yaw)
        x, y, yaw = (float(values[row]) if row >= 0 else float(np.median(values)) for values in pose)
        if lane_map is not None:
            yaw = float(lane_map.nearest(np.array([x]), np.array([y]), np.array([yaw])).heading[0])
        return cls(x, y, yaw)

    def seen(self, points: FloatArray) -> FloatArray:
        """Returns points (..., 2) of frame map in this frame [m]."""
        ahead, left = to_body(points[..., 0] - self.x, points[..., 1] - self.y, np.asarray(self.yaw))
        return np.stack([ahead, left], axis=-1)


def legend_handles(controllers: Iterable[int]) -> list[Patch]:
    """Returns what a legend shows for agents under these controllers."""
    present = set(controllers)
    return [Patch(facecolor=COLOURS[c], edgecolor=INK, label=NAMES[c]) for c in COLOURS if c in present]


def draw_traffic(axes: Axes, view: View, table: AgentTable, lane_map: LaneMap | None) -> None:
    """Draws the lanes and the boxes of `table`, coloured by controller, and limits the axes to them."""
    low, high = _draw_road(axes, lane_map, view) if lane_map is not None else (-2 * WIDTH_MIN, 2 * WIDTH_MIN)
    boxes = view.seen(boxes_of(table))
    colours = [COLOURS[Controller(c)] for c in table.controller]
    axes.add_collection(PolyCollection(list(boxes), edgecolors=INK, facecolors=colours, linewidths=0.7, zorder=4))
    noses = list(boxes[:, [0, 3]])  # front left, front right
    axes.add_collection(LineCollection(noses, colors=INK, linewidths=2.2, zorder=4))
    axes.set(xlim=(-BEHIND, AHEAD), ylim=(low, high), aspect="equal")


def boxes_of(table: AgentTable) -> FloatArray:
    """Returns the corners (n, 4, 2) of the boxes of all agents in frame map [m]."""
    return box_corners(table.x, table.y, table.yaw, table.length, table.width)


def _draw_road(axes: Axes, lane_map: LaneMap, view: View) -> tuple[float, float]:
    """Draws the lanes with painted borders; returns the lower and upper limit of the view's y axis [m]."""
    low, high = -WIDTH_MIN, WIDTH_MIN
    surfaces, borders = _lane_shapes(lane_map)
    window = shapely.box(-BEHIND, -1.5 * BESIDE, AHEAD, 1.5 * BESIDE)
    for surface in surfaces:
        part = shapely.transform(surface, view.seen).intersection(window)
        for polygon in shapely.get_parts(part):
            if polygon.geom_type == "Polygon" and not polygon.is_empty:
                ring = np.asarray(polygon.exterior.coords)
                axes.fill(*ring.T, facecolor=ROAD, edgecolor="none", zorder=0)
                low, high = min(low, ring[:, 1].min()), max(high, ring[:, 1].max())
    painted = [view.seen(border) for border in borders]
    axes.add_collection(LineCollection(painted, colors=PAINT, linewidths=1.3, linestyles=(0, (6, 5)), zorder=1))
    return max(low, -BESIDE) - MARGIN, min(high, BESIDE) + MARGIN


@lru_cache(maxsize=8)
def _lane_shapes(lane_map: LaneMap) -> tuple[list[shapely.Polygon], list[FloatArray]]:
    """Returns the surfaces of all lanes, and their borders, each (m, 2), in frame map [m]."""
    lines = [(shapely.LineString(lane.centerline), lane.width) for lane in lane_map.lanes]
    borders = [line.offset_curve(side * width) for line, width in lines for side in (-0.5, 0.5)]
    whole = [border for border in borders if not border.is_empty and border.geom_type == "LineString"]
    surfaces = [line.buffer(0.5 * width, cap_style="flat") for line, width in lines]
    return surfaces, [np.asarray(border.coords) for border in whole]
