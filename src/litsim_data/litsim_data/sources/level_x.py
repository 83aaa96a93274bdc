"""The data sets of levelXdata: highD, and inD, rounD, exiD and uniD, as ``*_tracks.csv`` with two files beside."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.kinds import likely_kind
from litsim_data.generic.mapping import Columns, Mapping
from litsim_data.maps.lane_graph import LaneGraph, Lanelet
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFile, TableFiles, first_cells

CLASS = "class"
HIGHD = Columns(
    vehicle_id="id",
    frame="frame",
    x="x",
    y="y",
    length="width",
    width="height",
    speed=("xVelocity", "yVelocity"),
    kind=CLASS,
)
LEVELX = Columns(
    vehicle_id="trackId",
    frame="frame",
    x="xCenter",
    y="yCenter",
    yaw="heading",
    speed=("xVelocity", "yVelocity"),
    length="length",
    width="width",
    kind=CLASS,
)
ROAD_USERS = {"pedestrian": "pedestrian", "bicycle": "bicycle"}
"""Kinds that a mapping drafted for vehicles drops, and that are kept here."""
LICENCE = "levelXdata: non-commercial use on request; the data must not be passed on"
BEYOND = 100.0  # [m] that the lanes of highD reach beyond the tracks
ADVISED = 36.11  # [m/s] 130 km/h, where there is no limit
MAPS = ("*.osm", "*.xodr")


class HighD(Source):
    """Motorways of two carriageways, whose lanes follow from their markings; y of the file points down."""

    content = "highD (*_tracks.csv)"
    licence = LICENCE
    citation = (
        "Krajewski et al., The highD Dataset: A Drone Dataset of Naturalistic Vehicle Trajectories on German Highways "
        "for Validation of Highly Automated Driving Systems, ITSC 2018"
    )

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return _has_columns(path, HIGHD, "laneId")

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        about, _ = _meta(path, "recordingMeta", ("frameRate", "upperLaneMarkings", "lowerLaneMarkings"))
        mapping = _mapping(path, HIGHD, about, reference="box_corner", transform={"mirror_y": True})
        name = f"highD_{path.name.removesuffix('_tracks.csv')}"
        yield Scene(name, TableFiles.open(path), mapping, lambda: lanes or _highway(about, path), name)


class LevelX(Source):
    """Intersections, roundabouts and motorways, with Lanelet2 or OpenDRIVE maps in the folder ``maps`` of the data."""

    content = "inD, rounD, exiD or uniD (*_tracks.csv)"
    licence = LICENCE
    citation = (
        "Bock et al., The inD Dataset, IV 2020; Krajewski et al., The rounD Dataset, ITSC 2020; Moers et al., The exiD "
        "Dataset, IV 2022: the one that the recording is of"
    )

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return _has_columns(path, LEVELX)

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        about, _ = _meta(path, "recordingMeta", ("frameRate", "locationId"))
        mapping = _mapping(path, LEVELX, about, units={"angle": "deg"})
        data_set = next(
            (part for part in path.resolve().parts[::-1] if re.match(r"(in|roun|exi|uni)D", part)), "levelX"
        )
        name = f"{data_set[:5].rstrip('-_')}_{path.name.removesuffix('_tracks.csv')}"
        location = f"{data_set[:5].rstrip('-_')}_location_{about['locationId']}"
        yield Scene(name, TableFiles.open(path), mapping, partial(_map, about, path, lanes), location)


def _has_columns(path: Path, columns: Columns, *others: str) -> bool:
    """Returns whether a file has these columns; the classes of vehicles are in another."""
    return path.name.endswith("_tracks.csv") and {*columns.named().values(), *others} - {CLASS} <= first_cells(path)


def _mapping(path: Path, columns: Columns, about: dict[str, Any], **fields: Any) -> Mapping:
    """Returns the mapping of the tracks in a file, with the classes in the file of vehicles beside."""
    _, vehicles = _meta(path, "tracksMeta", (columns.vehicle_id, CLASS))
    classes = sorted({str(name) for name in vehicles.read([CLASS])[CLASS].unique()})
    kinds = {name: ROAD_USERS.get(name.lower(), likely_kind(name)) for name in classes}
    beside = {"file": vehicles.path.name, "vehicle_id": columns.vehicle_id}
    return Mapping.of_scene(columns, kinds, vehicles=beside, rate_hz=_number(about, "frameRate", path), **fields)


def _meta(path: Path, kind: str, needed: tuple[str, ...]) -> tuple[dict[str, Any], TableFile]:
    """Returns the first row of a file beside the tracks, and the file.

    Raises:
        InputError: it is missing, or lacks a column.
    """
    file = TableFile.open(path.with_name(path.name.replace("_tracks.csv", f"_{kind}.csv")))
    if missing := [name for name in needed if name not in file.columns]:
        raise InputError(f"{file}: columns {missing} are missing; the file has {list(file.columns)}")
    table = file.read(sorted({*file.columns}))
    return {str(name): table[name].iloc[0] for name in table.columns}, file


def _number(about: dict[str, Any], name: str, path: Path) -> float:
    try:
        return float(about[name])
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: field {name} of its recordingMeta: {error}, expected a number") from error


def _highway(about: dict[str, Any], path: Path) -> LaneGraph:
    """Returns the lanes between the markings of highD: the upper ones lead to the left of the picture."""
    x = pd.read_csv(path, usecols=["x", "width"])
    ends = np.array([float(x["x"].min()) - BEYOND, float((x["x"] + x["width"]).max()) + BEYOND])
    limit = float(about.get("speedLimit", -1.0))  # [m/s]
    lanelets = []
    for side, along in (("upper", ends[::-1]), ("lower", ends)):
        text = str(about[f"{side}LaneMarkings"])
        try:
            marks = sorted(float(value) for value in text.split(";") if value.strip())
        except ValueError as error:
            raise InputError(f"{path}: field {side}LaneMarkings of its recordingMeta: {error}") from error
        bounds = [np.column_stack([along, np.full(2, -mark)]) for mark in (marks[::-1] if side == "upper" else marks)]
        names = [f"{side}{number}" for number in range(len(bounds) - 1)]  # from the left edge of the carriageway
        for index, name in enumerate(names):
            lanelets.append(
                Lanelet(
                    name,
                    bounds[index],
                    bounds[index + 1],
                    left_id=names[index - 1] if index else None,
                    right_id=names[index + 1] if index + 1 < len(names) else None,
                    speed_limit=limit if limit > 0.0 else ADVISED,
                )
            )
    return LaneGraph(tuple(lanelets), left_hand=False)


def _map(about: dict[str, Any], path: Path, lanes: Path | None) -> LaneGraph | Path:
    """Returns the map of the recording's location: the one that is named, or the one in folder ``maps``.

    Raises:
        InputError: there is none, or several.
    """
    file = lanes or _map_beside(str(about["locationId"]), path)
    if file.suffix != ".osm":
        return file
    from litsim_data.maps.lanelet2_osm import moved_to_utm, read_graph

    origin = (_number(about, "latLocation", path), _number(about, "lonLocation", path))
    centre = (_number(about, "xUtmOrigin", path), _number(about, "yUtmOrigin", path))
    return moved_to_utm(read_graph(file, origin), origin, centre)


def _map_beside(location: str, path: Path) -> Path:
    folders = [path.parent, *path.resolve().parents[1:3]]
    wanted = re.compile(rf"(.*\D)?0*{re.escape(location)}(\D.*)?")
    for folder in folders:
        files = [file for pattern in MAPS for file in sorted((folder / "maps").rglob(pattern))]
        files = [file for file in files if wanted.fullmatch(file.stem)]
        if files:
            if len({file.suffix for file in files}) == len(files):
                return files[0]
            raise InputError(f"{path}: several maps of location {location}, {files[0]}, {files[1]}: name one by --map")
    raise InputError(f"{path}: no map of location {location} in a folder maps beside or above: name it by --map")
