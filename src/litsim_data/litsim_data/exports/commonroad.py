"""Runs and scenarios as CommonRoad XML 2020a: lanelets, lights, obstacles with trajectories, and a planning problem."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count, groupby
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd

from litsim_data.exports.export import Content, Export, add, write_xml
from litsim_data.maps.lane_graph import around, turn, turn_of
from litsim_sim.core.scene import STEP_S, FloatArray, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.signals import Signals

COLOURS = {
    SignalState.RED: "red",
    SignalState.FLASHING_RED: "red",
    SignalState.RED_AMBER: "redYellow",
    SignalState.GREEN: "green",
    SignalState.GREEN_PERMISSIVE: "green",
    SignalState.AMBER: "yellow",
    SignalState.AMBER_PERMISSIVE: "yellow",
    SignalState.FLASHING_AMBER: "yellow",
}
"""Colour of each state; the others are inactive."""
TURN = np.deg2rad(40.0)  # connections that turn less go straight on
GOAL = (20.0, 4.0)  # [m] length and width of the goal around where the log of the ego ends
DIGITS = 6  # of coordinates [m], angles [rad], and speeds [m/s]


class CommonRoad(Export):
    """Time counts from where the ego is free; the ego is no obstacle but the planning problem."""

    endings, content = (".xml",), "CommonRoad XML 2020a"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        name = re.sub(r"[^A-Za-z0-9]", "", content.name.title()) or "Scene"
        root = ET.Element(
            "commonRoad",
            {"commonRoadVersion": "2020a", "benchmarkID": f"ZAM_{name}-1_1_T-1", "timeStepSize": f"{STEP_S:g}"}
            | {"author": "LitSim", "affiliation": "", "date": f"{datetime.now(UTC):%Y-%m-%d}"}
            | {"source": "; ".join(filter(None, (content.source, content.licence))) or "LitSim"},
        )
        place = add(root, "location")
        add(place, "geoNameId", -999), add(place, "gpsLatitude", 999), add(place, "gpsLongitude", 999)
        add(root, "scenarioTags/simulated")
        ids = count(1)
        begin = 0 if content.table is None else content.free_from - int(content.table["frame"].min())
        _add_lanes(root, content.lanes(), content.signals, begin, ids)
        lines: list[str] = []
        if content.table is not None:
            table = content.table[content.table["frame"] >= content.free_from]
            lines = [replace(content, table=table).counts]
            lines += _add_obstacles(root, table.assign(step=table["frame"] - content.free_from), content.ego, ids)
        write_xml(root, out)
        return lines


def _add_lanes(root: ET.Element, lane_map: LaneMap, signals: Signals | None, begin: int, ids: count[int]) -> None:
    """Adds lanelets, their speed limits, lights from step `begin` on, and the intersections of their net."""
    lanes = lane_map.lanes
    number = {lane.id: next(ids) for lane in lanes}
    limits = {limit: next(ids) for limit in sorted({lane.speed_limit for lane in lanes})}
    lights: dict[tuple[int, str], int] = {}
    before: dict[str, list[int]] = defaultdict(list)
    held_by: dict[str, set[int]] = defaultdict(set)
    for lane in lanes:
        for name in lane.successors:
            before[name].append(number[lane.id])
    for link, group in zip(signals.links, signals.link_group.tolist(), strict=True) if signals is not None else ():
        light = lights.setdefault((group, turn(link.exit_heading - link.heading, TURN)), next(ids))
        held_by[link.from_lane].add(light)
    for lane in lanes:
        lanelet = add(root, "lanelet", id=number[lane.id])
        for side, bound in zip(("leftBound", "rightBound"), around(lane.centerline, lane.width), strict=True):
            parent = add(lanelet, side)
            for point in bound:
                _add_point(parent, point)
        after = [number[name] for name in lane.successors]
        _add_refs(lanelet, predecessor=before[lane.id], successor=after)
        for tag, neighbour in (("adjacentLeft", lane.left), ("adjacentRight", lane.right)):
            if neighbour is not None:
                add(lanelet, tag, ref=number[neighbour], drivingDir="same")
        add(lanelet, "laneletType", "intersection" if lane.is_internal else "unknown")
        _add_refs(lanelet, trafficSignRef=[limits[lane.speed_limit]], trafficLightRef=sorted(held_by[lane.id]))
    for limit, sign in limits.items():
        element = add(add(root, "trafficSign", id=sign), "trafficSignElement")
        add(element, "trafficSignID", 274), add(element, "additionalValue", f"{limit:.{DIGITS}g}")
    if signals is not None:
        for (group, way), light in lights.items():
            element = add(root, "trafficLight", id=light)
            states = signals.states[group, begin:].tolist()
            _add_cycle(element, [COLOURS.get(SignalState(state), "inactive") for state in states])
            add(element, "direction", way)
    _add_intersections(root, lanes, number, ids)


def _add_refs(parent: ET.Element, **refs: Iterable[int]) -> None:
    """Adds elements that refer to others by their ids."""
    for tag, numbers in refs.items():
        for number in numbers:
            add(parent, tag, ref=number)


def _add_cycle(light: ET.Element, colours: list[str]) -> None:
    """Adds the colours of all steps as one cycle, which begins anew only after them."""
    cycle = add(light, "cycle")
    for colour, steps in groupby(colours):
        element = add(cycle, "cycleElement")
        add(element, "duration", len([*steps])), add(element, "color", colour)


def _add_intersections(root: ET.Element, lanes: tuple[Lane, ...], number: dict[str, int], ids: count[int]) -> None:
    """Adds the intersections: by junction and edge that leads into it, the lanes from there to the other side."""
    inside = {lane.id: lane for lane in lanes if lane.is_internal}
    by_junction: dict[str, dict[str, list[Lane]]] = defaultdict(lambda: defaultdict(list))
    for lane in lanes:
        if not lane.is_internal and (first := next((name for name in lane.successors if name in inside), None)):
            by_junction[inside[first].junction][lane.edge_id].append(lane)
    for edges in by_junction.values():
        intersection = add(root, "intersection", id=next(ids))
        for members in edges.values():
            incoming = add(intersection, "incoming", id=next(ids))
            _add_refs(incoming, incomingLanelet=[number[lane.id] for lane in members])
            ways: dict[str, list[int]] = {"right": [], "straight": [], "left": []}
            for name in dict.fromkeys(name for lane in members for name in lane.successors if name in inside):
                ways[turn_of(inside[name].centerline, TURN)].append(number[name])
            _add_refs(incoming, **{f"successors{way.title()}": numbers for way, numbers in ways.items()})


def _add_obstacles(root: ET.Element, table: pd.DataFrame, ego: int | None, ids: count[int]) -> list[str]:
    """Adds the agents as obstacles and the ego as planning problem; returns lines on what is left out."""
    first_id, short = next(ids), 0
    problem = None
    for vehicle, track in table.groupby("vehicle_id"):
        if vehicle == ego:
            problem = track
        elif len(track) < 2:
            short += 1
        else:
            obstacle = add(root, "dynamicObstacle", id=first_id + int(track["vehicle_id"].iloc[0]))
            add(obstacle, "type", Kind(int(track["kind"].iloc[0])).name.lower())
            shape = add(obstacle, "shape/rectangle")
            for size in ("length", "width"):
                add(shape, size, f"{track[size].iloc[0]:.{DIGITS}f}")
            states = track[["step", "x", "y", "yaw", "speed", "acceleration"]].itertuples(index=False)
            _add_state(add(obstacle, "initialState"), *next(states))
            trajectory = add(obstacle, "trajectory")
            for state in states:
                _add_state(add(trajectory, "state"), *state)
    if problem is not None:
        _add_problem(add(root, "planningProblem", id=first_id), problem)
    return [f"{short} agents are left out: they are there for one step only"] if short else []


def _add_problem(problem: ET.Element, track: pd.DataFrame) -> None:
    """Adds the first state of the ego, and as its goal the place where its track ends."""
    begin, end = track.iloc[0], track.iloc[-1]
    state = add(problem, "initialState")
    _add_state(state, int(begin["step"]), *(float(begin[name]) for name in ("x", "y", "yaw", "speed", "acceleration")))
    add(state, "yawRate/exact", 0), add(state, "slipAngle/exact", 0)
    goal = add(problem, "goalState")
    time = add(goal, "time")
    add(time, "intervalStart", int(begin["step"])), add(time, "intervalEnd", int(end["step"]))
    area = add(goal, "position/rectangle")
    add(area, "length", GOAL[0]), add(area, "width", GOAL[1]), add(area, "orientation", f"{end['yaw']:.{DIGITS}f}")
    _add_point(area, end[["x", "y"]].to_numpy(np.float64), "center")


def _add_state(
    parent: ET.Element, step: int, x: float, y: float, yaw: float, speed: float, acceleration: float
) -> None:
    _add_point(add(parent, "position"), np.array([x, y]))
    values = {"orientation": yaw, "velocity": speed, "acceleration": acceleration}
    add(parent, "time/exact", step)
    for tag, value in values.items():
        add(parent, f"{tag}/exact", f"{value:.{DIGITS}f}")


def _add_point(parent: ET.Element, place: FloatArray, tag: str = "point") -> None:
    point = add(parent, tag)
    add(point, "x", f"{place[0]:.{DIGITS}f}"), add(point, "y", f"{place[1]:.{DIGITS}f}")
