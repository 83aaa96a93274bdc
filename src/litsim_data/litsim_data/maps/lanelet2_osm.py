"""Lanelet2 maps (OSM XML), read through the ``lanelet2`` package: ``pip install -r requirements/maps.txt``."""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.maps.lanelets import SPEED_LIMIT, Lanelet
from litsim_sim.core.errors import InputError, not_installed
from litsim_sim.core.scene import FloatArray

TURNS = ("left", "right", "straight")
"""Values of the attribute `turn_direction`, which lanelets inside intersections have."""


def read_lanelets(source: Path, origin: tuple[float, float]) -> list[Lanelet]:
    """Returns the lanelets of a Lanelet2 file that vehicles may use, in metres from `origin`.

    Raises:
        InputError: the lanelet2 package is missing, or `source` cannot be used.
    """
    io, projection, routing, traffic_rules = _modules()
    if not source.is_file():
        raise InputError(f"{source}: no such Lanelet2 file")
    latitude, longitude = origin
    if not (-90.0 <= latitude <= 90.0 and -180.0 <= longitude <= 180.0):
        raise InputError(f"--origin {latitude} {longitude}: expected degrees of latitude and longitude")
    try:
        projector = projection.UtmProjector(io.Origin(latitude, longitude))
        lanelet_map = io.load(str(source), projector)
    except RuntimeError as error:
        raise InputError(f"{source}: not a readable Lanelet2 file: {_why(str(error), origin)}") from error
    rules = traffic_rules.create(traffic_rules.Locations.Germany, traffic_rules.Participants.Vehicle)
    graph = routing.RoutingGraph(lanelet_map, rules)
    lanelets = [_lanelet(raw, graph, rules) for raw in lanelet_map.laneletLayer if rules.canPass(raw)]
    if not lanelets:
        roads = sum("highway" in line.attributes for line in lanelet_map.lineStringLayer)
        plain = f"; it has {roads} ways with tag highway, as OpenStreetMap, which does not say where lanes lie"
        raise InputError(f"{source}: no lanelets that vehicles may use{plain if roads else ''}")
    if not all(np.isfinite(lanelet.centerline).all() for lanelet in lanelets):
        raise InputError(f"{source}: bounds are not finite: is --origin within the map's UTM zone?")
    return lanelets


def _why(error: str, origin: tuple[float, float]) -> str:
    """Returns the text of an error of the lanelet2 package, which has a line for each node of the file, in one line."""
    lines = error.splitlines()
    text = " ".join(" ".join(lines[:2]).split()) + (f"; {len(lines) - 2} more such lines" if len(lines) > 2 else "")
    question = f"; is --origin {origin[0]:g} {origin[1]:g}, latitude and longitude, near the map?"
    return text + (question if "UTM zone" in text else "")


def _modules() -> tuple[Any, Any, Any, Any]:
    names = ("io", "projection", "routing", "traffic_rules")
    try:
        importlib.import_module("lanelet2.core")  # the types that the others hand over
        io, projection, routing, traffic_rules = (importlib.import_module(f"lanelet2.{name}") for name in names)
    except ImportError as error:
        raise not_installed("lanelet2") from error
    return io, projection, routing, traffic_rules


def _lanelet(raw: Any, graph: Any, rules: Any) -> Lanelet:
    left, right = graph.left(raw) or graph.adjacentLeft(raw), graph.right(raw) or graph.adjacentRight(raw)
    limit = float(rules.speedLimit(raw).speedLimitMPS)
    attributes = raw.attributes
    turn = attributes["turn_direction"] if "turn_direction" in attributes else ""  # noqa: SIM401  an AttributeMap has no get
    return Lanelet(
        id=str(raw.id),
        left=_points(raw.leftBound),
        right=_points(raw.rightBound),
        successors=tuple(str(other.id) for other in graph.following(raw)),
        left_id=None if left is None else str(left.id),
        right_id=None if right is None else str(right.id),
        speed_limit=limit if limit > 0.0 and math.isfinite(limit) else SPEED_LIMIT,
        signal=any("TrafficLight" in type(element).__name__ for element in raw.regulatoryElements),
        junction=turn in TURNS,
    )


def _points(bound: Any) -> FloatArray:
    return np.array([[point.x, point.y] for point in bound], np.float64)
