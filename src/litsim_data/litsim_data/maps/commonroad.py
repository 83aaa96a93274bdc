"""CommonRoad lanelet maps (XML of the 2018b and 2020a formats), read by our own code."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.lanelets import SPEED_LIMIT, Lanelet
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray

SPEED_MIN = 1.0  # [m/s] smaller "limits" are defects of a map


def read_lanelets(path: Path) -> list[Lanelet]:
    """Returns the lanelets of a CommonRoad file.

    Raises:
        InputError: the file is missing, no XML, or a lanelet is malformed.
    """
    try:
        root = ET.parse(path).getroot()  # noqa: S314  a map that the user names, read by a parser without network access
    except (OSError, ET.ParseError) as error:
        raise InputError(f"{path}: not a readable CommonRoad file: {error}") from error
    if root.tag != "commonRoad":
        raise InputError(f"{path}: not a CommonRoad file: its root element is <{root.tag}>")
    limits = _speed_limits(root)
    inside = {
        name
        for incoming in root.findall("intersection/incoming")
        for kind in ("successorsRight", "successorsStraight", "successorsLeft")
        for name in _refs(incoming, kind)
    }
    lanelets = []
    for element in root.findall("lanelet"):
        name = element.get("id", "")
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
                signal=element.find("trafficLightRef") is not None,
                junction=name in inside,
            )
        except (ValueError, AttributeError, TypeError) as error:
            raise InputError(f"{path}: lanelet {name or '?'}: {error}") from error
        lanelets.append(lanelet)
    if not lanelets:
        raise InputError(f"{path}: no lanelets")
    return lanelets


def _bound(element: ET.Element, name: str) -> FloatArray:
    points = element.findall(f"{name}/point")
    values = np.array([[float(point.findtext(axis, "")) for axis in ("x", "y")] for point in points], np.float64)
    if values.ndim != 2 or len(values) < 2 or not np.isfinite(values).all():
        raise ValueError(f"{name} has {len(points)} points, expected at least 2 with finite x and y")
    return values


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
