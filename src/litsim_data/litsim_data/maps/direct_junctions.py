"""Direct junctions of OpenDRIVE 1.7, whose roads follow each other, as junctions with connecting roads."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from math import cos, sin
from typing import NamedTuple
from xml.etree import ElementTree as ET

SHORT = 0.1  # [m] of a connecting road


class _Contact(NamedTuple):
    """A road that a connection of a junction joins, at its start or its end, and its lanes there."""

    road: ET.Element
    at: str
    lanes: list[str]


def with_connecting_roads(root: ET.Element) -> None:
    """Gives direct junctions connecting roads of SHORT, in place, which netconvert reads.

    Raises:
        ValueError: a connection joins two roads at their ends, or lacks something; the text says which.
    """
    roads = {road.get("id"): road for road in root.findall("road")}
    numbers = (str(number) for number in count(1) if str(number) not in {*roads})
    for junction in root.findall("junction[@type='direct']"):
        del junction.attrib["type"]
        made = [_connected(junction, connection, roads, numbers) for connection in junction.findall("connection")]
        junction[:] = [part for part in junction if part.tag != "connection"]
        for number, (road, connections) in enumerate(made):
            root.insert(list(root).index(junction), road)
            for index, connection in enumerate(connections):
                connection.set("id", str(2 * number + index))
                junction.append(connection)


def _connected(
    junction: ET.Element, connection: ET.Element, roads: dict[str | None, ET.Element], numbers: Iterator[str]
) -> tuple[ET.Element, list[ET.Element]]:
    """Returns the connecting road of a connection, and the connections over it in both directions."""
    where = f"connection {connection.get('id')} of the direct junction {junction.get('id')}"
    incoming, linked = roads.get(connection.get("incomingRoad")), roads.get(connection.get("linkedRoad"))
    links = connection.findall("laneLink")
    if incoming is None or linked is None or not links:
        raise ValueError(f"{where} lacks incomingRoad, linkedRoad or laneLink")
    before = incoming.findall("link/predecessor[@elementType='junction']")
    begins = any(link.get("elementId") == junction.get("id") for link in before)
    into = _Contact(linked, connection.get("contactPoint", ""), [link.get("to", "") for link in links])
    out_of = _Contact(incoming, "start" if begins else "end", [link.get("from", "") for link in links])
    starting = next((contact for contact in (into, out_of) if contact.at == "start"), None)
    if starting is None:
        raise ValueError(f"{where} joins two roads at their ends, expected the start of one of them")
    other = out_of if starting is into else into
    road = _connecting_road(next(numbers), junction, other, starting)
    connections = []
    for contact, end, outwards in ((other, "start", True), (starting, "end", False)):
        lanes = zip(contact.lanes, starting.lanes, strict=True)
        if over := [pair for pair in lanes if pair[1].startswith("-") == outwards]:
            connections.append(_connection(contact, road, end, over))
    return road, connections


def _connection(contact: _Contact, road: ET.Element, end: str, lanes: list[tuple[str, str]]) -> ET.Element:
    """Returns a connection that comes from a road over the lanes of the connecting one."""
    ends = {"incomingRoad": contact.road.get("id", ""), "connectingRoad": road.get("id", ""), "contactPoint": end}
    connection = ET.Element("connection", ends)
    for own, over in lanes:
        ET.SubElement(connection, "laneLink", {"from": own, "to": over})
    return connection


def _connecting_road(number: str, junction: ET.Element, before: _Contact, after: _Contact) -> ET.Element:
    """Returns a road that ends where `after` starts, with the lanes that it has there."""
    first, section = after.road.find("planView/geometry"), after.road.find("lanes/laneSection")
    if first is None or section is None:
        raise ValueError(f"road {after.road.get('id')} lacks geometry or laneSection")
    road = ET.Element("road", {"name": "", "length": str(SHORT), "id": number, "junction": junction.get("id", "")})
    if (rule := after.road.get("rule")) is not None:
        road.set("rule", rule)
    link = ET.SubElement(road, "link")
    for tag, contact in (("predecessor", before), ("successor", after)):
        to = {"elementType": "road", "elementId": contact.road.get("id", ""), "contactPoint": contact.at}
        ET.SubElement(link, tag, to)
    heading = float(first.get("hdg", 0.0))
    start = {
        "x": float(first.get("x", 0.0)) - SHORT * cos(heading),
        "y": float(first.get("y", 0.0)) - SHORT * sin(heading),
    }
    line = {"s": "0", "hdg": str(heading), "length": str(SHORT)} | {axis: str(value) for axis, value in start.items()}
    ET.SubElement(ET.SubElement(ET.SubElement(road, "planView"), "geometry", line), "line")
    height = after.road.find("elevationProfile/elevation")
    profile = ET.SubElement(road, "elevationProfile")
    if height is not None:
        ET.SubElement(profile, "elevation", _constant(height, "s"))
    lanes = ET.SubElement(road, "lanes")
    if (offset := after.road.find("lanes/laneOffset")) is not None:
        ET.SubElement(lanes, "laneOffset", _constant(offset, "s"))
    joined = dict(zip(after.lanes, before.lanes, strict=True))
    own = ET.SubElement(lanes, "laneSection", {"s": "0"})
    for side in section:
        if side.tag not in {"left", "center", "right"}:
            continue
        group = ET.SubElement(own, side.tag)
        for lane in side.findall("lane"):
            name = lane.get("id", "")
            copy = ET.SubElement(group, "lane", lane.attrib)
            if name in joined:
                refs = ET.SubElement(copy, "link")
                ET.SubElement(refs, "predecessor", {"id": joined[name]})
                ET.SubElement(refs, "successor", {"id": name})
            elif name != "0":
                copy.set("type", "none")
            if (width := lane.find("width")) is not None:
                ET.SubElement(copy, "width", _constant(width, "sOffset"))
    return road


def _constant(polynomial: ET.Element, along: str) -> dict[str, str]:
    """Returns the attributes of a polynomial that keeps the first value of another."""
    return {along: "0", "a": polynomial.get("a", "0"), "b": "0", "c": "0", "d": "0"}
