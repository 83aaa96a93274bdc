"""OpenSCENARIO XML 1.x: entities that stand, drive on or follow trajectories at given times, on an OpenDRIVE map."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.sources.openscenario.positions import Track
from litsim_data.sources.openscenario.script import Script
from litsim_data.sources.openscenario.xml import UnreadError, box_of, entity_in, read_scenario
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.io.input_files import read_head
from litsim_sim.scenario.recording import BOUNDS

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
ROWS_MAX = 5_000_000
NAMED = 5  # most entities that a line names


class OpenScenario(Source):
    """Entities from Init to the end; those who do what is not read are left out, and named."""

    content = "an OpenSCENARIO file (XML)"
    licence = "that of whoever made the scenario"
    citation = "ASAM OpenSCENARIO XML"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        head = read_head(path)
        return b"<OpenSCENARIO" in head and b"<Catalog " not in head

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        try:
            root = read_scenario(path)
        except UnreadError as error:
            raise InputError(f"{path}: {error}") from error
        named = root.find("RoadNetwork/LogicFile")
        road = lanes or (None if named is None else path.parent / named.get("filepath", ""))
        table, notes = _table(Script(root, road), path)
        tracks = LoadedTable.of(path, table)
        mapping = tracks.meaning(KINDS, accept=["speed", "heading", "side", "size"])
        ego = next((name for name in table["vehicle_id"].unique() if name.lower() == "ego"), None)
        name = path.name.split(".")[0]
        yield Scene(name, tracks, mapping, partial(_road, path, road), f"{name}_net", ego=ego, notes=notes)


def _road(path: Path, road: Path | None) -> Path:
    """Returns the OpenDRIVE map of the scenario."""
    if road is None or not road.is_file():
        what = "names no LogicFile" if road is None else f"names {road}, which is no file"
        raise InputError(f"{path}: element RoadNetwork {what}: name the OpenDRIVE map by --map")
    return road


def _table(script: Script, path: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Returns rows of all entities that can be moved, and sentences on what is not read.

    Raises:
        InputError: none can be moved, or there are too many rows.
    """
    total = len(script.entities)
    if script.end * total / STEP_S > ROWS_MAX:
        raise InputError(f"{path}: {total} entities for {script.end:g} s are more than {ROWS_MAX} rows")
    parts, left_out = [], []
    for name, element in script.entities.items():
        try:
            parts.append(_rows(name, element, script))
        except ValueError as error:
            left_out.append(f"{name}: {error}")
    named = "; ".join(left_out[:NAMED]) + (f"; and {len(left_out) - NAMED} more" if len(left_out) > NAMED else "")
    lines = [f"{len(left_out)} of {total} entities are left out: {named}"] if left_out else []
    if not parts:
        raise InputError(f"{path}: holds no entity that is read; {lines[0] if lines else 'it has none'}")
    if script.end <= 0.0:
        raise InputError(
            f"{path}: nothing says when it ends, neither a StopTrigger by time nor a trajectory with times"
            f"{''.join(f'; {note}' for note in script.notes)}"
        )
    return pd.concat(parts, ignore_index=True), (*lines, *script.notes)


def _rows(name: str, scenario_object: ET.Element, script: Script) -> pd.DataFrame:
    """Returns the rows of an entity, as centres of its box.

    Raises:
        ValueError: the entity, or something that moves it, is not read.
    """
    entity = entity_in(scenario_object)
    if entity.tag == "CatalogReference":  # else the entry stands in its place
        entry, catalog = entity.get("entryName"), entity.get("catalogName")
        raise UnreadError(f"entry {entry} of catalog {catalog} is in no folder of element CatalogLocations")
    kind = entity.get(f"{entity.tag[:1].lower()}{entity.tag[1:]}Category", "none")
    if kind not in KINDS:
        raise UnreadError(f"element {entity.tag} of category {kind} is not simulated")
    ahead, left, *given = box_of(scenario_object)
    sizes = dict(zip(("length", "width"), given, strict=True))
    for side, value in sizes.items():
        if not 0.0 < value <= BOUNDS[side][1]:
            raise UnreadError(f"element Dimensions: {side} is {value:g}, expected at most {BOUNDS[side][1]:g} m")
    track: Track = script.track(name)
    x, y, yaw = track.poses.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    place = {"time": track.times, "x": x + ahead * cos - left * sin, "y": y + ahead * sin + left * cos, "yaw": yaw}
    return pd.DataFrame({"vehicle_id": name, **place, "acceleration": _acceleration(track), "kind": kind, **sizes})


def _acceleration(track: Track) -> FloatArray:
    """Returns the accelerations (n,) [m/s2] of a track, within those of recordings: scripts start and stop at once."""
    if len(track.times) < 2:
        return np.zeros(len(track.times))
    speed = np.hypot(*np.gradient(track.poses[:, :2], STEP_S, axis=0).T)
    return np.gradient(speed, STEP_S).clip(*BOUNDS["acceleration"])
