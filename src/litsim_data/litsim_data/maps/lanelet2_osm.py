"""Lanelet2 maps (OSM XML), read through the ``lanelet2`` package: ``pip install -r requirements/maps.txt``.

That package refuses a whole file for what it does not know. Here such parts are taken out of the file before it reads
it: regulatory elements beyond its own, areas, and borders that are chains of ways, which are joined.
"""

from __future__ import annotations

import importlib
import math
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.generic.geography import meridian_of, utm
from litsim_data.maps.lane_graph import SPEED_LIMIT, TURNS, LaneGraph, Lanelet
from litsim_data.maps.map_projector import PROJECTOR_FILE, located
from litsim_sim.core.errors import InputError, not_installed
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import read_xml

RULES = ("all_way_stop", "right_of_way", "speed_limit", "traffic_light", "traffic_sign")
"""Subtypes of regulatory elements that the package knows."""
LOCAL = ("local_x", "local_y")
"""Tags of nodes with coordinates in metres, which Autoware reads instead of latitude and longitude."""
PARTS = ("core", "io", "projection", "routing", "traffic_rules")
"""Modules of the package that are used."""
ANYWHERE = (49.0, 8.4)
"""Latitude and longitude [deg] that stand for (0, 0) of coordinates in metres within the package."""


def read_graph(source: Path, origin: tuple[float, float] | None) -> LaneGraph:
    """Returns the lanelets of a Lanelet2 file that vehicles may use.

    Args:
        source: the file.
        origin: latitude and longitude [deg] of (0, 0), from which x and y are metres in UTM; None for maps with
            coordinates in metres (:data:`LOCAL`), or with a file beside them that says how Autoware finds these.

    Raises:
        InputError: the lanelet2 package is missing, `source` cannot be used, or an origin is needed.
    """
    root = read_xml(source, "Lanelet2 file")
    nodes = root.findall("node")
    metres = located(nodes, source) if origin is None else None
    if metres is None and nodes and all(_tag(node, name) is not None for node in nodes for name in LOCAL):
        places = {(node.get("lat"), node.get("lon")) for node in nodes}
        metres = [_metres(node, source) for node in nodes] if origin is None or len(places) == 1 else None
    if origin is None and metres is None:
        raise InputError(
            "data map: --lanelet2 needs --origin LAT LON, the point that becomes (0, 0), or "
            f"{PROJECTOR_FILE} beside the map"
        )
    latitude, longitude = ANYWHERE if metres is not None or origin is None else origin
    if not (-90.0 <= latitude <= 90.0 and -180.0 <= longitude <= 180.0):
        raise InputError(f"--origin {latitude} {longitude}: expected degrees of latitude and longitude")
    core, io, projection, routing, traffic_rules = modules(*PARTS)
    projector = projection.UtmProjector(io.Origin(latitude, longitude))
    for node, (x, y) in zip(nodes, metres or (), strict=metres is not None):  # where the package finds x and y again
        try:
            place = projector.reverse(core.BasicPoint3d(x, y, 0.0))
        except RuntimeError as error:
            raise InputError(f"{source}: node {node.get('id')} at {x:g}, {y:g} m: {error}") from error
        node.attrib |= {"lat": repr(place.lat), "lon": repr(place.lon)}
    notes = [*_without_unknown(root), *_joined_borders(root)]
    if metres is not None and origin is not None:
        notes.append("coordinates are those of the tags local_x and local_y, not --origin: all nodes are at one place")
    try:
        with tempfile.TemporaryDirectory() as scratch:
            ET.ElementTree(root).write(Path(scratch) / "map.osm", encoding="UTF-8", xml_declaration=True)
            lanelet_map = io.load(str(Path(scratch) / "map.osm"), projector)
    except RuntimeError as error:
        raise InputError(f"{source}: not a readable Lanelet2 file: {_why(str(error), origin)}") from error
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    graph = routing.RoutingGraph(lanelet_map, rules)
    ways = [way for raw in lanelet_map.laneletLayer for way in (raw, raw.invert()) if rules.canPass(way)]
    lanelets = tuple(_lanelet(way, graph, rules) for way in ways)
    if not lanelets:
        roads = sum("highway" in line.attributes for line in lanelet_map.lineStringLayer)
        plain = f"; it has {roads} ways with tag highway, as OpenStreetMap, which does not say where lanes lie"
        raise InputError(f"{source}: no lanelets that vehicles may use{plain if roads else ''}")
    read = LaneGraph(lanelets, notes=tuple(notes))
    finite = all(np.isfinite(side).all() for lanelet in lanelets for side in (lanelet.left, lanelet.right))
    if not finite or not all(np.isfinite(lanelet.centerline).all() for lanelet in read.by_id.values()):
        raise InputError(f"{source}: bounds are not finite: is --origin within the map's UTM zone?")
    return read


def _tag(element: ET.Element, key: str) -> str | None:
    return next((tag.get("v") for tag in element.findall("tag") if tag.get("k") == key), None)


def _metres(node: ET.Element, source: Path) -> tuple[float, float]:
    """Returns x and y [m] by the tags of a node."""
    x, y = values = [_tag(node, name) or "" for name in LOCAL]
    try:
        return float(x), float(y)
    except ValueError as error:
        raise InputError(f"{source}: node {node.get('id')}: {' and '.join(LOCAL)} are {values}: {error}") from error


def _without_unknown(root: ET.Element) -> list[str]:
    """Takes areas, and regulatory elements that the package does not know, out of a map; returns lines on them."""
    taken: Counter[str] = Counter()
    gone = set()
    for relation in root.findall("relation"):
        kind, subtype = _tag(relation, "type"), _tag(relation, "subtype") or ""
        what = {"multipolygon": "areas", "regulatory_element": f"regulatory elements {subtype}"}.get(kind or "")
        if what is not None and subtype not in RULES:
            taken[what] += 1
            gone.add(relation.get("id"))
            root.remove(relation)
    for relation in root.findall("relation"):
        for member in relation.findall("member[@type='relation']"):
            if member.get("ref") in gone:
                relation.remove(member)
    return [f"ignored: {count} {what}, which are no lanes" for what, count in sorted(taken.items())]


def _joined_borders(root: ET.Element) -> list[str]:
    """Replaces borders of lanelets that are chains of ways by one way each; returns a line on them."""
    ways = {way.get("id", ""): way for way in root.findall("way")}
    joined: dict[tuple[str, ...], str] = {}
    for relation in root.findall("relation"):
        for role in ("left", "right") if _tag(relation, "type") == "lanelet" else ():
            members = [
                member
                for member in relation.findall("member")
                if member.get("role") == role and member.get("ref") in ways
            ]
            if len(members) < 2:
                continue
            key = tuple(sorted(member.get("ref", "") for member in members))
            chain = _chain([[nd.get("ref", "") for nd in ways[name].findall("nd")] for name in key])
            if chain is None:
                continue  # the package says what is wrong with it
            if key not in joined:
                joined[key] = str(-1_000_000_000 - len(joined))
                way = ET.SubElement(root, "way", {"id": joined[key]})
                way.extend([ET.Element("nd", {"ref": node}) for node in chain])
                way.extend(ways[key[0]].findall("tag"))
            for member in members[1:]:
                relation.remove(member)
            members[0].set("ref", joined[key])
    order = {"node": 0, "way": 1, "relation": 2}
    root[:] = sorted(root, key=lambda element: order.get(element.tag, -1))
    return [f"joined: {len(joined)} borders that are chains of ways"] if joined else []


def _chain(parts: list[list[str]]) -> list[str] | None:
    """Returns the nodes of lines joined end to end; None if they are no chain."""
    chain, left = parts[0], parts[1:]
    while left:
        for part in left:
            ways = ((chain, part), (chain, part[::-1]), (part, chain), (part[::-1], chain))
            if (pair := next((pair for pair in ways if pair[0][-1] == pair[1][0]), None)) is not None:
                chain = [*pair[0], *pair[1][1:]]
                left.remove(part)
                break
        else:
            return None
    return chain


def _why(error: str, origin: tuple[float, float] | None) -> str:
    """Returns the text of an error of the lanelet2 package, which has a line for each node of the file, in one line."""
    lines = error.splitlines()
    text = " ".join(" ".join(lines[:2]).split()) + (f"; {len(lines) - 2} more such lines" if len(lines) > 2 else "")
    if origin is None or "UTM zone" not in text:
        return text
    return f"{text}; is --origin {origin[0]:g} {origin[1]:g}, latitude and longitude, near the map?"


def modules(*names: str) -> list[Any]:
    """Returns modules of the lanelet2 package; raises an InputError if it is not installed."""
    try:
        return [importlib.import_module(f"lanelet2.{name}") for name in names]
    except ImportError as error:
        raise not_installed("lanelet2") from error


def _name(raw: Any) -> str:
    """Returns the id of a lanelet, with a sign before it if it is driven against its direction, as SUMO names edges."""
    return f"{'-' if raw.inverted() else ''}{raw.id}"


def _lanelet(raw: Any, graph: Any, rules: Any) -> Lanelet:
    """Returns a lanelet in the direction in which it is driven; lights hold in the direction of the map alone."""
    left, right = graph.left(raw) or graph.adjacentLeft(raw), graph.right(raw) or graph.adjacentRight(raw)
    limit = float(rules.speedLimit(raw).speedLimitMPS)
    lights = tuple(str(element.id) for element in raw.regulatoryElements if "TrafficLight" in type(element).__name__)
    attributes = raw.attributes
    turn = attributes["turn_direction"] if "turn_direction" in attributes else ""  # noqa: SIM401  an AttributeMap has no get
    return Lanelet(
        id=_name(raw),
        left=_points(raw.leftBound),
        right=_points(raw.rightBound),
        successors=tuple(_name(other) for other in graph.following(raw)),
        left_id=None if left is None else _name(left),
        right_id=None if right is None else _name(right),
        speed_limit=limit if limit > 0.0 and math.isfinite(limit) else SPEED_LIMIT,
        lights=() if raw.inverted() else lights,
        junction=turn in TURNS,  # which lanelets inside intersections have
    )


def _points(bound: Any) -> FloatArray:
    return np.array([[point.x, point.y, point.z] for point in bound], np.float64)


def moved_to_utm(graph: LaneGraph, origin: tuple[float, float], centre: tuple[float, float]) -> LaneGraph:
    """Returns a graph that was read from `origin` (latitude, longitude), with (0, 0) at `centre` (x, y) [m] in UTM."""
    x, y = utm(np.array(origin[0]), np.array(origin[1]), meridian_of(*origin))
    shift = np.array([float(x) - centre[0], float(y) - centre[1], 0.0])
    return replace(
        graph,
        lanelets=tuple(
            replace(lanelet, left=lanelet.left + shift, right=lanelet.right + shift) for lanelet in graph.lanelets
        ),
    )
