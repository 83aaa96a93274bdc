"""Streets with intersections, fitted to the columns that NGSIM's urban files have.

Rows in a section (column section above 0, intersection 0) say by direction and lane where lanes run: those of one
section and direction are fitted together, each over the stretch on which it was used, so that turn bays begin where
they begin. What a vehicle drives between the lane that it leaves and the lane that it enters is a movement: the median
path of all that made it becomes a connection of the junction. Cross streets that have no section of their own get a
short approach and exit from the tracks that begin or end within an intersection.

The result is a lane graph of our own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pandas as pd

from litsim_data.maps.fitting import fit_lanes, lane_widths
from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around, at_shares, turn
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

COLUMNS = ("vehicle_id", "frame", "x", "y", "lane", "intersection", "section", "direction", "movement")
MOVEMENTS = {"straight": 1, "left": 2, "right": 3}
"""Values of column movement by the turn."""
LANE_WIDTH = 3.3  # [m] of a lane without neighbours
WIDTHS = (2.7, 4.2)  # [m] fitted widths are held within
ROWS_MIN = 30  # of a lane
VEHICLES_MIN = 3  # of a lane
MOVEMENTS_MIN = 2  # vehicles that make a movement count it as one
SNAP = 15.0  # [m] lanes that begin or end less than this from the end of their section reach it
STEP = 4.0  # [m] between points of a lane
PATH_POINTS = 15  # of a movement
TURN = np.deg2rad(40.0)  # movements that turn less go through
STUB = (6.0, 40.0)  # [m] length of an approach or exit without a section
STRAY = 1.0  # [m] from the straight line beyond which vehicles have begun to turn
EXTENT = (0.01, 0.99)  # quantiles between which a lane reaches


@dataclass
class _Arm:
    """Parallel lanes of one direction: of a section, or of an approach or exit.

    Attributes:
        name: unique; its lanelets' ids begin with it.
        origin, along: where u is 0, and the unit vector of u; v is to its left.
        u, v, lane, vehicle: (n,) rows.
    """

    name: str
    origin: FloatArray
    along: FloatArray
    u: FloatArray
    v: FloatArray
    lane: IntArray
    vehicle: IntArray
    lanelets: dict[int, list[Lanelet]] = field(default_factory=dict)


def fit_streets(table: pd.DataFrame) -> LaneGraph:
    """Returns the lanes and movements under a table of positions.

    Args:
        table: COLUMNS, in frame map and SI units; `vehicle_id` names one track.

    Raises:
        InputError: columns are missing or unknown throughout, or no lane has enough rows.
    """
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing or not (table["section"] > 0).any():
        raise InputError(
            f"cannot fit streets: {f'columns {missing} are missing' if missing else 'no row is in a section'}; that "
            "needs an official file of Lankershim or Peachtree Street, with Int_ID, Section_ID, Direction, Movement"
        )
    rows = table[list(COLUMNS)].sort_values(["vehicle_id", "frame"], ignore_index=True)
    arms, arm_of = _arms(rows)
    for arm in arms:
        _fit_arm(arm)
    movements = _movements(rows, arms, arm_of)
    starts = {name for movement in movements for name in movement.predecessors}
    lanes = [
        replace(part, lights=(part.id,) * (part.id in starts))
        for arm in arms
        for parts in arm.lanelets.values()
        for part in parts
    ]
    if not lanes:
        raise InputError(f"cannot fit streets: no lane has {ROWS_MIN} rows of {VEHICLES_MIN} vehicles")
    return LaneGraph((*lanes, *movements))


def _arms(rows: pd.DataFrame) -> tuple[list[_Arm], IntArray]:
    """Returns arms with their rows, and the arm of every row (n,), -1 within intersections."""
    x, y = rows["x"].to_numpy(np.float64), rows["y"].to_numpy(np.float64)
    vehicle = rows["vehicle_id"].to_numpy(np.int64)
    section, direction = rows["section"].to_numpy(np.int64), rows["direction"].to_numpy(np.int64)
    crossing = rows["intersection"].to_numpy(np.int64)
    lane = rows["lane"].to_numpy(np.int64)
    inside = (section > 0) & (crossing <= 0)
    arm_of = np.full(len(rows), -1, np.int64)
    arms: list[_Arm] = []

    def add(name: str, mine: BoolArray, lanes: IntArray | None = None) -> None:
        which = np.flatnonzero(mine)
        along = _main_direction(vehicle[which], x[which], y[which])
        if along is None:
            return
        origin = np.array([x[which].mean(), y[which].mean()])
        u = (x[which] - origin[0]) * along[0] + (y[which] - origin[1]) * along[1]
        v = (y[which] - origin[1]) * along[0] - (x[which] - origin[0]) * along[1]
        if lanes is None:  # an approach or an exit: up to where vehicles turn
            keep, labels = _straight_part(vehicle[which], u, v, leaving=name.startswith("out"))
            which, u, v = which[keep], u[keep], v[keep]
        else:
            labels = lanes[which]
        if len(which):
            arm_of[which] = len(arms)
            arms.append(_Arm(name, origin, along, u, v, labels, vehicle[which]))

    for key in sorted({*zip(section[inside].tolist(), direction[inside].tolist(), strict=True)}):
        add(f"s{key[0]}d{key[1]}", inside & (section == key[0]) & (direction == key[1]), lane)
    # Runs of rows within one intersection, at the beginning or the end of a track.
    first = np.concatenate([[True], vehicle[1:] != vehicle[:-1]])
    change = first | np.concatenate([[True], inside[1:] != inside[:-1]])
    run = np.cumsum(change) - 1
    begins, ends = first, np.concatenate([first[1:], [True]])
    starting, ending = np.bincount(run, begins)[run] > 0, np.bincount(run, ends)[run] > 0
    heading = _quadrants(vehicle, x, y)
    starts, stops = np.flatnonzero(change), np.append(np.flatnonzero(change)[1:], len(rows)) - 1
    here = ~inside & (crossing > 0)
    for prefix, at_border, reference in (("in", starting, starts), ("out", ending, stops)):
        quadrant, place = heading[reference[run]], crossing[reference[run]]
        keys = {*zip(place[here & at_border].tolist(), quadrant[here & at_border].tolist(), strict=True)}
        for key in sorted(keys):
            mine = here & at_border & (arm_of < 0) & (place == key[0]) & (quadrant == key[1])
            if len(np.unique(vehicle[mine])) >= VEHICLES_MIN:
                add(f"{prefix}{key[0]}q{key[1]}", mine)
    return arms, arm_of


def _main_direction(vehicle: IntArray, x: FloatArray, y: FloatArray) -> FloatArray | None:
    """Returns the unit vector of the prevailing displacement over about a second; None if no vehicle moves."""
    ahead = 10
    if len(x) <= ahead:
        return None
    same = vehicle[ahead:] == vehicle[:-ahead]
    dx, dy = (x[ahead:] - x[:-ahead])[same], (y[ahead:] - y[:-ahead])[same]
    far = np.hypot(dx, dy) > 1.0
    if not far.any():
        return None
    angle = np.arctan2(dy[far], dx[far])
    bins = np.round(angle / np.deg2rad(10.0)).astype(np.int64) % 36
    most = np.deg2rad(10.0) * int(np.bincount(bins, minlength=36).argmax())
    near = np.abs(np.angle(np.exp(1j * (angle - most)))) < np.deg2rad(15.0)
    mean = np.array([dx[far][near].sum(), dy[far][near].sum()])
    return np.asarray(mean / np.hypot(*mean), np.float64)


def _quadrants(vehicle: IntArray, x: FloatArray, y: FloatArray) -> IntArray:
    """Returns the quarter (n,) of the compass in which a vehicle heads, 0: along +x; by its way over the next
    metres.
    """
    result = np.zeros(len(x), np.int64)
    for rows in _tracks(vehicle):
        track = np.column_stack([x[rows], y[rows]])
        s = arc_lengths(track)
        low, high = np.maximum(s - 2.0, 0.0), np.minimum(s + 2.0, s[-1])
        dx, dy = (np.interp(high, s, track[:, axis]) - np.interp(low, s, track[:, axis]) for axis in (0, 1))
        result[rows] = np.round(np.arctan2(dy, dx) / (0.5 * np.pi)).astype(np.int64) % 4
    return result


def _straight_part(vehicle: IntArray, u: FloatArray, v: FloatArray, *, leaving: bool) -> tuple[IntArray, IntArray]:
    """Returns rows of an approach (or, `leaving`, an exit) that do not turn yet (any more), and their lanes from 1."""
    towards = -u if leaving else u  # grows towards the intersection
    border = float(np.quantile([towards[rows].min() for rows in _tracks(vehicle)], 0.5))
    outer = np.flatnonzero(towards < border + STUB[0])
    if not len(outer):
        return outer, outer
    low, high = np.quantile(v[outer], [0.05, 0.95])
    lanes = 1 + round(max(float(high - low) - 1.0, 0.0) / LANE_WIDTH)
    width = max(float(high - low), 1e-3) / lanes
    label = np.clip(((high - v) / width).astype(np.int64), 0, lanes - 1) + 1
    middle = np.array([np.median(v[outer][label[outer] == number]) for number in range(1, lanes + 1)])
    stray = np.abs(v[:, None] - middle).min(axis=1)
    end = border + STUB[0]
    while end < border + STUB[1]:
        slab = (towards >= end) & (towards < end + 2.0)
        if slab.sum() < ROWS_MIN or np.quantile(stray[slab], 0.9) > STRAY:
            break
        end += 2.0
    keep = np.flatnonzero(towards < end)
    return keep, np.abs(v[keep, None] - middle).argmin(axis=1) + 1


def _fit_arm(arm: _Arm) -> None:
    """Fills `arm.lanelets`: by lane, its parts along the road."""
    labels = [
        int(label)
        for label in np.unique(arm.lane[arm.lane > 0])
        if (arm.lane == label).sum() >= ROWS_MIN and len(np.unique(arm.vehicle[arm.lane == label])) >= VEHICLES_MIN
    ]
    if not labels:
        return
    labels.sort(key=lambda label: -float(np.median(arm.v[arm.lane == label])))  # leftmost first
    order = {label: place for place, label in enumerate(labels)}
    known = np.isin(arm.lane, labels)
    u, v = arm.u[known], arm.v[known]
    place = np.array([order[label] for label in arm.lane[known].tolist()])
    grid, line, offsets = fit_lanes(u, v, place + 1)
    widths = np.clip(lane_widths(offsets), *WIDTHS) if len(labels) > 1 else np.array([LANE_WIDTH])

    reach = np.array([np.quantile(u[place == at], EXTENT) for at in range(len(labels))])
    begin, end = float(reach[:, 0].min()), float(reach[:, 1].max())
    reach[:, 0] = np.where(reach[:, 0] < begin + SNAP, begin, reach[:, 0])
    reach[:, 1] = np.where(reach[:, 1] > end - SNAP, end, reach[:, 1])
    cuts = [begin]
    for cut in np.unique(reach):
        if cut > cuts[-1] + SNAP:
            cuts.append(float(cut))
    cuts = [*cuts[:-1], end] if len(cuts) > 1 else [begin, end]
    for part, (low, high) in enumerate(pairwise(cuts)):
        at = np.linspace(low, high, max(int(np.ceil((high - low) / STEP)) + 1, 2))
        slope = np.interp(at, grid, np.gradient(line, grid[1] - grid[0]))
        stretch = np.sqrt(1.0 + slope**2)
        # A lane is in every part of which it was used over more than half.
        present = [i for i in range(len(labels)) if min(high, reach[i, 1]) - max(low, reach[i, 0]) > 0.5 * (high - low)]
        for i in present:
            bounds = [
                _in_map(arm, at, np.interp(at, grid, line) - (offsets[i] + side * widths[i]) * stretch)
                for side in (-0.5, 0.5)
            ]
            name = f"{arm.name}l{labels[i]}"
            neighbour = {side: i + side for side in (-1, 1) if i + side in present}
            lanelet = Lanelet(
                id=f"{name}p{part}",
                left=bounds[0],
                right=bounds[1],
                left_id=f"{arm.name}l{labels[neighbour[-1]]}p{part}" if -1 in neighbour else None,
                right_id=f"{arm.name}l{labels[neighbour[1]]}p{part}" if 1 in neighbour else None,
            )
            parts = arm.lanelets.setdefault(labels[i], [])
            if parts:
                parts[-1] = replace(parts[-1], successors=(lanelet.id,))
            parts.append(lanelet)


def _movements(rows: pd.DataFrame, arms: list[_Arm], arm_of: IntArray) -> list[Lanelet]:
    """Returns movements as lanelets."""
    x, y = rows["x"].to_numpy(np.float64), rows["y"].to_numpy(np.float64)
    vehicle, label = rows["vehicle_id"].to_numpy(np.int64), np.zeros(len(rows), np.int64)
    for number, arm in enumerate(arms):
        label[arm_of == number] = arm.lane
    movement = rows["movement"].to_numpy(np.int64)
    crossing = rows["intersection"].to_numpy(np.int64)
    ways: dict[tuple[int, int, int, int], list[tuple[FloatArray, int]]] = {}
    places: dict[tuple[int, int, int, int], int] = {}
    for track in _tracks(vehicle):
        on = track[(arm_of[track] >= 0) & (label[track] > 0)]
        for before, after in pairwise(on):
            if arm_of[before] == arm_of[after]:
                continue
            key = (int(arm_of[before]), int(label[before]), int(arm_of[after]), int(label[after]))
            between = np.arange(before, after + 1)
            codes = movement[between][movement[between] > 0]
            code = int(np.bincount(codes).argmax()) if len(codes) else 0
            ways.setdefault(key, []).append((np.column_stack([x[between], y[between]]), code))
            named = crossing[between][crossing[between] > 0]
            places[key] = int(named[0]) if len(named) else 0
    movements = []
    for key in sorted(ways):
        from_arm, from_lane, to_arm, to_lane = key
        starts, ends = arms[from_arm].lanelets.get(from_lane), arms[to_arm].lanelets.get(to_lane)
        if not starts or not ends:
            continue
        (out_x, out_y), (in_x, in_y) = arms[to_arm].along, arms[from_arm].along
        kind = MOVEMENTS[turn(float(np.arctan2(out_y, out_x) - np.arctan2(in_y, in_x)), TURN)]
        # A way that contradicts the column is a mistake of one or the other.
        agreeing = [way for way, code in ways[key] if code in (0, kind)]
        if len(agreeing) < MOVEMENTS_MIN:
            continue
        start, end = starts[-1], ends[0]
        line = _median_path(agreeing, start.centerline[-1], end.centerline[0])
        sides = around(line, np.linspace(start.width, end.width, len(line)))
        name = f"i{places[key]}_{start.id}_{end.id}"
        movements.append(Lanelet(name, *sides, (end.id,), junction=True, predecessors=(start.id,)))
    return movements


def _median_path(ways: list[FloatArray], start: FloatArray, end: FloatArray) -> FloatArray:
    """Returns the median (PATH_POINTS, 2) of polylines at equal shares of their length, led from `start` to `end`."""
    share = np.linspace(0.0, 1.0, PATH_POINTS)
    line = np.median([at_shares(way, share) for way in ways], axis=0)
    smooth = line.copy()
    smooth[1:-1] = 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:]
    led = smooth + (1.0 - share)[:, None] * (start - smooth[0]) + share[:, None] * (end - smooth[-1])
    return np.asarray(led, np.float64)


def _in_map(arm: _Arm, u: FloatArray, v: FloatArray) -> FloatArray:
    """Returns points (m, 2) in frame map [m] that lie `u` (m,) along an arm and `v` (m,) to its left [m]."""
    across = np.array([-arm.along[1], arm.along[0]])
    return arm.origin + u[:, None] * arm.along + v[:, None] * across


def _tracks(vehicle: IntArray) -> Iterator[IntArray]:
    """Yields the rows of each vehicle in turn, of the column `vehicle` (n,), by which the rows are sorted."""
    yield from np.split(np.arange(len(vehicle)), np.flatnonzero(np.diff(vehicle)) + 1)
