"""The map as a raster: drawn once per net, then cut out around each agent by sampling.

The raster has four channels of bytes: drivable (0 or 255), closeness to the lane's centre line (255 on it, 1 at its
border, 0 off the road), and cosine and sine of the lane's direction (-1..1 as 1..255; 128 off the road). Directions
are kept to 1.4 degrees, a 256th of a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from numba import types

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import ByteArray, FloatArray
from litsim_sim.kernels.compiled import Floats, Ints, float32, int32, int64, kernel, read_array, uint8, written_array
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane

CHANNELS = 4
ROWS, COLUMNS = 24, 24
AHEAD = np.arange(ROWS) * 4.0 - 18.0
"""(ROWS,) [m] ahead of the agent: a row every 4 m, from 18 m behind to 74 m ahead."""
LEFT = np.arange(COLUMNS) * 1.0 - 11.5
"""(COLUMNS,) [m] to the left of the agent: a column every metre, three lanes to each side."""
CELL = 0.5  # [m] side of a cell of the drawn net
MOST_CELLS = 400_000_000  # of a net of 10 km by 10 km; of their 0.8 GB, only the parts with roads take up memory
MOST_AT_ONCE = 1_000_000  # cells around a piece of a lane: longer ones are halved
MARGIN = 6.0  # [m] margin around the centre lines
NO_DIRECTION = 128  # byte of cells off the road
TURNS = np.arange(256) * (2 * np.pi / 256)
COSINES = np.rint(128.0 + 127.0 * np.cos(TURNS)).astype(np.uint8)
SINES = np.rint(128.0 + 127.0 * np.sin(TURNS)).astype(np.uint8)
DIRECTIONS = COSINES.astype(np.int32) | SINES.astype(np.int32) << 8
"""(256,) both in one number, so that they are looked up at once."""
NO_DIRECTIONS = NO_DIRECTION | NO_DIRECTION << 8

Shorts2 = Annotated[npt.NDArray[np.uint16], read_array(types.uint16, 2)]
OutBytes4 = Annotated[npt.NDArray[np.uint8], written_array(uint8, 4)]


@kernel
def cut_out(x: Floats, y: Floats, cos: Floats, sin: Floats, turn: Ints, cells: Shorts2, out: OutBytes4) -> None:
    """Write the rasters around poses to `out` (n, CHANNELS, ROWS, COLUMNS).

    Args:
        x, y: (n,) from the raster's corner, in cells.
        cos, sin: (n,) of a metre ahead, in cells.
        turn: (n,) headings in 256ths of a turn.
        cells: the raster, closeness in the lower byte of a cell and angle in the upper; its last row and column are
            empty: there is all that lies outside of it.
    """
    rows, columns = cells.shape
    drawn, planes = cells.ravel(), out.reshape(len(x), CHANNELS, ROWS * COLUMNS)
    source, cell = np.empty((ROWS, COLUMNS), np.int64), np.empty(ROWS * COLUMNS, np.int32)
    found = source.ravel()
    byte, nowhere = int32(255), int32(NO_DIRECTIONS)
    last_row, last_column = float32(rows - 1), float32(columns - 1)
    for i in range(len(x)):
        for r in range(ROWS):
            ahead_x, ahead_y = x[i] + cos[i] * AHEAD[r], y[i] + sin[i] * AHEAD[r]
            for c in range(COLUMNS):
                # In single precision, which is enough for an index.
                column, row = float32(ahead_x - sin[i] * LEFT[c]), float32(ahead_y + cos[i] * LEFT[c])
                column = column if float32(0.0) <= column < last_column else last_column
                row = row if float32(0.0) <= row < last_row else last_row
                source[r, c] = int64(row) * columns + int64(column)
        for k in range(ROWS * COLUMNS):
            cell[k] = drawn[found[k]]
        # The values looked up are classified in separate loops, so that the processor does many steps at a time.
        on, close, ahead, left = planes[i]
        for k in range(ROWS * COLUMNS):
            close[k] = cell[k] & byte
            on[k] = 255 if close[k] > 0 else 0
        for k in range(ROWS * COLUMNS):
            direction = DIRECTIONS[((cell[k] >> int32(8)) - int32(turn[i])) & byte]  # bytes wrap as angles
            direction = direction if cell[k] & byte > 0 else nowhere
            ahead[k], left[k] = direction & byte, direction >> int32(8)


@dataclass(frozen=True)
class DrawnNet:
    """The raster of a net, for others to cut out of.

    Attributes:
        origin: corner where row and column 0 begin, x and y in frame map [m].
        cell: side of a cell [m].
        closeness: (rows, columns) to the lane's centre line, 255 on it and 0 off the road; the last row and column are
            empty.
        angle: (rows, columns) of the lane, in 256ths of a turn.
    """

    origin: tuple[float, float]
    cell: float
    closeness: ByteArray
    angle: ByteArray


class MapRaster:
    """A net drawn cell by cell.

    Args:
        lane_map: the net; None for no map, whose cut-outs are empty.

    Raises:
        InputError: the net is too large.
    """

    def __init__(self, lane_map: LaneMap | None) -> None:
        self._origin = (0.0, 0.0)
        # One more row and column than the net needs: empty, where everything outside of it is looked up.
        self._cells = np.zeros((2, 2), np.uint16)
        if lane_map is not None:
            self._draw(lane_map)

    @property
    def drawn(self) -> DrawnNet:
        """What is drawn."""
        closeness, angle = self._cells & 255, self._cells >> 8
        return DrawnNet(self._origin, CELL, closeness.astype(np.uint8), angle.astype(np.uint8))

    def cut(self, x: FloatArray, y: FloatArray, heading: FloatArray) -> ByteArray:
        """Rasters (n, CHANNELS, ROWS, COLUMNS) around poses (n,) [m, rad]; directions are relative to `heading`."""
        cos, sin = np.cos(heading) / CELL, np.sin(heading) / CELL
        x, y = (x - self._origin[0]) / CELL, (y - self._origin[1]) / CELL
        cut = np.empty((len(x), CHANNELS, ROWS, COLUMNS), np.uint8)
        cut_out(x, y, cos, sin, _angle_byte(heading).astype(np.int64), self._cells, cut)
        return cut

    def _draw(self, lane_map: LaneMap) -> None:
        x_min, y_min, x_max, y_max = lane_map.bounds
        width, height = x_max - x_min + 2 * MARGIN, y_max - y_min + 2 * MARGIN
        if width * height / CELL**2 > MOST_CELLS:
            raise InputError(
                f"the net covers {width / 1e3:.1f} km by {height / 1e3:.1f} km, expected at most "
                f"{MOST_CELLS * CELL**2 / 1e6:.0f} km2 for a learned predictor, which reads it as a raster; cut it to "
                f"where the traffic is (netconvert --keep-edges.in-boundary), or use --predictor kinematic"
            )
        self._origin = (x_min - MARGIN, y_min - MARGIN)
        shape = int(np.ceil(height / CELL)) + 1, int(np.ceil(width / CELL)) + 1
        self._cells = np.zeros(shape, np.uint16)
        for lane in lane_map.lanes:
            for start, end in zip(lane.centerline[:-1], lane.centerline[1:], strict=True):
                self._draw_segment(lane, start, end)

    def _draw_segment(self, lane: Lane, start: FloatArray, end: FloatArray) -> None:
        """Draw one straight piece of a lane where it is closer than earlier pieces."""
        half = 0.5 * lane.width
        low = np.minimum(start, end) - half - self._origin
        high = np.maximum(start, end) + half - self._origin
        last_row, last_column = self._cells.shape[0] - 1, self._cells.shape[1] - 1
        columns = np.arange(max(int(low[0] / CELL), 0), min(int(high[0] / CELL) + 1, last_column))
        rows = np.arange(max(int(low[1] / CELL), 0), min(int(high[1] / CELL) + 1, last_row))
        if len(rows) * len(columns) > MOST_AT_ONCE:
            middle = 0.5 * (start + end)
            self._draw_segment(lane, start, middle)
            self._draw_segment(lane, middle, end)
            return
        dx = self._origin[0] + (columns[None, :] + 0.5) * CELL - start[0]
        dy = self._origin[1] + (rows[:, None] + 0.5) * CELL - start[1]
        size = float(np.hypot(*(end - start)))
        along_x, along_y = (end - start) / size
        along, across = dx * along_x + dy * along_y, dy * along_x - dx * along_y
        distance = np.hypot(np.maximum(np.maximum(-along, along - size), 0.0), across)
        closeness = np.rint(1.0 + 254.0 * np.maximum(1.0 - distance / half, 0.0)).astype(np.uint16)
        angle = int(_angle_byte(np.arctan2(along_y, along_x)))
        window = np.ix_(rows, columns)
        drawn = self._cells[window]
        closer = (distance <= half) & (closeness > drawn & 255)
        self._cells[window] = np.where(closer, closeness | angle << 8, drawn)


def _angle_byte(angle: FloatArray) -> ByteArray:
    """Returns angles [rad] as bytes, in 256ths of a turn; any shape."""
    return np.mod(np.rint(np.asarray(angle) * (256 / (2 * np.pi))), 256).astype(np.uint8)


@lru_cache(maxsize=4)
def raster_of_net(path: Path) -> tuple[LaneMap, MapRaster]:
    """Returns the lanes and the raster of the net at `path`, drawn once per process.

    Raises:
        InputError: see :meth:`LaneMap.from_net`; or the net is too large.
    """
    lane_map = LaneMap.from_net(path)
    try:
        return lane_map, MapRaster(lane_map)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
