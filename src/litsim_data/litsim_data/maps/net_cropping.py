"""Cropping of a recording to where its net is."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import is_obstacle
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.checks import STANDING_M
from litsim_sim.scenario.recording import Recording


def cropped_to_net(recording: Recording, lane_map: LaneMap) -> tuple[Recording, list[str]]:
    """Returns the tracks from where they come onto lanes to where they leave them, and lines on what was left out.

    Tracks that move and are never on a lane are left out. Parked vehicles stay where they are, on a lane or beside;
    pedestrians and cyclists keep their whole tracks.
    """
    vehicle, frame, x, y = (recording.columns[name] for name in ("vehicle_id", "frame", "x", "y"))
    order = np.lexsort((frame, vehicle))
    ids, first = np.unique(vehicle[order], return_index=True)
    row = np.searchsorted(ids, vehicle[order])
    inside = lane_map.inside_road(x[order], y[order])
    place = np.arange(len(order))
    enters, leaves = np.full(len(ids), len(order)), np.full(len(ids), -1)
    np.minimum.at(enters, row[inside], place[inside])
    np.maximum.at(leaves, row[inside], place[inside])
    way = np.maximum.reduceat(x[order], first) - np.minimum.reduceat(x[order], first)
    way = np.hypot(way, np.maximum.reduceat(y[order], first) - np.minimum.reduceat(y[order], first))
    never, walking = leaves < 0, is_obstacle(recording.columns["kind"][order][first])
    whole = walking | (never & (way < STANDING_M))
    keep = np.zeros(len(order), np.bool_)
    keep[order] = whole[row] | ((place >= enters[row]) & (place <= leaves[row]))
    gone = never & ~whole
    lines = [
        (int((~keep).sum() - gone[row].sum()), "rows of vehicles before they come onto the map or after they leave it"),
        (int(gone.sum()), "vehicles that drive beside the lanes only"),
    ]
    parked = int((never & whole & ~walking).sum())
    texts = [f"left out   {count} {what}" for count, what in lines if count]
    texts += [f"parked     {parked} vehicles stand beside the lanes all the time"] if parked else []
    return recording.take(keep), texts
