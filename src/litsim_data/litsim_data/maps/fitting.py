"""Lane geometry of a motorway carriageway, fitted to positions with lane labels.

All through lanes share one smooth line; each has an offset from it that stays the same along the road. Line and offsets
are estimated together by penalised least squares with Huber weights, so that lane changers and mislabelled rows count
little. That gives the bends of the road and the distances between its lanes, but vehicles do not drive, or are not
recorded, exactly in the middle: the US-101 tracks keep 0.5 m to the right of it over most of the site. NGSIM's own
lateral coordinate, Local_X, is measured from the left edge of the road; where a recording has it, the line
Local_X = 0 is fitted in the same way and becomes the left edge. Nothing but the resulting geometry leaves this module.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.sparse import coo_array, hstack

from litsim_data.maps.highway import LANE_WIDTH, MARGIN, VERTEX_SPACING, HighwayPlan, Ramp
from litsim_data.maps.lane_graph import shift_left
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import FloatArray, IntArray

GRID = 5.0  # [m] spacing of the fitted line's support points
SMOOTHNESS = 1e7  # weight of squared third differences on GRID: bends shorter than about 100 m are smoothed away
HUBER = 0.3  # [m] residuals beyond count linearly
ITERATIONS = 15
CELL = 10.0  # [m] every lane and cell along the road weighs the same, however many vehicles queued there
END_TANGENT = 30.0  # [m] over which the direction of the margin is taken
ROWS_MIN = 100  # of a lane
RAMP_ROWS_MIN = 20
LANE_SHARE_MIN = 0.02  # of the rows of the busiest lane: lanes with fewer are ramps or mistakes
TURN_MAX = np.deg2rad(60.0)  # a carriageway that turns further cannot be described along one axis


@dataclass(frozen=True)
class Layout:
    """What is known of a carriageway before fitting.

    Attributes:
        lanes: through lanes, numbered from 1 at the left; rows of higher numbers are auxiliary lane and ramps.
        on_ramp_x, off_ramp_x: positions of the gores in frame map [m]; None without such a ramp.
        auxiliary_end_x: end of an auxiliary lane without off-ramp [m].
    """

    lanes: int
    on_ramp_x: float | None = None
    off_ramp_x: float | None = None
    auxiliary_end_x: float | None = None


LAYOUTS = {
    # 579 ft and 1277 ft in the description of the site.
    "us101": Layout(lanes=5, on_ramp_x=177.0, off_ramp_x=388.0),
    # Lane 1 is for high-occupancy vehicles. 420 ft in the site plan as remembered, not looked up: the CAD ramp is then
    # 2.3 m off. Lane 7 ends where none of its 644 vehicles is in it any more.
    "i80": Layout(lanes=6, on_ramp_x=128.0, auxiliary_end_x=203.0),
}


def fit_plan(table: pd.DataFrame, layout: Layout) -> HighwayPlan:
    """Returns the plan of a carriageway that runs roughly along +x.

    Args:
        table: columns x, y [m] in frame map and lane; where it has one, column local_x [m], the distance of (front_x,
            front_y) from the left edge of the road.

    Raises:
        InputError: too few rows in some lane or on a ramp to fit it.
    """
    through = table[table["lane"].between(1, layout.lanes)]
    counts = through["lane"].value_counts()
    if len(counts) < layout.lanes or counts.min() < ROWS_MIN:
        raise InputError(
            f"cannot fit lanes 1 to {layout.lanes}: rows by lane are {counts.to_dict()}, expected {ROWS_MIN}"
        )
    x, y = (through[name].to_numpy(np.float64) for name in ("x", "y"))
    grid, centre, offsets = fit_lanes(x, y, through["lane"].to_numpy(np.int64))
    widths = lane_widths(offsets)

    outer = table[(table["lane"] > layout.lanes)]
    at = outer["x"].to_numpy(np.float64)
    slope = np.interp(at, grid, np.gradient(centre, GRID))
    right_of_first = (np.interp(at, grid, centre) - outer["y"].to_numpy(np.float64)) / np.sqrt(1.0 + slope**2)
    # Seen from the vehicles of the through lanes, whose deviation from the middle those of the others share.
    beyond = right_of_first - offsets[-1] - 0.5 * widths[-1] - 0.5 * LANE_WIDTH

    if "local_x" in table.columns:
        grid, edge = fit_left_edge(table)
        left_edge = _extend(np.column_stack([grid, edge]))
    else:
        left_edge = shift_left(_extend(np.column_stack([grid, centre])), 0.5 * widths[0])
    s = arc_lengths(left_edge)

    def along(x: float) -> float:
        return float(np.interp(x, left_edge[:, 0], s))

    plan = HighwayPlan(left_edge, widths=tuple(float(np.round(width, 3)) for width in widths))
    if layout.on_ramp_x is None:
        return plan
    on_ramp = Ramp(along(layout.on_ramp_x), _fit_taper(layout.on_ramp_x - at, beyond))
    plan = replace(plan, on_ramp=on_ramp)
    if layout.off_ramp_x is not None:
        off_ramp = Ramp(along(layout.off_ramp_x), _fit_taper(at - layout.off_ramp_x, beyond))
        return replace(plan, off_ramp=off_ramp)
    return replace(plan, auxiliary_end=along(layout.auxiliary_end_x or float(at.max())))


def fit_generic_plan(table: pd.DataFrame) -> HighwayPlan:
    """Returns the plan of any carriageway whose lanes are numbered from 1 at the left.

    Args:
        table: columns x, y [m], yaw [rad] and lane.

    Raises:
        InputError: too few rows, or the headings show more than one carriageway or a road that turns too far.
    """
    known = table[table["lane"] >= 1]
    counts = known["lane"].value_counts()
    if known.empty:
        raise InputError("cannot fit lanes: the recording has no lane numbers (column lane is -1 or 0 throughout)")
    lanes = 0
    while counts.get(lanes + 1, 0) >= max(LANE_SHARE_MIN * counts.max(), ROWS_MIN):
        lanes += 1
    if lanes == 0:
        raise InputError(f"cannot fit lanes: rows by lane are {counts.to_dict()}, expected {ROWS_MIN} in lane 1")
    yaw = known["yaw"].to_numpy(np.float64)
    main = float(np.arctan2(np.mean(np.sin(yaw)), np.mean(np.cos(yaw))))
    turn = np.abs(np.angle(np.exp(1j * (yaw - main))))
    if np.quantile(turn, 0.98) > TURN_MAX:
        raise InputError(
            "cannot fit lanes: headings differ by more than 60 degrees; give the rows of one carriageway that does "
            "not turn further"
        )
    cos, sin = np.cos(main), np.sin(main)
    x, y = known["x"].to_numpy(np.float64), known["y"].to_numpy(np.float64)
    turned = pd.DataFrame({"x": cos * x + sin * y, "y": cos * y - sin * x, "lane": known["lane"].to_numpy()})
    plan = fit_plan(turned, Layout(lanes))
    edge = plan.left_edge @ np.array([[cos, sin], [-sin, cos]])
    return replace(plan, left_edge=edge)


def fit_lanes(x: FloatArray, y: FloatArray, lane: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fits parallel lanes to labelled positions on a road that runs roughly along +x.

    Args:
        x, y: (n,) positions [m].
        lane: (n,) lane numbers from 1, leftmost first; every number up to the highest occurs.

    Returns:
        grid (m,) of x, the y (m,) of lane 1's centre line on it, and how far right of that each lane runs (k,) [m].
    """
    number = np.asarray(lane, np.int64)
    beside = (number[:, None] == np.arange(2, number.max() + 1)).astype(np.float64)
    cells = number * 1_000_000 + np.floor(x / CELL).astype(np.int64)
    grid, line, offsets = _fit_line(x, y, beside, cells)
    return grid, line, np.concatenate([[0.0], offsets])


def fit_left_edge(table: pd.DataFrame) -> tuple[FloatArray, FloatArray]:
    """Returns the line on which NGSIM's lateral coordinate is 0: the left edge of the road.

    Args:
        table: columns front_x, front_y, local_x [m]; local_x may be stretched against the other two.

    Returns:
        grid (m,) of x and the edge's y (m,) on it.
    """
    x, y, right = (table[name].to_numpy(np.float64) for name in ("front_x", "front_y", "local_x"))
    cells = np.floor(right / 3.0).astype(np.int64) * 1_000_000 + np.floor(x / CELL).astype(np.int64)
    grid, line, _ = _fit_line(x, y, right[:, None], cells)
    return grid, line


def lane_widths(offsets: FloatArray) -> FloatArray:
    """Returns widths (k,) of lanes side by side from their centres' offsets (k,): as equal as the offsets allow."""
    if len(offsets) == 1:
        return np.array([LANE_WIDTH])
    apart = np.diff(offsets)
    mean = float(apart.mean())
    halves = 0.5 * (np.eye(len(offsets))[:-1] + np.eye(len(offsets))[1:])
    # Of all widths that give these distances, least squares takes those nearest to the mean.
    return mean + np.asarray(np.linalg.lstsq(halves, apart - mean)[0], np.float64)


def _fit_line(
    x: FloatArray, y: FloatArray, features: FloatArray, cells: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fits y = line(x) - stretch * features @ coefficients; `stretch` turns metres across the road into metres of y.

    Args:
        x, y: (n,) [m].
        features: (n, p).
        cells: (n,) rows of one cell share one weight.

    Returns:
        grid (m,), the line on it (m,), coefficients (p,).
    """
    start = float(np.floor(x.min() / GRID) * GRID)
    count = int(np.ceil((x.max() - start) / GRID)) + 1
    grid: FloatArray = start + GRID * np.arange(count, dtype=np.float64)
    cell = np.clip(((x - start) / GRID).astype(np.int64), 0, count - 2)
    part = (x - grid[cell]) / GRID
    _, which, rows = np.unique(cells, return_inverse=True, return_counts=True)
    even = len(x) / len(rows) / rows[which]

    third = np.diff(np.eye(count), 3, axis=0)
    size = count + features.shape[1]
    smooth = np.zeros((size, size))
    smooth[:count, :count] = SMOOTHNESS * third.T @ third
    row = np.arange(len(x))
    hats = coo_array((np.r_[1.0 - part, part], (np.r_[row, row], np.r_[cell, cell + 1])), shape=(len(x), count))
    weight, stretch = even, np.ones(len(x))
    for _ in range(ITERATIONS):
        design = hstack([hats, coo_array(-features * stretch[:, None])], format="csr")
        weighted = design.multiply(weight[:, None]).T
        solution: FloatArray = np.linalg.solve(smooth + (weighted @ design).toarray(), weighted @ y)
        line, coefficients = solution[:count], solution[count:]
        weight = even / np.maximum(1.0, np.abs(design @ solution - y) / HUBER)
        stretch = np.sqrt(1.0 + np.interp(x, grid, np.gradient(line, GRID)) ** 2)
    return grid, line, coefficients


def _fit_taper(away: FloatArray, offset: FloatArray) -> float:
    """Fits `taper` of offset = taper * away robustly to distances (n,) from the gore [m]; those before it do not
    count.
    """
    away, offset = away[away > 0.0], offset[away > 0.0]
    if len(away) < RAMP_ROWS_MIN:
        raise InputError(f"cannot fit a ramp: {len(away)} rows lie on it, expected {RAMP_ROWS_MIN}")
    weight = np.ones(len(away))
    for _ in range(ITERATIONS):
        taper = float(np.sum(weight * away * offset) / np.sum(weight * away**2))
        weight = 1.0 / np.maximum(1.0, np.abs(offset - taper * away) / HUBER)
    return taper


def _extend(line: FloatArray) -> FloatArray:
    """Returns vertices every VERTEX_SPACING along `line` (k, 2), lengthened straight at both ends."""
    keep = line[:: round(VERTEX_SPACING / GRID)]
    back = min(round(END_TANGENT / VERTEX_SPACING), len(keep) - 1)
    head, tail = keep[0] - keep[back], keep[-1] - keep[-1 - back]
    before = keep[0] + MARGIN * head / np.hypot(*head)
    after = keep[-1] + MARGIN * tail / np.hypot(*tail)
    return np.vstack([before, keep, after])
