"""Succession of lanes: straightest successors, and directly linked lanes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.lane_map.net_lanes import Lane

DECIMALS = 3  # of an angle [rad]: the net's rounding must not decide between lanes that go on in the same direction


def directly_linked(lanes: Sequence[Lane]) -> BoolArray:
    """Returns whether one lane is another itself, or directly precedes or follows it (lanes, lanes)."""
    row = {lane.id: index for index, lane in enumerate(lanes)}
    near = np.eye(len(lanes), dtype=np.bool_)
    for lane in lanes:
        for name in lane.successors:
            near[row[lane.id], row[name]] = near[row[name], row[lane.id]] = True
    return near


def straightest_successors(lanes: Sequence[Lane]) -> list[int | None]:
    """Index of the successor that turns least for each lane, the first by id of ties; None at an end of the net."""
    row = {lane.id: index for index, lane in enumerate(lanes)}
    first, last = 0, -1  # segment of a centre line

    def successor(lane: Lane) -> int | None:
        def turn(name: str) -> tuple[float, str]:
            angle = _heading(lanes[row[name]], first) - _heading(lane, last)
            return round(abs(float(wrap_angle(angle))), DECIMALS), name

        return row[min(lane.successors, key=turn)] if lane.successors else None

    return [successor(lane) for lane in lanes]


def _heading(lane: Lane, segment: int) -> FloatArray:
    """Returns the direction [rad] of a segment of the centre line."""
    step = np.diff(lane.centerline, axis=0)[segment]
    return np.asarray(np.arctan2(step[1], step[0]))
