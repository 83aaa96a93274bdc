"""Argoverse 2 motion forecasting: ``scenario_*.parquet`` with ``log_map_archive_*.json`` beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.generic.mapping import Columns, Mapping
from litsim_data.maps.lane_graph import LaneGraph, Lanelet, polyline
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import read_json
from litsim_sim.io.parquet_input import is_parquet, read_schema, read_table

COLUMNS = Columns(
    vehicle_id="track_id",
    frame="timestep",
    x="position_x",
    y="position_y",
    yaw="heading",
    speed=("velocity_x", "velocity_y"),
    kind="object_type",
)
NAMES = tuple(COLUMNS.named().values())
KINDS = {
    "vehicle": "car",
    "bus": "truck",
    "motorcyclist": "motorcycle",
    "cyclist": "bicycle",
    "pedestrian": "pedestrian",
    "riderless_bicycle": "drop",
    "static": "drop",
    "background": "drop",
    "construction": "drop",
    "unknown": "drop",
}
RECORDER = "AV"
"""Id of the track of the vehicle that recorded the others."""


class Argoverse2(Source):
    """Scenarios of 11 s at 10 Hz, with the lanes around."""

    content = "an Argoverse 2 scenario (scenario_*.parquet)"
    licence = "CC BY-NC-SA 4.0"
    citation = (
        "Wilson et al., Argoverse 2: Next Generation Datasets for Self-Driving Perception and Forecasting, NeurIPS "
        "Datasets and Benchmarks 2021"
    )

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return is_parquet(path) and {*NAMES, "scenario_id"} <= {*read_schema(path).names}

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        table = read_table(path, NAMES)
        names = table["scenario_id"].unique()
        if len(names) != 1:
            raise InputError(f"{path}: holds the scenarios {list(map(str, names[:3]))}, expected one")
        file = lanes or path.with_name(f"log_map_archive_{names[0]}.json")
        kinds = dict.fromkeys(map(str, table["object_type"].unique()), "unknown") | KINDS
        name = f"av2_{names[0]}"
        tracks = LoadedTable.of(path, table[[*NAMES]])
        yield Scene(name, tracks, Mapping.of_scene(COLUMNS, kinds), partial(read_lanes, file), name, ego=RECORDER)


def read_lanes(path: Path) -> LaneGraph:
    """Returns the lanes of vehicles and buses of a map file.

    Raises:
        InputError: it is missing, no JSON, or a lane is malformed.
    """
    content = read_json(path, "a map of Argoverse 2 (log_map_archive_*.json, beside the scenario or by --map)")
    segments = content.get("lane_segments") if isinstance(content, dict) else None
    if not isinstance(segments, dict):
        raise InputError(f"{path}: no field lane_segments, expected a map of Argoverse 2")
    kinds = Counter(str(segment.get("lane_type")) for segment in segments.values())
    lanelets = []
    for name, segment in segments.items():
        if segment.get("lane_type") == "BIKE":
            continue
        try:
            lanelets.append(_lanelet(segment))
        except (KeyError, TypeError, ValueError) as error:
            what = f"field {error} is missing" if isinstance(error, KeyError) else str(error)
            raise InputError(f"{path}: field lane_segments.{name}: {what}") from error
    bikes = kinds["BIKE"]
    return LaneGraph(tuple(lanelets), notes=(f"{bikes} lanes of bicycles are no lanes of vehicles",) * bool(bikes))


def _lanelet(segment: dict[str, Any]) -> Lanelet:
    left, right = (
        polyline(
            [[point[axis] for axis in "xyz"] for point in segment[f"{side}_lane_boundary"]], f"{side}_lane_boundary"
        )
        for side in ("left", "right")
    )
    beside = [
        None if (other := segment.get(f"{side}_neighbor_id")) is None else str(other) for side in ("left", "right")
    ]
    return Lanelet(
        id=str(segment["id"]),
        left=left,
        right=right,
        successors=tuple(map(str, segment["successors"])),
        left_id=beside[0],
        right_id=beside[1],
        junction=bool(segment["is_intersection"]),
        predecessors=tuple(map(str, segment["predecessors"])),
    )
