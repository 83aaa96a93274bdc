"""Placement of recorded positions on the lanes of a net, and the worst misses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import lanes_from_left

WORST = 10  # vehicles whose worst miss is reported, at most


@dataclass(frozen=True)
class Miss:
    """A box centre on no lane.

    Attributes:
        vehicle, frame: vehicle and frame.
        x, y: position in frame map [m].
        beyond: distance to the nearest edge of a lane [m].
        lane: that lane.
        past_end: whether it lies before the start or past the end of that lane rather than beside it.
    """

    vehicle: int
    frame: int
    x: float
    y: float
    beyond: float
    lane: str
    past_end: bool

    @property
    def time_s(self) -> float:
        """Time of the frame on the recording's clock [s]."""
        return self.frame * STEP_S


@dataclass(frozen=True)
class Placement:
    """How vehicle centres lie on the lanes; shares of `rows`.

    Attributes:
        rows: number of rows.
        inside: within half a lane width of the centre line of the lane that they are on.
        inside_named: within half a lane width of the centre line of the lane that the recording names.
        agreement: on the lane that the recording names; these two are NaN where it names none.
        named: rows with a lane number, the base of the latter two.
        offset: median distance to the left of the lane's middle [m].
        missing: vehicles with a box centre on no lane.
        past_end: share of the misses that lie before the start or past the end of the nearest lane.
        worst: the worst miss of each of the WORST farthest vehicles, farthest first.
        against: on a lane, but heading the other way than it leads.
    """

    rows: int
    inside: float
    inside_named: float
    agreement: float
    named: int
    offset: float
    missing: int = 0
    past_end: float = 0.0
    worst: tuple[Miss, ...] = ()
    against: float = 0.0


def placement(lane_map: LaneMap, table: pd.DataFrame) -> Placement:
    """Returns how the vehicle centres of a neutral `table` (vehicle_id, frame, x, y, yaw, lane) lie on the lanes."""
    x, y, yaw = (table[name].to_numpy(np.float64) for name in ("x", "y", "yaw"))
    label = table["lane"].to_numpy(np.int64)
    place = lane_map.nearest(x, y, yaw)
    numbers = lane_numbers(lane_map)
    named = (label >= 1) & (numbers[place.lane] >= 1)
    inside_named = np.zeros(len(x), np.bool_)
    for number in np.unique(label[named]):
        mine = label == number
        rows = np.flatnonzero(numbers == number)
        if len(rows):
            lanes = LaneMap([replace(lane_map.lanes[row], successors=()) for row in rows])
            inside_named[mine] = lanes.inside_road(x[mine], y[mine])
    count, inside = int(named.sum()), lane_map.inside_road(x, y)
    beyond, nearest, past_end = off_lanes(lane_map, x[~inside], y[~inside])
    misses = table.loc[~inside, ["vehicle_id", "frame"]].assign(
        beyond=beyond, lane=nearest, past_end=past_end, x=x[~inside], y=y[~inside]
    )
    worst = misses.sort_values("beyond", ascending=False, kind="stable").drop_duplicates("vehicle_id")
    return Placement(
        rows=len(x),
        inside=float(inside.mean()),
        inside_named=float(inside_named[named].mean()) if count else float("nan"),
        agreement=float((numbers[place.lane] == label)[named].mean()) if count else float("nan"),
        named=count,
        offset=float(np.median(place.d)),
        missing=len(worst),
        past_end=float(past_end.mean()) if len(past_end) else 0.0,
        worst=tuple(
            Miss(
                int(vehicle), int(frame), float(at_x), float(at_y), float(far), lane_map.lanes[int(lane)].id, bool(past)
            )
            for vehicle, frame, far, lane, past, at_x, at_y in worst.head(WORST).to_numpy(object)
        ),
        against=float((inside & place.against(yaw)).mean()),
    )


def off_lanes(lane_map: LaneMap, x: FloatArray, y: FloatArray) -> tuple[FloatArray, IntArray, BoolArray]:
    """Returns distances (n,) [m] of points to the edge of the nearest lane, its row, and whether they are past its
    end.
    """
    place = lane_map.nearest(x, y)
    foot_x, foot_y, _ = lane_map.pose_at(place.lane, place.s)
    half = 0.5 * lane_map.widths[place.lane]
    length = np.array([lane.length for lane in lane_map.lanes])[place.lane]
    distance = np.hypot(x - foot_x, y - foot_y)
    past_end = ((place.s <= 0.0) | (place.s >= length)) & (distance > np.abs(place.d) + 1e-6)
    return np.maximum(distance - half, 0.0), place.lane, past_end


def lane_numbers(lane_map: LaneMap) -> IntArray:
    """Returns the numbers (lanes,) from 1 at the left edge of the road; 0 inside junctions.

    A ramp (an edge of one lane that runs into or comes out of one lane of several) goes on with the number of that
    lane.
    """
    from_left = lanes_from_left(lane_map.lanes)
    alone = [number == 1 and lane.index == 0 for lane, number in zip(lane_map.lanes, from_left, strict=True)]
    numbers = from_left.copy()
    for row, lane in enumerate(lane_map.lanes):
        for name in lane.successors:
            after = lane_map.row(name)
            if lane.is_internal or lane_map.lanes[after].is_internal:
                continue
            if alone[row]:
                numbers[row] = max(numbers[row], from_left[after])
            if alone[after]:
                numbers[after] = max(numbers[after], numbers[row])
    return np.array(numbers, np.int64)
