"""Lanes of an OpenDRIVE map by its own reader, for maps on some of whose roads traffic keeps to the other side.

netconvert reads all roads as keeping to one side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from litsim_data.maps.lane_graph import SPEED_LIMIT, LaneGraph, Lanelet, polyline
from litsim_data.maps.netconvert import LEFT_HAND, unruled
from litsim_data.maps.opendrive_roads import Road, Roads, Section, end_of
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import read_plain_xml

STEP = 2.0  # [m] between points of lanes, at most
SHORT = 1e-3  # [m] of a section that is none
NARROW = 0.5  # [m] median width of what is no lane
DRIVEN = ("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional", "bus", "taxi", "HOV")
"""Types of lanes of motor vehicles."""


def has_both_rules(path: Path) -> bool:
    """Returns whether traffic keeps to the left on some roads of the map at `path`, and to the right on others.

    Raises:
        InputError: the file is no OpenDRIVE.
    """
    root = read_plain_xml(path, "OpenDRIVE file")
    inside = unruled(root)
    return len({road.get("rule") == LEFT_HAND for road in root.findall("road") if road not in inside}) > 1


def read_lanes(path: Path) -> LaneGraph:
    """Returns the lanes of motor vehicles, each leading as the rule of its road says.

    Raises:
        InputError: the file is no OpenDRIVE, or has no such lanes.
    """
    roads = Roads(path)
    lanelets = [lanelet for road in roads.by_id.values() for lanelet in _of_road(road, roads)]
    if not lanelets:
        raise InputError(f"{path}: no road has lanes for motor vehicles")
    ruled_left = [road.left_hand for road in roads.by_id.values()]
    note = (
        f"{sum(ruled_left)} of {len(ruled_left)} roads keep to the left by rule, the others to the right, as their "
        "lanes do here; signals of such maps are not read"
    )
    return LaneGraph(tuple(lanelets), left_hand=2 * sum(ruled_left) > len(ruled_left), notes=(note,))


def _of_road(road: Road, roads: Roads) -> Iterator[Lanelet]:
    for section in road.sections:
        begin, end = max(section.s, 0.0), min(end_of(road, section), road.length) - 1e-6
        if end - begin < SHORT:
            continue
        along = np.linspace(begin, end, max(2, int(np.ceil((end - begin) / STEP)) + 1)).tolist()
        for number, lane in section.lanes.items():
            if number and lane.type in DRIVEN and (lanelet := _lanelet(road, section, number, along)) is not None:
                forward = road.leads(number)
                after = roads.onward(road, number, section, forward=forward)
                names = (_name(to, to.section(s if ahead else s - 1e-6), other) for to, other, s, ahead in after)
                yield replace(lanelet, successors=tuple(names))


def _lanelet(road: Road, section: Section, number: int, along: list[float]) -> Lanelet | None:
    """Returns a lane of a section by places `along` its reference line [m]; None for what is no lane."""
    middles = [road.middle(number, s) for s in along]
    places = [(s, *middle) for s, middle in zip(along, middles, strict=True) if middle is not None]
    if len(places) < len(along) or float(np.median([width for *_, width in places])) < NARROW:
        return None
    forward = road.leads(number)
    sides = [[road.pose(s, t + 0.5 * side * width)[:2] for s, t, width in places] for side in (1.0, -1.0)]
    left, right = sides if forward else (sides[1][::-1], sides[0][::-1])
    left_id, right_id = (
        _name(road, section, other) if other * number > 0 and other in section.lanes else None
        for other in ((number + 1, number - 1) if forward else (number - 1, number + 1))
    )
    try:
        bounds = [polyline(line, f"lane {number} of road {road.id}") for line in (left, right)]
    except ValueError:  # of no length
        return None
    return Lanelet(
        _name(road, section, number),
        bounds[0],
        bounds[1],
        left_id=left_id,
        right_id=right_id,
        speed_limit=road.speed or SPEED_LIMIT,
        junction=road.junction,
    )


def _name(road: Road, section: Section, number: int) -> str:
    return f"{road.id}_{road.sections.index(section)}_{number}"
