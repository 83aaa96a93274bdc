"""Succession of lanes: straightest successors, directly linked lanes, and speed limits within junctions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray
from litsim_sim.lane_map.net_lanes import Lane

TURN = np.pi / 6.0  # [rad] inside a junction of streets; lanes of motorways diverge and merge at less
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

    def successor(lane: Lane) -> int | None:
        def turn(name: str) -> tuple[float, str]:
            angle = lanes[row[name]].headings[0] - lane.headings[1]
            return round(abs(float(wrap_angle(np.asarray(angle)))), DECIMALS), name

        return row[min(lane.successors, key=turn)] if lane.successors else None

    return [successor(lane) for lane in lanes]


def of_streets(lanes: Sequence[Lane]) -> bool:
    """Whether a net is one of streets: inside its junctions a lane turns by 30 degrees or more, more than to merge."""
    turns = (np.subtract(*lane.headings) for lane in lanes if lane.is_internal)
    return any(abs(float(wrap_angle(turn))) >= TURN for turn in turns)


def legal_limits(lanes: Sequence[Lane]) -> FloatArray:
    """Returns the speed limits (lanes,) [m/s]; inside a junction the higher one of the lanes before and after it.

    SUMO's own limits there are speeds at which its vehicles turn.
    """
    row = {lane.id: index for index, lane in enumerate(lanes)}
    limits = np.array([0.0 if lane.is_internal else lane.speed_limit for lane in lanes])
    for begin in lanes:
        if not begin.is_internal:
            ahead: list[tuple[str, tuple[str, ...]]] = [(name, ()) for name in begin.successors]
            while ahead:
                name, passed = ahead.pop()
                lane = lanes[row[name]]
                if lane.is_internal and name not in passed:
                    ahead += [(following, (*passed, name)) for following in lane.successors]
                else:
                    for inside in passed:
                        higher = max(begin.speed_limit, lane.speed_limit)
                        limits[row[inside]] = max(limits[row[inside]], higher)
    return np.where(limits > 0.0, limits, [lane.speed_limit for lane in lanes])
