"""OSI traces: ground truth of ASAM's Open Simulation Interface, alone or in the views of a sensor."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from mcap.exceptions import McapError
from mcap.reader import make_reader

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.maps.lane_graph import LANE_WIDTH, LaneGraph, Lanelet, around, polyline
from litsim_data.sources.lane_links import linked
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError, not_installed
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import open_input, read_head, require_file

SIZE_MAX = 2**33  # [B] of a trace
MESSAGE_MAX = 2**28  # [B]
VIEWS = ("osi3.GroundTruth", "osi3.SensorView")
"""Messages that hold ground truth."""
CARS = "small_car compact_car car medium_car luxury_car delivery_van van land_vehicle"
TRUCKS = "heavy_truck semitractor semitrailer trailer bus work_machine"
KINDS = {
    **dict.fromkeys(CARS.split(), "car"),
    **dict.fromkeys(TRUCKS.split(), "truck"),
    **dict.fromkeys(("motorbike", "motorcycle"), "motorcycle"),
    **dict.fromkeys(("bicycle", "standup_scooter", "micromobility_device"), "bicycle"),
    **dict.fromkeys(("pedestrian", "wheelchair"), "pedestrian"),
    **dict.fromkeys(("unknown", "other"), "unknown"),
}
"""Our kinds of OSI's classes; others, such as trams and animals, are left out."""
FOOTPATHS = ("SUBTYPE_BIKING", "SUBTYPE_SIDEWALK", "SUBTYPE_PARKING", "SUBTYPE_BORDER", "SUBTYPE_SHOULDER")
"""Kinds of lanes on which vehicles do not drive."""
COLUMNS = ["vehicle_id", "time", "x", "y", "yaw", "vx", "vy", "kind", "length", "width"]
POINTS = 15  # of a lane across an intersection, which OSI gives as a pair of lanes
BACK = np.deg2rad(150.0)  # pairs that turn as much are left out: an intersection lists all pairs


class OpenSimulationInterface(Source):
    """Boxes of all moving objects; the map is the OpenDRIVE file that the trace names, or else its lanes."""

    content = "an OSI trace of ground truth (*.osi, or MCAP)"
    licence = "that of whoever made the trace"
    citation = "ASAM Open Simulation Interface"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        if path.suffix.lower() == ".mcap":
            require_file(path)
            with path.open("rb") as file, suppress(McapError, struct.error):
                summary = make_reader(file).get_summary()
                return summary is not None and any(schema.name in VIEWS for schema in summary.schemas.values())
        if path.suffix.lower() != ".osi":
            return False
        head = read_head(path, 5)
        return len(head) == 5 and 0 < struct.unpack("<L", head[:4])[0] <= min(MESSAGE_MAX, path.stat().st_size)

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        rows: list[tuple[Any, ...]] = []
        road_lanes: dict[int, Any] = {}
        borders: dict[int, Any] = {}
        references: set[str] = set()
        host, lights = "", 0
        for truth in _truths(path):
            time = truth.timestamp.seconds + 1e-9 * truth.timestamp.nanos
            rows += [_row(one, time) for one in truth.moving_object]
            road_lanes |= {lane.id.value: lane for lane in truth.lane}
            borders |= {border.id.value: border for border in truth.lane_boundary}
            references |= {truth.map_reference} - {""}
            lights = max(lights, len(truth.traffic_light))
            host = str(truth.host_vehicle_id.value) if truth.HasField("host_vehicle_id") else host
        table = pd.DataFrame(rows, columns=COLUMNS)
        tracks = LoadedTable.of(path, table if np.isfinite(table["vx"]).all() else table.drop(columns=["vx", "vy"]))
        mapping = tracks.meaning(KINDS, accept=["heading", "side", "size"])
        name = path.name.split(".")[0]
        road = next((file for one in sorted(references) if (file := path.parent / Path(one).name).is_file()), None)
        notes = (f"{lights} bulbs of traffic lights are not used",) if lights else ()
        ego = host if host in set(table["vehicle_id"]) else None
        map_of = partial(_map, path, lanes or road, road_lanes, borders)
        yield Scene(name, tracks, mapping, map_of, f"{name}_net", ego=ego, notes=notes)


def _truths(path: Path) -> Iterator[Any]:
    """Yields the ground truth of each message.

    Raises:
        InputError: the package that knows the messages is missing, or the file is cut or no such trace.
    """
    try:
        from google.protobuf.message import DecodeError
        from osi3.osi_groundtruth_pb2 import GroundTruth
        from osi3.osi_sensorview_pb2 import SensorView
    except ImportError as error:
        raise not_installed("osi-python") from error
    for number, (kind, data) in enumerate(_messages(path), 1):
        candidates = []
        with suppress(DecodeError):
            candidates += [SensorView.FromString(data).global_ground_truth] if kind != VIEWS[0] else []
        with suppress(DecodeError):
            candidates += [GroundTruth.FromString(data)] if kind != VIEWS[1] else []
        if not candidates:
            raise InputError(f"{path}: message {number}: neither ground truth of OSI nor a sensor's view of it")
        yield max(candidates, key=_content)


def _messages(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yields the messages of a trace with the names of their types, which an .osi file does not tell: then empty."""
    with open_input(path, "OSI trace", size_max=SIZE_MAX) as file:
        if path.suffix.lower() == ".mcap":
            try:
                for schema, _, message in make_reader(file).iter_messages():
                    if schema is not None and schema.name in VIEWS:
                        yield schema.name, message.data
            except (McapError, struct.error) as error:
                raise InputError(f"{path}: not a readable MCAP file: {error}") from error
            return
        number = 0
        while head := file.read(4):
            number += 1
            length = struct.unpack("<L", head)[0] if len(head) == 4 else MESSAGE_MAX + 1
            if length > MESSAGE_MAX or len(data := file.read(length)) < length:
                raise InputError(f"{path}: message {number}: the file ends within it, or is no OSI trace")
            yield "", data


def _content(truth: Any) -> int:
    """Returns how many objects and lanes ground truth holds: none where a message is read as one of another type."""
    placed = [
        vehicle for vehicle in truth.moving_object if vehicle.HasField("id") and vehicle.base.HasField("position")
    ]
    return len(placed) + len(truth.lane)


def _row(vehicle: Any, time: float) -> tuple[Any, ...]:
    """Returns the columns COLUMNS of a moving object at a time [s]."""
    kind = vehicle.Type.Name(vehicle.type).removeprefix("TYPE_").lower()
    if kind == "vehicle":
        kind = (
            vehicle.VehicleClassification.Type.Name(vehicle.vehicle_classification.type).removeprefix("TYPE_").lower()
        )
    base = vehicle.base
    velocity = (base.velocity.x, base.velocity.y) if base.HasField("velocity") else (np.nan, np.nan)
    pose = base.position.x, base.position.y, base.orientation.yaw
    return str(vehicle.id.value), time, *pose, *velocity, kind, base.dimension.length, base.dimension.width


def _map(path: Path, road: Path | None, lanes: dict[int, Any], borders: dict[int, Any]) -> LaneGraph | Path:
    """Returns the file of the map, or the lanes of the trace."""
    if road is not None:
        return road
    lanelets = {}
    for number, lane in lanes.items():
        meaning = lane.classification
        kind, subtype = meaning.Type.Name(meaning.type), meaning.Subtype.Name(meaning.subtype)
        if kind not in ("TYPE_DRIVING", "TYPE_INTERSECTION") or subtype in FOOTPATHS or not meaning.centerline:
            continue
        try:
            line = polyline([[point.x, point.y, point.z] for point in meaning.centerline], "its centre line")
        except ValueError as error:
            raise InputError(f"{path}: lane {number}: {error}") from error
        if meaning.HasField("centerline_is_driving_direction") and not meaning.centerline_is_driving_direction:
            line = line[::-1]
        sides = around(line, _width(line, meaning, borders))
        lanelets[number] = Lanelet(str(number), *sides, junction=kind == "TYPE_INTERSECTION")
    if not lanelets:
        raise InputError(f"{path}: holds no lanes with a centre line: name the map by --map")
    outer = {lanelet.id: lanelet for lanelet in linked([*lanelets.values()], ends=True)}
    return LaneGraph((*outer.values(), *_across(lanes, outer)))


def _width(line: FloatArray, meaning: Any, borders: dict[int, Any]) -> float:
    """Returns the width [m] of a lane: the median distances to its borders, half a usual lane where there is none."""
    points, width = shapely.points(line[:, :2]), 0.0
    for side in (meaning.left_lane_boundary_id, meaning.right_lane_boundary_id):
        lines = [borders[lane.value].boundary_line for lane in side if lane.value in borders]
        parts = [[(point.position.x, point.position.y) for point in border] for border in lines if len(border) > 1]
        far = shapely.distance(points, shapely.MultiLineString(parts)) if parts else np.array([0.5 * LANE_WIDTH])
        width += float(np.median(far))
    return width


def _across(lanes: dict[int, Any], outer: dict[str, Lanelet]) -> Iterator[Lanelet]:
    """Yields lanes across the intersections that have pairs of lanes and no centre line."""
    for number, lane in lanes.items():
        if str(number) in outer or lane.classification.Type.Name(lane.classification.type) != "TYPE_INTERSECTION":
            continue
        for pair in lane.classification.lane_pairing:
            start, end = (outer.get(str(own.value)) for own in (pair.antecessor_lane_id, pair.successor_lane_id))
            if start is None or end is None or end.id in start.successors:
                continue
            turned = float(wrap_angle(np.array(end.course(0) - start.course(-1))))
            if abs(turned) < BACK:
                line = _curve(start, end)
                sides = around(line, np.linspace(start.width, end.width, len(line)))
                name = f"{number}_{start.id}_{end.id}"
                yield Lanelet(name, *sides, (end.id,), junction=True, predecessors=(start.id,))


def _curve(start: Lanelet, end: Lanelet) -> FloatArray:
    """Returns a smooth way (POINTS, 2) [m] from the end of one lane to the beginning of another (cubic of Hermite)."""
    from scipy.interpolate import CubicHermiteSpline  # takes a while to load, and few maps need it

    a, b = start.centerline[-1], end.centerline[0]
    reach = float(np.hypot(*(b - a)))
    leave, enter = (reach * np.array([np.cos(angle), np.sin(angle)]) for angle in (start.course(-1), end.course(0)))
    return np.asarray(CubicHermiteSpline([0.0, 1.0], [a, b], [leave, enter])(np.linspace(0.0, 1.0, POINTS)))
