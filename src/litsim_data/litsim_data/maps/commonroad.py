"""CommonRoad lanelet maps (XML of the 2018b and 2020a formats), read by our own code."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from xml.etree import ElementTree as ET

from litsim_data.maps.lane_graph import SPEED_LIMIT, TURNS, LaneGraph, Lanelet, polyline
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import read_xml

SPEED_MIN = 1.0  # [m/s] smaller "limits" are defects of a map
NO_ROADS = {"crosswalk", "sidewalk", "bicycleLane"}  # types of lanelets that no vehicle uses


def read_root(path: Path) -> ET.Element:
    """Returns the root element of a CommonRoad file.

    Raises:
        InputError: the file is missing, no XML, or something else.
    """
    root = read_xml(path, "CommonRoad file")
    if root.tag != "commonRoad":
        raise InputError(f"{path}: not a CommonRoad file: its root element is <{root.tag}>")
    return root


def read_graph(root: ET.Element, path: Path) -> LaneGraph:
    """Returns the lanelets of a CommonRoad file that vehicles use; `path` names it in errors.

    Raises:
        InputError: there are none, or one is malformed.
    """
    limits = _speed_limits(root)
    inside = {
        name
        for incoming in root.findall("intersection/incoming")
        for kind in ("successorsRight", "successorsStraight", "successorsLeft")
        for name in _refs(incoming, kind)
    }
    lanelets, ignored = [], Counter[str]()
    for element in root.findall("lanelet"):
        name = element.get("id", "")
        types = {child.text or "" for child in element.findall("laneletType")}
        if types & NO_ROADS:
            ignored[min(types & NO_ROADS)] += 1
            continue
        signs = [limits[sign] for sign in _refs(element, "trafficSignRef") if sign in limits]
        try:
            lanelet = Lanelet(
                id=name,
                left=_bound(element, "leftBound"),
                right=_bound(element, "rightBound"),
                successors=tuple(_refs(element, "successor")),
                left_id=_neighbour(element, "adjacentLeft"),
                right_id=_neighbour(element, "adjacentRight"),
                speed_limit=min(signs, default=SPEED_LIMIT),
                lights=tuple(_refs(element, "trafficLightRef")),
                junction=name in inside or "intersection" in types,
                predecessors=tuple(_refs(element, "predecessor")),
            )
        except (ValueError, AttributeError, TypeError) as error:
            raise InputError(f"{path}: lanelet {name or '?'}: {error}") from error
        lanelets.append(lanelet)
    if not lanelets:
        raise InputError(f"{path}: no lanelets")
    notes = [f"{count} lanelets of type {kind} are no lanes of vehicles" for kind, count in sorted(ignored.items())]
    directions = {
        light.get("id", ""): light.findtext("direction", "").lower() for light in root.findall("trafficLight")
    }
    turns = {
        light: tuple(turn for turn in TURNS if turn in direction)
        for light, direction in directions.items()
        if direction not in ("", "all")
    }
    return LaneGraph(tuple(lanelets), notes=tuple(notes), turns=turns)


def _bound(element: ET.Element, name: str) -> FloatArray:
    points = element.findall(f"{name}/point")
    axes = "xyz" if points and all(point.find("z") is not None for point in points) else "xy"
    return polyline([[float(point.findtext(axis, "")) for axis in axes] for point in points], name)


def _refs(element: ET.Element, name: str) -> list[str]:
    return [child.get("ref", "") for child in element.findall(name)]


def _neighbour(element: ET.Element, name: str) -> str | None:
    child = element.find(name)
    return child.get("ref") if child is not None and child.get("drivingDir") == "same" else None


def _speed_limits(root: ET.Element) -> dict[str, float]:
    """Returns the speed limits [m/s] by the id of their sign."""
    limits = {}
    for sign in root.findall("trafficSign"):
        for value in sign.iter("additionalValue"):
            try:
                limit = float(value.text or "")
            except ValueError:
                continue
            if limit > SPEED_MIN:
                limits[sign.get("id", "")] = limit
    return limits
