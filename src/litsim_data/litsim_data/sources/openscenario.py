"""OpenSCENARIO XML 1.x: trajectories in time (FollowTrajectoryAction) on an OpenDRIVE map."""

from __future__ import annotations

import copy
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.input_files import read_head, read_xml

CONTENT = "OpenSCENARIO file"
KINDS = {
    "car": "car",
    "van": "car",
    "truck": "truck",
    "bus": "truck",
    "semitrailer": "truck",
    "trailer": "truck",
    "motorbike": "motorcycle",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
    "wheelchair": "pedestrian",
}
"""Our kinds of vehicleCategory and pedestrianCategory; others, such as trams and animals, are left out."""
ACTION = ".//FollowTrajectoryAction"
Vertex = tuple[float, float, float, float]
"""Time [s], x, y [m] and heading [rad]."""
NEEDED = "FollowTrajectoryAction with Timing, and with a Polyline of which each vertex has a WorldPosition"


class OpenScenario(Source):
    """Polylines of world positions with times; what else entities do is not simulated, and counted."""

    content = "an OpenSCENARIO file (XML) with trajectories in time"
    licence = "that of whoever made the scenario"
    citation = "ASAM OpenSCENARIO XML"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        head = read_head(path)
        return b"<OpenSCENARIO" in head and b"<Catalog " not in head

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        root = read_xml(path, CONTENT)
        _fill_in(root, {})
        rows, left_out = _rows(root, path)
        tracks = LoadedTable.of(path, rows)
        mapping = tracks.meaning(KINDS, accept=["heading", "side", "size"])
        ego = next((name for name in dict.fromkeys(rows["vehicle_id"]) if name.lower() == "ego"), None)
        notes = tuple(f"{count} {what} are left out" for what, count in sorted(left_out.items()))
        named = root.find("RoadNetwork/LogicFile")
        road = lanes or (None if named is None else path.parent / named.get("filepath", ""))
        name = path.name.split(".")[0]
        yield Scene(name, tracks, mapping, partial(_road, path, road), f"{name}_net", ego=ego, notes=notes)


def _road(path: Path, road: Path | None) -> Path:
    """Returns the OpenDRIVE map of the scenario."""
    if road is None or not road.is_file():
        what = "names no LogicFile" if road is None else f"names {road}, which is no file"
        raise InputError(f"{path}: element RoadNetwork {what}: name the OpenDRIVE map by --map")
    return road


def _rows(root: ET.Element, path: Path) -> tuple[dict[str, list[Any]], Counter[str]]:
    """Returns the columns of all vertices, as centres of boxes, and the numbers of what is left out."""
    entities = {one.get("name", ""): one for one in root.findall("Entities/ScenarioObject")}
    catalogs, left_out = _catalogs(root, path), Counter[str]()
    rows: dict[str, list[Any]] = defaultdict(list)
    for name, action, start in ((name, action, start) for names, action, start in _actions(root) for name in names):
        try:
            kind, length, width, shift_x, shift_y = _entity(entities[name], catalogs)
            vertices = _vertices(action, start)
        except KeyError as error:
            raise InputError(
                f"{path}: entity {name}: {error} is not in the file, nor in its CatalogLocations"
            ) from error
        except ValueError as error:
            raise InputError(f"{path}: trajectory of {name}: {error}") from error
        if kind not in KINDS:
            left_out[f"entities of category {kind or 'none'}"] += 1
            continue
        if not vertices:
            left_out["trajectories without times, or not of world positions,"] += 1
        for time, x, y, h in vertices:
            cos, sin = math.cos(h), math.sin(h)
            rows["x"].append(x + shift_x * cos - shift_y * sin)
            rows["y"].append(y + shift_x * sin + shift_y * cos)
            fixed = {"vehicle_id": name, "time": time, "yaw": h, "kind": kind, "length": length, "width": width}
            for column, value in fixed.items():
                rows[column].append(value)
    left_out["entities without a trajectory in time"] += len(entities.keys() - {*rows["vehicle_id"]})
    if not rows["vehicle_id"]:
        raise InputError(f"{path}: no {NEEDED}; left out are {dict(+left_out)}")
    return rows, +left_out


def _actions(root: ET.Element) -> Iterator[tuple[list[str], ET.Element, float | None]]:
    """Yields the actors and the action of each trajectory, and when it starts [s]; None where that is not a time."""
    for private in root.findall("Storyboard/Init/Actions/Private"):
        for action in private.findall(ACTION):
            yield [private.get("entityRef", "")], action, 0.0
    for group in root.iter("ManeuverGroup"):
        actors = [actor.get("entityRef", "") for actor in group.findall("Actors/EntityRef")]
        for event in group.iter("Event"):
            conditions = event.findall("StartTrigger/ConditionGroup/Condition")
            times = [one.find("ByValueCondition/SimulationTimeCondition") for one in conditions]
            known = len(times) == 1 and times[0] is not None
            for action in event.findall(ACTION):
                yield actors, action, float(times[0].get("value", "nan")) if known and times[0] is not None else None


def _vertices(action: ET.Element, start: float | None) -> list[Vertex]:
    """Returns time [s], x, y [m] and heading [rad] of a trajectory of world positions; none of other trajectories.

    Where no heading is given it is that of the way, and the way between vertices is straight, as the standard says.
    """
    timing, line = action.find("TimeReference/Timing"), action.find(".//Trajectory/Shape/Polyline")
    if timing is None or line is None:
        return []
    relative = timing.get("domainAbsoluteRelative") == "relative"
    places = [vertex.find("Position/WorldPosition") for vertex in line.findall("Vertex")]
    if (relative and start is None) or None in places:
        return []
    zero, scale = _number(timing, "offset") + (start or 0.0) * relative, _number(timing, "scale")
    times = [zero + scale * _number(vertex, "time") for vertex in line.findall("Vertex")]
    points = [(_number(place, "x"), _number(place, "y")) for place in places if place is not None]
    ahead = [math.atan2(b[1] - a[1], b[0] - a[0]) if a != b else None for a, b in pairwise(points)]
    course = next((angle for angle in ahead if angle is not None), 0.0)
    headings = []
    for place, angle in zip(places, [*ahead, None], strict=True):
        course = course if angle is None else angle  # one that stands looks where it last went
        given = place is not None and place.get("h") is not None
        headings.append(_number(place, "h") if given and place is not None else course)
    vertices = [(time, *point, heading) for time, point, heading in zip(times, points, headings, strict=True)]
    between = [_between(one, other) for one, other in pairwise(vertices)]
    return [vertex for one, inner in zip(vertices, [*between, []], strict=True) for vertex in (one, *inner)]


def _between(one: Vertex, other: Vertex) -> list[Vertex]:
    """Returns poses on the straight way from a vertex to the next one, every 0.1 s or less, without both ends."""
    count = math.ceil(round((other[0] - one[0]) / STEP_S, 6))
    turned = float(wrap_angle(np.array(other[3] - one[3])))
    way = (other[0] - one[0], other[1] - one[1], other[2] - one[2], turned)
    shares = [k / count for k in range(1, count)]
    return [tuple(value + share * part for value, part in zip(one, way, strict=True)) for share in shares]  # type: ignore[misc]


def _entity(
    scenario_object: ET.Element, catalogs: Mapping[tuple[str, str], ET.Element]
) -> tuple[str, float, float, float, float]:
    """Returns category, length, width, and centre (x, y) of the box before the reference point [m], of an entity.

    Raises:
        KeyError: it is an entry of a catalog which is not there.
        ValueError: it has no box, or one that is not given in numbers.
    """
    entity = next((one for one in scenario_object if one.tag != "ObjectController"), scenario_object)
    assigned: dict[str, str] = {}
    if entity.tag == "CatalogReference":
        assignments = entity.findall("ParameterAssignments/ParameterAssignment")
        assigned = {one.get("parameterRef", ""): one.get("value", "") for one in assignments}
        entity = copy.deepcopy(catalogs[entity.get("catalogName", ""), entity.get("entryName", "")])
    _fill_in(entity, assigned)
    kind = entity.get(f"{entity.tag[:1].lower()}{entity.tag[1:]}Category", "")
    centre, size = entity.find("BoundingBox/Center"), entity.find("BoundingBox/Dimensions")
    if centre is None or size is None:
        raise ValueError("its entity has no BoundingBox")
    return kind, _number(size, "length"), _number(size, "width"), _number(centre, "x"), _number(centre, "y")


def _fill_in(element: ET.Element, assigned: Mapping[str, str]) -> None:
    """Puts values in place of parameters, within an element: those that are assigned, or else as it declares them."""
    declared = element.findall("ParameterDeclarations/ParameterDeclaration")
    values = {one.get("name", ""): one.get("value", "") for one in declared} | {**assigned}
    for one in element.iter():
        one.attrib |= {name: values.get(text[1:], text) for name, text in one.attrib.items() if text[:1] == "$"}


def _catalogs(root: ET.Element, path: Path) -> Mapping[tuple[str, str], ET.Element]:
    """Returns the entries of the catalogs in the folders that a scenario names, by catalog and entry."""
    entries: dict[tuple[str, str], ET.Element] = {}
    for directory in root.findall("CatalogLocations/*/Directory"):
        for file in sorted((path.parent / directory.get("path", "")).glob("*.xosc")):
            for catalog in read_xml(file, CONTENT).findall("Catalog"):
                entries |= {(catalog.get("name", ""), entry.get("name", "")): entry for entry in catalog}
    return entries


def _number(element: ET.Element, name: str) -> float:
    """Returns an attribute that is a number; a ValueError says which is none."""
    text = element.get(name)
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"attribute {name} of element {element.tag} is {text!r}, expected a number")
    return value
