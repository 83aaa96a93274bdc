"""Lane geometry of a real motorway section, fitted to the tracks that were recorded on it.

All through lanes share one smooth centre line and one lane width; both are estimated together from box centres and
their lane labels, by penalised least squares with Huber weights, so that lane changers and mislabelled rows count
little. Nothing but the resulting geometry leaves this module.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_sim.errors import InputError
from litsim_sim.maps.highway import VERTEX_SPACING, HighwayPlan, Ramp
from litsim_sim.scene import FloatArray

GRID = 5.0  # [m] spacing of the fitted line's support points
SMOOTHNESS = 1e7  # weight of squared third differences on GRID: bends shorter than about 100 m are smoothed away
HUBER = 0.3  # [m] residuals beyond count linearly
ITERATIONS = 15
CELL = 10.0  # [m] every lane and cell along the road weighs the same, however many vehicles queued there
MARGIN = 120.0  # [m] of straight road added before the first and after the last recorded position
END_TANGENT = 30.0  # [m] over which the direction of that margin is taken
US101_LANES = 5
US101_ON_RAMP_X = 177.0  # [m] in the map frame of datasets.ngsim_windows; 579 ft in the site's description
US101_OFF_RAMP_X = 388.0  # [m] 1277 ft


def fit_us101_plan(table: pd.DataFrame) -> HighwayPlan:
    """The plan of the US-101 section under a recording of it.

    Args:
        table: neutral schema, in the map frame of :mod:`litsim_sim.datasets.ngsim_windows`; lane 6 and above are the
            auxiliary lane and the ramps.

    Raises:
        InputError: too few rows in some lane to fit it.
    """
    through = table[table["lane"].between(1, US101_LANES)]
    counts = through["lane"].value_counts()
    if len(counts) < US101_LANES or counts.min() < 100:
        raise InputError(f"cannot fit lanes 1 to {US101_LANES}: rows by lane are {counts.to_dict()}, expected 100")
    columns = [through[name].to_numpy(np.float64) for name in ("x", "y", "lane")]
    grid, centre, width = fit_lanes(*columns)

    outer = table[table["lane"] > US101_LANES]
    x = outer["x"].to_numpy(np.float64)
    slope = np.interp(x, grid, np.gradient(centre, GRID))
    right_of_first = (np.interp(x, grid, centre) - outer["y"].to_numpy(np.float64)) / np.sqrt(1.0 + slope**2)
    beyond_auxiliary = right_of_first - US101_LANES * width
    tapers = []
    for away in (US101_ON_RAMP_X - x, x - US101_OFF_RAMP_X):
        ramp = away > 0.0
        tapers.append(_fit_taper(away[ramp], beyond_auxiliary[ramp]))

    first_centre = _extend(np.column_stack([grid, centre]))
    left_edge = _shift_left(first_centre, width / 2)
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(left_edge, axis=0).T))])
    gores = [float(np.interp(at, left_edge[:, 0], s)) for at in (US101_ON_RAMP_X, US101_OFF_RAMP_X)]
    on_ramp, off_ramp = (Ramp(gore, taper) for gore, taper in zip(gores, tapers, strict=True))
    return HighwayPlan(left_edge, on_ramp, off_ramp, lanes=US101_LANES, lane_width=round(width, 3))


def fit_lanes(x: FloatArray, y: FloatArray, lane: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Fit parallel lanes to labelled positions on a road that runs roughly along +x.

    Args:
        x, y: (n,) positions [m].
        lane: (n,) lane numbers, 1 leftmost.

    Returns:
        grid (m,) of x, the y (m,) of lane 1's centre line on it, and the lane width [m].
    """
    start = float(np.floor(x.min() / GRID) * GRID)
    count = int(np.ceil((x.max() - start) / GRID)) + 1
    grid: FloatArray = start + GRID * np.arange(count, dtype=np.float64)
    cell = np.clip(((x - start) / GRID).astype(np.int64), 0, count - 2)
    part = (x - grid[cell]) / GRID
    bins = pd.Series(lane * 1e6 + np.floor(x / CELL))
    even = (bins.map(1.0 / bins.value_counts()) * len(x) / bins.nunique()).to_numpy()

    third = np.diff(np.eye(count), 3, axis=0)
    penalty = np.zeros((count + 1, count + 1))
    penalty[:count, :count] = SMOOTHNESS * third.T @ third
    weight, stretch = even, np.ones(len(x))  # stretch: lane width across the road, seen along y
    for _ in range(ITERATIONS):
        across = -(lane - 1.0) * stretch
        # Normal equations; the unknowns are the line on the grid and, last, the lane width.
        terms = ((cell, 1.0 - part), (cell + 1, part), (np.full(len(x), count), across))
        normal, right = penalty.copy(), np.zeros(count + 1)
        for rows, value in terms:
            np.add.at(right, rows, weight * value * y)
            for columns, other in terms:
                np.add.at(normal, (rows, columns), weight * value * other)
        solution: FloatArray = np.linalg.solve(normal, right).astype(np.float64)
        centre, width = solution[:count], float(solution[count])
        residual = centre[cell] * (1.0 - part) + centre[cell + 1] * part + across * width - y
        weight = even / np.maximum(1.0, np.abs(residual) / HUBER)
        stretch = np.sqrt(1.0 + np.interp(x, grid, np.gradient(centre, GRID)) ** 2)
    return grid, centre, width


def _fit_taper(away: FloatArray, offset: FloatArray) -> float:
    """Robust `taper` of offset = taper * away, from (n,) distances from the gore [m]."""
    if len(away) < 20:
        raise InputError(f"cannot fit a ramp: {len(away)} rows lie on it, expected 20")
    weight = np.ones(len(away))
    for _ in range(ITERATIONS):
        taper = float(np.sum(weight * away * offset) / np.sum(weight * away**2))
        weight = 1.0 / np.maximum(1.0, np.abs(offset - taper * away) / HUBER)
    return taper


def _extend(line: FloatArray) -> FloatArray:
    """Vertices every VERTEX_SPACING along `line` (k, 2), lengthened straight at both ends."""
    keep = line[:: round(VERTEX_SPACING / GRID)]
    back = round(END_TANGENT / VERTEX_SPACING)
    head, tail = keep[0] - keep[back], keep[-1] - keep[-1 - back]
    before = keep[0] + MARGIN * head / np.hypot(*head)
    after = keep[-1] + MARGIN * tail / np.hypot(*tail)
    return np.vstack([before, keep, after])


def _shift_left(line: FloatArray, distance: float) -> FloatArray:
    """The vertices of `line` (k, 2) moved `distance` metres to its left."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.hypot(tangent[:, 0], tangent[:, 1])[:, None]
    return line + distance * np.column_stack([-tangent[:, 1], tangent[:, 0]])
