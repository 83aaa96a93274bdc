"""The map as a raster: drawn once per net, then cut out around each agent by sampling.

The raster has four channels of bytes: drivable (0 or 255), closeness to the lane's centre line (255 on it, 1 at its
border, 0 off the road), and cosine and sine of the lane's direction (-1..1 as 1..255; 128 off the road). Directions
are kept to 1.4 degrees, a 256th of a turn.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from litsim_sim.core.scene import ByteArray, FloatArray
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.maps.net_lanes import Lane

CHANNELS = 4
ROWS, COLUMNS = 24, 24
AHEAD = np.arange(ROWS) * 4.0 - 18.0
"""(ROWS,) [m] ahead of the agent: a row every 4 m, from 18 m behind to 74 m ahead."""
LEFT = np.arange(COLUMNS) * 1.0 - 11.5
"""(COLUMNS,) [m] to the left of the agent: a column every metre, three lanes to each side."""
CELL = 0.5  # [m] of the drawn net
MOST_CELLS = 16_000_000  # beyond, cells are made larger: a net of 2 km by 2 km at 0.5 m
MARGIN = 6.0  # [m] around the centre lines
NO_DIRECTION = np.uint16(256)  # where there is no road: after the 256ths of a turn
TURNS = np.arange(256) * (2 * np.pi / 256)
COSINES = np.append(np.rint(128.0 + 127.0 * np.cos(TURNS)), 128.0).astype(np.uint8)
SINES = np.append(np.rint(128.0 + 127.0 * np.sin(TURNS)), 128.0).astype(np.uint8)


class MapRaster:
    """A net drawn cell by cell.

    Args:
        lane_map: the net; None for no map, of which every cut-out is empty.
    """

    def __init__(self, lane_map: LaneMap | None) -> None:
        self._cell = CELL
        self._origin = (0.0, 0.0)
        # One more row and column than the net needs: empty, where everything outside of it is looked up.
        self._closeness = np.zeros((2, 2), np.uint8)
        self._angle = np.zeros((2, 2), np.uint8)
        if lane_map is not None:
            self._draw(lane_map)

    def cut(self, x: FloatArray, y: FloatArray, heading: FloatArray) -> ByteArray:
        """(n, CHANNELS, ROWS, COLUMNS) around poses (n,) [m, rad]; directions are relative to `heading`."""
        # In cells, and in single precision, which is enough for an index.
        cos, sin = np.cos(heading)[:, None, None] / self._cell, np.sin(heading)[:, None, None] / self._cell
        x0, y0 = ((v[:, None, None] - origin) / self._cell for v, origin in zip((x, y), self._origin, strict=True))
        column = ((x0 + cos * AHEAD[:, None]) - sin * LEFT).astype(np.float32)
        row = ((y0 + sin * AHEAD[:, None]) + cos * LEFT).astype(np.float32)
        rows, columns = self._closeness.shape
        # What is off the net falls into the last row or column, or into those before the first, which are the last.
        at = np.clip(np.floor(row, out=row), -1.0, rows - 1, out=row).astype(np.int32)
        at *= columns
        at += np.clip(np.floor(column, out=column), -1.0, columns - 1, out=column).astype(np.int32)
        closeness = self._closeness.ravel()[at]
        turned = self._angle.ravel()[at] - _angle_byte(heading)[:, None, None]  # bytes wrap as angles do
        road = closeness > 0
        cut = np.empty((len(x), CHANNELS, ROWS, COLUMNS), np.uint8)
        np.multiply(road, np.uint8(255), out=cut[:, 0])
        cut[:, 1] = closeness
        turned = np.where(road, turned, NO_DIRECTION)
        np.take(COSINES, turned, out=cut[:, 2])
        np.take(SINES, turned, out=cut[:, 3])
        return cut

    def _draw(self, lane_map: LaneMap) -> None:
        x_min, y_min, x_max, y_max = lane_map.bounds
        width, height = x_max - x_min + 2 * MARGIN, y_max - y_min + 2 * MARGIN
        while width * height / self._cell**2 > MOST_CELLS:
            self._cell *= 2.0
        self._origin = (x_min - MARGIN, y_min - MARGIN)
        shape = int(np.ceil(height / self._cell)) + 1, int(np.ceil(width / self._cell)) + 1
        self._closeness = np.zeros(shape, np.uint8)
        self._angle = np.zeros(shape, np.uint8)
        for lane in lane_map.lanes:
            for start, end in zip(lane.centerline[:-1], lane.centerline[1:], strict=True):
                self._draw_segment(lane, start, end)

    def _draw_segment(self, lane: Lane, start: FloatArray, end: FloatArray) -> None:
        """Draw one straight piece of a lane where it is closer than what is drawn already."""
        half = 0.5 * lane.width
        low = np.minimum(start, end) - half - self._origin
        high = np.maximum(start, end) + half - self._origin
        last_row, last_column = self._closeness.shape[0] - 1, self._closeness.shape[1] - 1
        columns = np.arange(max(int(low[0] / self._cell), 0), min(int(high[0] / self._cell) + 1, last_column))
        rows = np.arange(max(int(low[1] / self._cell), 0), min(int(high[1] / self._cell) + 1, last_row))
        dx = self._origin[0] + (columns[None, :] + 0.5) * self._cell - start[0]
        dy = self._origin[1] + (rows[:, None] + 0.5) * self._cell - start[1]
        size = float(np.hypot(*(end - start)))
        along_x, along_y = (end - start) / size
        along, across = dx * along_x + dy * along_y, dy * along_x - dx * along_y
        distance = np.hypot(np.maximum(np.maximum(-along, along - size), 0.0), across)
        closeness = np.rint(1.0 + 254.0 * np.maximum(1.0 - distance / half, 0.0)).astype(np.uint8)
        window = np.ix_(rows, columns)
        closer = (distance <= half) & (closeness > self._closeness[window])
        self._closeness[window] = np.where(closer, closeness, self._closeness[window])
        angle = _angle_byte(np.arctan2(along_y, along_x))
        self._angle[window] = np.where(closer, angle, self._angle[window])


def _angle_byte(angle: FloatArray) -> ByteArray:
    """Angles [rad] as bytes, in 256ths of a turn; any shape."""
    return np.mod(np.rint(np.asarray(angle) * (256 / (2 * np.pi))), 256).astype(np.uint8)


@lru_cache(maxsize=4)
def raster_of_net(path: Path) -> tuple[LaneMap, MapRaster]:
    """The lanes and the raster of the net at `path`, drawn once per process.

    Raises:
        InputError: see :meth:`LaneMap.from_net`.
    """
    lane_map = LaneMap.from_net(path)
    return lane_map, MapRaster(lane_map)
