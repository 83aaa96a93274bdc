"""Small data sets in published formats: three cars, a parked one and a pedestrian at a crossing with a light.

A lane leads east through (0, 0), another one north; the light of the former is green. Cars 1 and 2 drive east at 10 m/s
for 11 s, car 3 stands on the lane to the north, 4 is parked beside the road, and 5 walks. Nothing in it is real.
"""

import json
import pickle
import struct
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from litsim_data.exports.export import add
from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around
from litsim_data.maps.net_builder import write_graph
from made_maps import add_lanelets, opendrive

STEPS = 111
WALKING, PARKED, STANDING = 5, 4, 3
VEHICLES = 4
LIGHT = "e1"
"""The lane inside the junction that the light holds."""


def lanes() -> list[Lanelet]:
    east = [(-150.0, -10.0), (-10.0, 10.0), (10.0, 150.0)]
    made = []
    for name, axis in (("e", 0), ("n", 1)):
        for number, (begin, end) in enumerate(east):
            line = np.zeros((2, 2))
            line[:, axis] = begin, end
            after = (f"{name}{number + 1}",) if number < 2 else ()
            made.append(Lanelet(f"{name}{number}", *around(line), after, junction=number == 1))
    return made


def tracks() -> pd.DataFrame:
    """Columns id, step, x, y, yaw, speed, length, width, kind: box centres [m], [rad], [m/s]."""
    step = np.arange(STEPS)
    rows = []
    for name, x, y, yaw, speed in (
        (1, -120.0, 0.0, 0.0, 10.0),
        (2, -90.0, 0.0, 0.0, 10.0),
        (STANDING, 0.0, -16.0, 0.5 * np.pi, 0.0),
        (PARKED, -60.0, 6.0, 0.0, 0.0),
        (WALKING, -40.0, 9.0, 0.0, 1.2),
    ):
        walks = name == WALKING
        size = (0.6, 0.6) if walks else (4.6, 1.9)
        row = {"id": name, "step": step, "x": x + 0.1 * speed * step, "y": y, "yaw": yaw, "speed": speed}
        rows.append(pd.DataFrame(row | {"length": size[0], "width": size[1], "kind": "pedestrian" if walks else "car"}))
    return pd.concat(rows, ignore_index=True)


def argoverse(folder: Path) -> Path:
    folder.mkdir(parents=True)
    rows = tracks()
    table = pd.DataFrame(
        {
            "track_id": rows["id"].map({1: "AV"}).fillna(rows["id"].astype(str)),
            "object_type": rows["kind"].map({"car": "vehicle", "pedestrian": "pedestrian"}),
            "timestep": rows["step"],
            "position_x": rows["x"],
            "position_y": rows["y"],
            "heading": rows["yaw"],
            "velocity_x": rows["speed"] * np.cos(rows["yaw"]),
            "velocity_y": rows["speed"] * np.sin(rows["yaw"]),
            "scenario_id": "made",
        }
    )
    still = table[table["track_id"] == str(PARKED)].assign(track_id="9", object_type="static", position_y=9.0)
    pd.concat([table, still]).to_parquet(folder / "scenario_made.parquet")

    def points(line: np.ndarray) -> list[dict[str, float]]:
        return [{"x": float(x), "y": float(y), "z": 20.0} for x, y in line]

    numbers = {one.id: 100 + at for at, one in enumerate(lanes())}
    segments = {
        str(numbers[one.id]): {
            "id": numbers[one.id],
            "is_intersection": one.junction,
            "lane_type": "VEHICLE",
            "left_lane_boundary": points(one.left),
            "right_lane_boundary": points(one.right),
            "left_neighbor_id": None,
            "right_neighbor_id": None,
            "predecessors": [7],
            "successors": [numbers[after] for after in one.successors],
        }
        for one in lanes()
    }
    bike = segments["100"] | {"id": 99, "lane_type": "BIKE", "predecessors": [], "successors": []}
    content = {"lane_segments": segments | {"99": bike}, "pedestrian_crossings": {}, "drivable_areas": {}}
    (folder / "log_map_archive_made.json").write_text(json.dumps(content))
    return folder


def commonroad(path: Path, step: float = 0.1) -> Path:
    root = ET.Element("commonRoad", {"commonRoadVersion": "2020a", "benchmarkID": "ZAM_Made-1_1_T-1"})
    root.set("timeStepSize", str(step))
    add(add_lanelets(root, lanes())["e0"], "trafficLightRef", ref=50)
    cycle = add(add(root, "trafficLight", id=50), "cycle")
    for colour, lasts in (("green", 400), ("yellow", 30), ("red", 300)):
        element = add(cycle, "cycleElement")
        add(element, "duration", lasts), add(element, "color", colour)
    add(cycle, "timeOffset", 650)
    for name, rows in tracks().groupby("id"):
        fixed = name == PARKED
        obstacle = add(root, "staticObstacle" if fixed else "dynamicObstacle", id=name)
        add(obstacle, "type", "parkedVehicle" if fixed else rows["kind"].iloc[0])
        shape = add(obstacle, "shape/rectangle")
        for size in ("length", "width"):
            add(shape, size, rows[size].iloc[0])
        later = obstacle if fixed else ET.Element("trajectory")
        for number, row in enumerate(rows.iloc[:1].itertuples() if fixed else rows.itertuples()):
            state = add(obstacle, "initialState") if number == 0 else add(later, "state")
            point = add(state, "position/point")
            add(point, "x", row.x), add(point, "y", row.y)
            for quantity, value in (("orientation", row.yaw), ("time", row.step), ("velocity", row.speed)):
                add(state, f"{quantity}/exact", value)
        if not fixed:
            obstacle.append(later)
    add(add(root, "staticObstacle", id=77), "type", "building")
    add(root, "planningProblem", id=88)
    ET.ElementTree(root).write(path)
    return path


def sumo(folder: Path, kind: str = "xml") -> Path:
    """Trajectories with the net, and the types of vehicles, beside; in CSV the pedestrian is missing."""
    folder.mkdir(parents=True)
    write_graph(LaneGraph(tuple(lanes())), folder / "made.net.xml")
    (folder / "made.rou.xml").write_text(
        '<routes><vType id="small" vClass="passenger" length="4.6" width="1.9"/></routes>'
    )
    rows = tracks()
    rows = rows.assign(
        front_x=rows["x"] + 0.5 * rows["length"] * np.cos(rows["yaw"]),
        front_y=rows["y"] + 0.5 * rows["length"] * np.sin(rows["yaw"]),
        angle=90.0 - np.rad2deg(rows["yaw"]),
    )
    if kind == "csv":
        cars = rows[rows["kind"] == "car"]
        names = {"id": "vehicle_id", "front_x": "vehicle_x", "front_y": "vehicle_y", "angle": "vehicle_angle"}
        table = cars.rename(columns=names | {"speed": "vehicle_speed"}).assign(vehicle_type="small")
        table = table.assign(timestep_time=table["step"] * 0.1).sort_values(["step", "vehicle_id"])
        columns = ["timestep_time", *names.values(), "vehicle_speed", "vehicle_type"]
        table[columns].to_csv(folder / "fcd.csv", sep=";", index=False)
        return folder
    root = ET.Element("fcd-export")
    for step, now in rows.groupby("step"):
        moment = add(root, "timestep", time=f"{0.1 * step:.2f}")
        for row in now.itertuples():
            values = {"id": row.id, "x": row.front_x, "y": row.front_y, "angle": row.angle, "speed": row.speed}
            tag, of_type = ("vehicle", {"type": "small"}) if row.kind == "car" else ("person", {})
            add(moment, tag, **values, **of_type)
    add(root[0], "vehicle", id=8, type="small", x=-1073741824.0, y=0, angle=0, speed=0)
    ET.ElementTree(root).write(folder / "made.fcd.xml")
    return folder


def level_x(folder: Path, data_set: str = "inD") -> Path:
    """inD at 25 Hz with the map as OpenDRIVE: one road; or highD, where y points down and x, y are corners."""
    data = folder / data_set / "data"
    data.mkdir(parents=True)
    t = np.arange(0.0, 11.0, 0.04)
    cars = ((1, -120.0, -1.75, 10.0), (2, -90.0, -1.75, 10.0), (3, 110.0, 1.75, -11.0))
    frames, meta = [], []
    for name, x, y, speed in cars:
        at = pd.DataFrame({"frame": np.arange(len(t)) + 1, "x": x + speed * t, "y": y, "speed": speed})
        if data_set == "highD":
            corner = {"x": at["x"] - 2.3, "y": -at["y"] - 0.95, "width": 4.6, "height": 1.9, "xVelocity": speed}
            rows = at.assign(id=name, **corner, yVelocity=0.0, laneId=2)
            meta.append({"id": name, "class": "Car", "width": 4.6, "height": 1.9})
        else:
            rows = pd.DataFrame({"recordingId": 7, "trackId": name, "frame": at["frame"], "xCenter": at["x"]})
            rows = rows.assign(yCenter=y, heading=0.0 if speed > 0 else 180.0, length=4.6, width=1.9)
            rows = rows.assign(xVelocity=speed, yVelocity=0.0)
            meta.append({"recordingId": 7, "trackId": name, "class": "car"})
        frames.append(rows)
    pd.concat(frames).to_csv(data / "07_tracks.csv", index=False)
    pd.DataFrame(meta).to_csv(data / "07_tracksMeta.csv", index=False)
    about: dict[str, Any] = {"frameRate": 25, "locationId": 1, "speedLimit": -1}
    marks = {"upperLaneMarkings": "-3.5;0", "lowerLaneMarkings": "0;3.5"} if data_set == "highD" else {}
    pd.DataFrame([about | marks]).to_csv(data / "07_recordingMeta.csv", index=False)
    if data_set != "highD":
        maps = folder / data_set / "maps" / "opendrive"
        maps.mkdir(parents=True)
        (maps / "01_place.xodr").write_text(opendrive())
        (maps / "11_other.xodr").write_text(opendrive())
    return folder


def interaction(folder: Path) -> Path:
    """Tracks of vehicles and of a pedestrian, whose file has fewer columns, and the map as OpenDRIVE."""
    place = folder / "recorded_trackfiles" / "DR_Made"
    place.mkdir(parents=True)
    rows = tracks()
    table = pd.DataFrame(
        {"track_id": rows["id"], "frame_id": rows["step"] + 1, "timestamp_ms": 100 * (rows["step"] + 1)}
    )
    table = table.assign(agent_type=rows["kind"], x=rows["x"], y=rows["y"] - 1.75, vx=rows["speed"], vy=0.0)
    table = table.assign(psi_rad=rows["yaw"], length=rows["length"], width=rows["width"])
    walks = rows["kind"] == "pedestrian"
    driving = ~walks & (rows["id"] != STANDING)
    table[driving].to_csv(place / "vehicle_tracks_000.csv", index=False)
    walking = (
        table[walks].drop(columns=["psi_rad", "length", "width"]).assign(track_id="P1", agent_type="pedestrian/bicycle")
    )
    walking.to_csv(place / "pedestrian_tracks_000.csv", index=False)
    return folder


def osi(path: Path, kind: str = "GroundTruth") -> Path:
    """A trace with its lanes in the first message; the lanes across the junction are pairs of one intersection."""
    from mcap.writer import Writer
    from osi3.osi_groundtruth_pb2 import GroundTruth
    from osi3.osi_sensorview_pb2 import SensorView

    messages = []
    for step, now in tracks().groupby("step"):
        truth = GroundTruth()
        if step == 0:
            _osi_lanes(truth)
        truth.timestamp.seconds, truth.timestamp.nanos = divmod(int(step) * 100_000_000, 1_000_000_000)
        truth.host_vehicle_id.value = 2
        for row in now.itertuples():
            one = truth.moving_object.add()
            one.id.value = row.id
            one.base.position.x, one.base.position.y, one.base.position.z = row.x, row.y, 0.8
            one.base.dimension.length, one.base.dimension.width = row.length, row.width
            one.base.orientation.yaw = row.yaw
            one.base.velocity.x, one.base.velocity.y = row.speed * np.cos(row.yaw), row.speed * np.sin(row.yaw)
            one.type = one.TYPE_PEDESTRIAN if row.kind == "pedestrian" else one.TYPE_VEHICLE
            one.vehicle_classification.type = one.VehicleClassification.TYPE_MEDIUM_CAR
        view = SensorView(timestamp=truth.timestamp, global_ground_truth=truth)
        view.mounting_position_rmse.position.x = 0.1
        messages.append((view if kind == "SensorView" else truth).SerializeToString())
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        if path.suffix == ".osi":
            file.writelines(struct.pack("<L", len(message)) + message for message in messages)
            return path
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("truth", "protobuf", writer.register_schema(f"osi3.{kind}", "protobuf", b""))
        for number, message in enumerate(messages):
            writer.add_message(channel, number, message, number)
        writer.finish()
    return path


def _osi_lanes(truth: Any) -> None:
    """Adds the outer lanes, the borders of which are 3.6 m apart, and the intersection; centre lines may lead back."""
    numbers = {one.id: 10 + at for at, one in enumerate(lanes()) if not one.junction}
    for one in lanes():
        if one.junction:
            continue
        lane = truth.lane.add()
        lane.id.value = numbers[one.id]
        lane.classification.type = lane.classification.TYPE_DRIVING
        lane.classification.centerline_is_driving_direction = one.id != "e2"
        for x, y in one.centerline[::-1] if one.id == "e2" else one.centerline:
            lane.classification.centerline.add(x=x, y=y)
        for at, bound in enumerate(around(one.centerline, 3.6)):
            border = truth.lane_boundary.add()
            border.id.value = 10 * numbers[one.id] + at
            for x, y in bound:
                point = border.boundary_line.add().position
                point.x, point.y = x, y
            side = (lane.classification.left_lane_boundary_id, lane.classification.right_lane_boundary_id)[at]
            side.add(value=border.id.value)
    middle = truth.lane.add()
    middle.id.value = 99
    middle.classification.type = middle.classification.TYPE_INTERSECTION
    for before, after in (("e0", "e2"), ("n0", "n2")):
        pair = middle.classification.lane_pairing.add()
        pair.antecessor_lane_id.value, pair.successor_lane_id.value = numbers[before], numbers[after]


def crossing() -> dict[str, Any]:
    """The crossing as plain data, with a lane of bicycles: `py123d_log.py` makes a log and a map of py123d of it."""

    def lane(number: int, sides: Sequence[np.ndarray], at: int, *, bicycles: bool = False) -> dict[str, Any]:
        left, right = (np.column_stack([side, np.full(len(side), 20.0)]).tolist() for side in sides)
        before, after = [number - 1] if at > 0 else [], [number + 1] if at < 2 else []
        shape = {"left": left, "right": right, "inside": at == 1, "bicycles": bicycles}
        return {"id": number, "before": [] if bicycles else before, "after": [] if bicycles else after} | shape

    made = [lane(number, (one.left, one.right), number % 3) for number, one in enumerate(lanes())]
    made.append(lane(len(made), around(np.array([[-150.0, 6.0], [-10.0, 6.0]]), 1.0), 0, bicycles=True))
    lit = [one.id for one in lanes()].index(LIGHT)
    return {"tracks": tracks().to_dict("list"), "lanes": made, "lit": lit, "recorder": 2}


def py123d(path: Path) -> Path:
    """What examples/py123d/export.py makes of such a log."""
    rows, made, begin = tracks(), crossing(), 1_600_000_000_000_000
    columns = {
        "vehicle_id": rows["id"].astype(str).replace("2", "ego_vehicle"),
        "time_us": begin + 100_000 * rows["step"],
        **{name: rows[name] for name in ("x", "y")},
        "z": np.zeros(len(rows)),
        **{name: rows[name] for name in ("yaw", "length", "width")},
        "label": rows["kind"].replace("car", "vehicle").mask(rows["id"] == 2, "ego"),
        "general": rows["kind"].replace({"car": "vehicle", "pedestrian": "person"}).mask(rows["id"] == 2, "ego"),
    }
    lanelets = [
        {
            "id": str(lane["id"]),
            "left": lane["left"],
            "right": lane["right"],
            "predecessors": [str(one) for one in lane["before"]],
            "successors": [str(one) for one in lane["after"]],
            "left_id": None,
            "right_id": None,
            "speed_limit": None,
            "junction": lane["inside"],
            "bicycles": lane["bicycles"],
        }
        for lane in made["lanes"]
    ]
    lights = [(begin, str(made["lit"]), "green")]
    content = {"dataset": "nuplan", "log": "made", "ego": "ego_vehicle", "lanes": lanelets, "lights": lights}
    pq.write_table(pa.table(columns).replace_schema_metadata({"py123d": json.dumps(content)}), path)
    return path


def waymo_content() -> dict[str, Any]:
    objects = []
    first = tracks()
    for name, rows in first[first["step"] < 91].groupby("id"):
        valid = (rows["step"] != 90).tolist() if name == PARKED else [True] * 91
        places = [
            {"x": float(row.x), "y": float(row.y), "z": 0.0} if there else {"x": -10000.0, "y": -10000.0, "z": -10000.0}
            for row, there in zip(rows.itertuples(), valid, strict=True)
        ]
        objects.append(
            {
                "id": int(name),
                "type": "pedestrian" if rows["kind"].iloc[0] == "pedestrian" else "vehicle",
                "position": places,
                "heading": rows["yaw"].tolist(),
                "velocity": [{"x": float(row.speed), "y": 0.0} for row in rows.itertuples()],
                "valid": valid,
                "length": float(rows["length"].iloc[0]),
                "width": float(rows["width"].iloc[0]),
            }
        )
    numbers = {one.id: 100 + at for at, one in enumerate(lanes())}
    roads = [
        {
            "type": "lane",
            "id": numbers[one.id],
            "map_element_id": 2,
            "geometry": [{"x": float(x), "y": float(y), "z": 0.0} for x, y in one.centerline],
        }
        for one in lanes()
    ]
    roads.append(roads[0] | {"id": 99, "map_element_id": 3})
    states = {"time_index": [0, 1, 2], "state": ["unknown", "arrow_go", "go"]}
    return {
        "scenario_id": "made",
        "objects": objects,
        "roads": roads,
        "tl_states": {str(numbers[LIGHT]): states},
        "metadata": {"sdc_track_index": 1},
    }


def scenario_net(path: Path, dataset: str = "waymo", protocol: int = 4) -> Path:
    rows, states = tracks(), np.full(STEPS, "LANE_STATE_GO", object)
    objects: dict[str, Any] = {}
    for name, one in rows.groupby("id"):
        valid = np.ones(STEPS, bool)
        kind = "PEDESTRIAN" if name == WALKING else "VEHICLE"
        state = {
            "position": np.column_stack([one["x"], one["y"], np.full(STEPS, 20.0)]).astype(np.float32),
            "heading": one["yaw"].to_numpy(np.float32),
            "velocity": np.zeros((STEPS, 2), np.float32),
            "valid": valid,
            "length": one[["length"]].to_numpy(np.float32),
            "width": one["width"].to_numpy(np.float64),
        }
        objects[str(name)] = {"type": kind, "state": state, "metadata": {"type": kind, "track_length": STEPS}}
    objects["cone"] = objects["1"] | {"type": "TRAFFIC_CONE"}
    features: dict[str, Any] = {"9": {"type": "ROAD_EDGE_BOUNDARY", "polyline": np.zeros((2, 3))}}
    for lanelet in lanes():
        line = np.column_stack([lanelet.centerline, np.full(len(lanelet.centerline), 20.0)])
        features[lanelet.id] = {
            "type": "LANE_SURFACE_STREET",
            "polyline": line.astype(np.float32),
            "exit_lanes": [*lanelet.successors],
            "entry_lanes": [],
            "speed_limit_kmh": np.float64(50.0),
        }
    light = {"type": "TRAFFIC_LIGHT", "lane": LIGHT, "state": {"object_state": states.tolist()}}
    about = {"dataset": dataset, "ts": 0.1 * np.arange(STEPS), "sdc_id": "2", "metadrive_processed": False}
    about["counts"] = defaultdict(int, {"VEHICLE": 4})
    content = {"id": "made", "version": "1", "length": STEPS, "tracks": objects, "metadata": about}
    content |= {"dynamic_map_states": {LIGHT: light}, "map_features": features}
    path.write_bytes(pickle.dumps(content, protocol=protocol))
    return path


def waymo_json(path: Path) -> Path:
    path.write_text(json.dumps(waymo_content()))
    return path


def waymo_record(path: Path) -> Path:
    """The same as a TFRecord of Scenario messages; which lanes follow each other is named."""
    content = waymo_content()
    names = {one.id: 100 + at for at, one in enumerate(lanes())}
    after = {names[one.id]: [names[other] for other in one.successors] for one in lanes()}
    scenario = b"".join(_fixed(1, "d", 0.1 * step) for step in range(91))
    kinds = {"vehicle": 1, "pedestrian": 2}
    for one in content["objects"]:
        track = _varint_field(1, one["id"]) + _varint_field(2, kinds[one["type"]])
        for step in range(91):
            place, velocity = one["position"][step], one["velocity"][step]
            state = b"".join(_fixed(number, "d", place[axis]) for number, axis in zip((2, 3, 4), "xyz", strict=True))
            floats = (one["length"], one["width"], 1.5, one["heading"][step], velocity["x"], velocity["y"])
            state += b"".join(_fixed(5 + at, "f", value) for at, value in enumerate(floats))
            track += _bytes(3, state + _varint_field(11, int(one["valid"][step])))
        scenario += _bytes(2, track)
    scenario += _bytes(5, b"made") + _varint_field(6, 1)
    (lane, states), *_ = content["tl_states"].items()
    for step in range(91):
        state = {"unknown": 0, "arrow_go": 3, "go": 6}[states["state"][min(step, 2)]]
        scenario += _bytes(7, _bytes(1, _varint_field(1, int(lane)) + _varint_field(2, state)))
    for road in content["roads"]:
        points = b"".join(
            _bytes(8, b"".join(_fixed(at, "d", point[axis]) for at, axis in zip((1, 2, 3), "xyz", strict=True)))
            for point in road["geometry"]
        )
        exits = b"".join(map(_varint, after.get(road["id"], [])))
        lane_bytes = _fixed(1, "d", 30.0) + _varint_field(2, road["map_element_id"]) + points + _bytes(10, exits)
        scenario += _bytes(8, _varint_field(1, road["id"]) + _bytes(3, lane_bytes))
    path.write_bytes(struct.pack("<Q", len(scenario)) + bytes(4) + scenario + bytes(4))
    return path


def _varint(value: int) -> bytes:
    parts = []
    while True:
        parts.append((value & 0x7F) | (0x80 if value > 0x7F else 0))
        value >>= 7
        if not value:
            return bytes(parts)


def _varint_field(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _fixed(number: int, kind: str, value: float) -> bytes:
    return _varint(number << 3 | (1 if kind == "d" else 5)) + struct.pack(f"<{kind}", value)


def _bytes(number: int, content: bytes | Sequence[int]) -> bytes:
    return _varint(number << 3 | 2) + _varint(len(content)) + bytes(content)
