"""Logs of py123d, as ``examples/py123d/export.py`` writes them: nuPlan, nuScenes, KITTI-360, PandaSet and more."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.maps.lane_graph import SPEED_LIMIT, LaneGraph, Lanelet, polyline
from litsim_data.sources.argoverse import Argoverse2
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.parquet_input import is_parquet, read_schema, read_table

KEY = b"py123d"
"""Of the metadata of a file that hold all but the tracks, as JSON."""
COLUMNS = ("vehicle_id", "time_us", "x", "y", "z", "yaw", "length", "width", "label", "general")
GENERAL = {"ego": "car", "vehicle": "unknown", "two_wheeler": "bicycle", "person": "pedestrian", "train": "unknown"}
"""Our kinds by py123d's labels, which are the same for all data sets; others, such as cones, are left out."""
PARTS = {
    "car": ("car", "regular_vehicle", "pickup", "police"),
    "truck": ("truck", "bus", "large_vehicle", "trailer", "caravan", "construction_vehicle", "vehicle_construction"),
    "motorcycle": ("motorcycle", "motorized_scooter"),
    "drop": ("bicyclist", "motorcyclist", "rider"),  # who sit on vehicles that have boxes of their own
}
"""Parts of the data sets' own labels that tell our kind better."""


ABOUT = {
    "nuplan": (
        "CC BY-NC-SA 4.0",
        "Caesar et al., nuPlan: A closed-loop ML-based planning benchmark for autonomous vehicles, CVPR ADP3 2021",
    ),
    "nuscenes": (
        "CC BY-NC-SA 4.0",
        "Caesar et al., nuScenes: A multimodal dataset for autonomous driving, CVPR 2020",
    ),
    "kitti360": (
        "CC BY-NC-SA 3.0",
        "Liao et al., KITTI-360: A Novel Dataset and Benchmarks for Urban Scene Understanding in 2D and 3D, TPAMI 2022",
    ),
    "pandaset": (
        "CC BY 4.0",
        "Xiao et al., PandaSet: Advanced Sensor Suite Dataset for Autonomous Driving, ITSC 2021",
    ),
    "av2-sensor": (Argoverse2.licence, Argoverse2.citation),
}
"""Licence and citation by py123d's name of the data set."""


class Py123d(Source):
    """Boxes of one log with the lanes around it; those of nuPlan have lights, those of PandaSet have no lanes."""

    content = "a log of py123d, as examples/py123d/export.py writes it"
    licence = "that of the data set from which py123d has converted it"
    citation = "a data set converted by py123d"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return is_parquet(path) and KEY in (read_schema(path).metadata or {})

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        content, table = _content(path), read_table(path, COLUMNS)
        labels = table[["label", "general"]].drop_duplicates().itertuples(index=False, name=None)
        kinds = {(label, general): _kind(label, general) for label, general in labels}
        table["kind"] = [kinds[key] for key in zip(table["label"], table["general"], strict=True)]
        tracks = LoadedTable.of(path, {name: table[name] for name in (*COLUMNS, "kind")})
        columns = {name: name for name in ("vehicle_id", "x", "y", "yaw", "length", "width", "kind")}
        columns["time"] = "time_us"
        mapping = tracks.meaning({kind: kind for kind in kinds.values()}, columns=columns, units={"time": "us"})
        signals = [(1e-6 * time, lane, state) for time, lane, state in content["lights"]]
        yield Scene(
            name=path.stem,
            tracks=tracks,
            mapping=mapping,
            lanes=partial(_lanes, content, path, lanes),
            map_name=path.stem,
            signals=signals,
            ego=content["ego"],
            about=ABOUT.get(content["dataset"]),
        )


def _content(path: Path) -> dict[str, Any]:
    """Returns the fields of a file beside the tracks.

    Raises:
        InputError: they are no JSON, or one is missing.
    """
    try:
        content = json.loads((read_schema(path).metadata or {})[KEY])
        return {field: content[field] for field in ("dataset", "ego", "lanes", "lights")}
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: metadata {KEY.decode()}: {type(error).__name__} {error}, expected what "
            f"examples/py123d/export.py writes"
        ) from error


def _kind(label: str, general: str) -> str:
    """Returns our kind of an object by its label in the data set, and by py123d's."""
    kind = GENERAL.get(general, "drop")
    return next((ours for ours, parts in PARTS.items() if kind != "drop" and any(p in label for p in parts)), kind)


def _lanes(content: dict[str, Any], path: Path, lanes: Path | None) -> LaneGraph | Path:
    """Returns the lanes of the log, or the map that the user has named.

    Raises:
        InputError: there are none, or one is malformed.
    """
    if lanes is not None:
        return lanes
    if not content["lanes"]:
        raise InputError(f"{path}: holds no lanes, as its data set has no map there: name a net or OpenDRIVE by --map")
    lit = {lane for _, lane, _ in content["lights"]}
    lanelets, bicycles = [], 0
    for number, lane in enumerate(content["lanes"]):
        try:
            if lane["bicycles"]:
                bicycles += 1
                continue
            lanelets.append(
                Lanelet(
                    id=lane["id"],
                    left=polyline(lane["left"], "left"),
                    right=polyline(lane["right"], "right"),
                    successors=tuple(lane["successors"]),
                    left_id=lane["left_id"],
                    right_id=lane["right_id"],
                    speed_limit=lane["speed_limit"] or SPEED_LIMIT,
                    lights=(lane["id"],) * (lane["id"] in lit),
                    junction=lane["junction"],
                    predecessors=tuple(lane["predecessors"]),
                )
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: lane {number} of its metadata: {type(error).__name__} {error}") from error
    return LaneGraph(
        tuple(lanelets), notes=(f"{bicycles} lanes of bicycles are no lanes of vehicles",) * bool(bicycles)
    )
