"""Vehicles that keep their pace along their lanes: the world in which nothing happened."""

from __future__ import annotations

import numpy as np

from litsim_data.mining.events import Situation
from litsim_data.mining.lane_tracks import NOWHERE
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.scenario.encounter_note import Track


def recorded(situation: Situation, row: int, first: int, last: int) -> Track:
    """Returns what the vehicle in `row` of the log did from step `first` to step `last`."""
    log, part = situation.log, slice(first, last + 1)
    return Track(*(values[row, part].copy() for values in (log.x, log.y, log.yaw, log.speed)))


def at_pace(situation: Situation, row: int, onset: int, last: int) -> Track:
    """Returns what the vehicle in `row` does from step `onset` to step `last` if it keeps its speed.

    It goes on along its lane, as far from the centre line as it is, by the roads that it takes in the record; straight
    on where there is no lane.
    """
    log = situation.log
    x, y, yaw, speed = (float(values[row, onset]) for values in (log.x, log.y, log.yaw, log.speed))
    way: FloatArray = STEP_S * speed * np.arange(last - onset + 1, dtype=np.float64)
    lane, ahead = int(situation.tracks.lane[row, onset]), float(way[-1]) + 1.0
    if lane == NOWHERE:
        points = np.array([[x, y], [x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)]])
        beside = 0.0
    else:
        roads = {
            situation.lane_map.lanes[lane].edge_id for lane in set(situation.tracks.lane[row].tolist()) - {NOWHERE}
        }
        points = situation.lane_map.path_from(lane, float(situation.tracks.s[row, onset]), ahead, roads)
        beside = float(situation.tracks.d[row, onset])
    place, heading = _along(points, way)
    x_way = place[:, 0] - beside * np.sin(heading)
    y_way = place[:, 1] + beside * np.cos(heading)
    return Track(x_way, y_way, heading, np.full(len(way), speed))


def _along(points: FloatArray, way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns places (T, 2) [m] and directions (T,) [rad] of a polyline (m, 2) after each `way` (T,) [m]."""
    s = arc_lengths(points)
    place = np.column_stack([np.interp(way, s, points[:, axis]) for axis in (0, 1)])
    segment = np.clip(np.searchsorted(s, way, side="right") - 1, 0, len(points) - 2)
    direction = np.diff(points, axis=0)[segment]
    return place, np.arctan2(direction[:, 1], direction[:, 0])
