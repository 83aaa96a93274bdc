"""The lanes of one carriageway, fitted to positions with lane numbers.

All lanes share one smooth line; each has an offset from it that stays the same along the road. Line and offsets are
estimated together by penalised least squares with Huber weights, so that lane changers and mislabelled rows count
little. Vehicles are taken to drive in the middle of their lanes.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.sparse import coo_array, hstack

from litsim_data.maps.lane_graph import LaneGraph, Lanelet, extended
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import shift_left
from litsim_sim.core.scene import FloatArray, IntArray

LANE_WIDTH = 3.66  # [m] of a road with one lane: 12 ft
SPEED_LIMIT = 29.0  # [m/s] 65 mph
MARGIN = 120.0  # [m] of road before and after the recorded stretch
GRID = 5.0  # [m] spacing of the fitted line's support points; every other one becomes a vertex
SMOOTHNESS = 1e7  # weight of squared third differences on GRID: bends shorter than about 100 m are smoothed away
HUBER = 0.3  # [m] residuals beyond count linearly
ITERATIONS = 15
CELL = 10.0  # [m] every lane and cell along the road weighs the same, however many vehicles queued there
END_TANGENT = 3  # segments over which the direction of the margin is taken
ROWS_MIN = 100  # of a lane
LANE_SHARE_MIN = 0.02  # of the rows of the busiest lane: lanes with fewer are ramps or mistakes
TURN_MAX = np.deg2rad(60.0)  # a carriageway that turns further cannot be described along one axis


def fit_carriageway(table: pd.DataFrame) -> LaneGraph:
    """Returns the lanes of a carriageway that are numbered from 1 at the left.

    Args:
        table: columns x, y [m], yaw [rad] and lane.

    Raises:
        InputError: too few rows, or the headings show more than one carriageway or a road that turns too far.
    """
    labelled = table[table["lane"] >= 1]
    counts = labelled["lane"].value_counts()
    if labelled.empty:
        raise InputError("cannot fit lanes: the recording has no lane numbers (column lane is -1 or 0 throughout)")
    lanes = 0
    while counts.get(lanes + 1, 0) >= max(LANE_SHARE_MIN * counts.max(), ROWS_MIN):
        lanes += 1
    if lanes == 0:
        raise InputError(f"cannot fit lanes: rows by lane are {counts.to_dict()}, expected {ROWS_MIN} in lane 1")
    yaw = labelled["yaw"].to_numpy(np.float64)
    main = float(np.arctan2(np.mean(np.sin(yaw)), np.mean(np.cos(yaw))))
    if np.quantile(np.abs(np.angle(np.exp(1j * (yaw - main)))), 0.98) > TURN_MAX:
        raise InputError(
            "cannot fit lanes: headings differ by more than 60 degrees; give the rows of one carriageway that does "
            "not turn further"
        )
    turn = np.array([[np.cos(main), -np.sin(main)], [np.sin(main), np.cos(main)]])
    through = labelled[labelled["lane"] <= lanes]
    x, y = (through[["x", "y"]].to_numpy(np.float64) @ turn).T
    line, offsets = _fit_lanes(x, y, through["lane"].to_numpy(np.int64))
    edges = np.cumsum([-0.5 * _widths(offsets)[0], *_widths(offsets)])  # to the right of the line
    bounds = [shift_left(extended(line[::2], MARGIN, END_TANGENT), -edge) @ turn.T for edge in edges]
    names = [None, *(f"lane_{number}" for number in range(1, lanes + 1)), None]
    return LaneGraph(
        tuple(
            Lanelet(
                id=f"lane_{number}",
                left=bounds[number - 1],
                right=bounds[number],
                left_id=names[number - 1],
                right_id=names[number + 1],
                speed_limit=SPEED_LIMIT,
            )
            for number in range(1, lanes + 1)
        )
    )


def _fit_lanes(x: FloatArray, y: FloatArray, lane: IntArray) -> tuple[FloatArray, FloatArray]:
    """Fits parallel lanes to positions (n,) [m] on a road that runs roughly along +x, by their lanes (n,) from 1.

    Returns:
        The centre line (m, 2) of lane 1, at every GRID of x, and how far right of it each lane runs (k,) [m].
    """
    beside = (lane[:, None] == np.arange(2, lane.max() + 1)).astype(np.float64)
    _, which, rows = np.unique(
        lane * 1_000_000 + np.floor(x / CELL).astype(np.int64), return_inverse=True, return_counts=True
    )
    even = len(x) / len(rows) / rows[which]
    start = float(np.floor(x.min() / GRID) * GRID)
    count = int(np.ceil((x.max() - start) / GRID)) + 1
    grid: FloatArray = start + GRID * np.arange(count, dtype=np.float64)
    cell = np.clip(((x - start) / GRID).astype(np.int64), 0, count - 2)
    part = (x - grid[cell]) / GRID
    third = np.diff(np.eye(count), 3, axis=0)
    size = count + beside.shape[1]
    smooth = np.zeros((size, size))
    smooth[:count, :count] = SMOOTHNESS * third.T @ third
    row = np.arange(len(x))
    hats = coo_array((np.r_[1.0 - part, part], (np.r_[row, row], np.r_[cell, cell + 1])), shape=(len(x), count))
    weight, stretch = even, np.ones(len(x))  # `stretch` turns metres across the road into metres of y
    for _ in range(ITERATIONS):
        design = hstack([hats, coo_array(-beside * stretch[:, None])], format="csr")
        weighted = design.multiply(weight[:, None]).T
        solution: FloatArray = np.linalg.solve(smooth + (weighted @ design).toarray(), weighted @ y)
        line = solution[:count]
        weight = even / np.maximum(1.0, np.abs(design @ solution - y) / HUBER)
        stretch = np.sqrt(1.0 + np.interp(x, grid, np.gradient(line, GRID)) ** 2)
    return np.column_stack([grid, line]), np.concatenate([[0.0], solution[count:]])


def _widths(offsets: FloatArray) -> FloatArray:
    """Returns widths (k,) of lanes side by side from their centres' offsets (k,): as equal as the offsets allow."""
    if len(offsets) == 1:
        return np.array([LANE_WIDTH])
    apart = np.diff(offsets)
    mean = float(apart.mean())
    halves = 0.5 * (np.eye(len(offsets))[:-1] + np.eye(len(offsets))[1:])
    # Of all widths that give these distances, least squares takes those nearest to the mean.
    return mean + np.asarray(np.linalg.lstsq(halves, apart - mean)[0], np.float64)
