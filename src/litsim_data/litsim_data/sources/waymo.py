"""Waymo Open Motion: scenarios in TFRecord files, and as JSON in the form of Nocturne and GPUDrive."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.maps.lane_graph import LANE_WIDTH, SPEED_LIMIT, LaneGraph, Lanelet, around, at_shares, polyline
from litsim_data.sources.lane_links import linked
from litsim_data.sources.protobuf import Fields, fields_of, records, varints
from litsim_data.sources.source import Scene, SignalChange, Source
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import to_body
from litsim_sim.io.input_files import read_head, read_json

MPH = 0.44704
RATE_HZ = 10.0
KINDS = {"vehicle": "unknown", "pedestrian": "pedestrian", "cyclist": "bicycle", "other": "drop", "unset": "drop"}
"""Our kinds; its vehicles are of all sizes."""
COLUMNS = ["vehicle_id", "frame", "x", "y", "z", "yaw", "vx", "vy", "length", "width", "kind"]
TYPES = ("unset", "vehicle", "pedestrian", "cyclist", "other")
STATES = (
    "unknown",
    "arrow_stop",
    "arrow_caution",
    "arrow_go",
    "stop",
    "caution",
    "go",
    "flashing_stop",
    "flashing_caution",
)
COLOURS = {
    "stop": "red",
    "caution": "amber",
    "go": "green",
    "flashing_stop": "flashing_red",
    "flashing_caution": "flashing_amber",
}
BIKE_LANE = 3  # type of lanes
WIDTHS = (2.8, 4.2)  # [m] within which a distance to the lane beside is a width
CONTENT = "a Waymo Open Motion scenario"
LICENCE = "Waymo Dataset License Agreement for Non-Commercial Use: the data must not be passed on"
CITATION = (
    "Ettinger et al., Large Scale Interactive Motion Forecasting for Autonomous Driving: The Waymo Open Motion "
    "Dataset, ICCV 2021"
)


class WaymoJson(Source):
    """A scenario of 9 s at 10 Hz in a JSON file; it has centre lines of lanes, but not which follow each other."""

    content, licence, citation = f"{CONTENT} (JSON of Nocturne or GPUDrive)", LICENCE, CITATION

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        if path.suffix != ".json":
            return False
        head = read_head(path)
        return b'"objects"' in head and b'"position"' in head

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - the lanes are in the file
        """See :class:`.source.Source`."""
        content = read_json(path, CONTENT)
        try:
            yield _scene(content, str(content.get("scenario_id") or path.stem), path)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(f"{path}: not {CONTENT}: {type(error).__name__} {error}") from error


class WaymoRecord(Source):
    """Scenarios of 9 s at 10 Hz; a file holds hundreds."""

    content, licence, citation = f"{CONTENT} (TFRecord)", LICENCE, CITATION

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        if "tfrecord" not in path.name or path.suffix == ".json":
            return False
        try:
            first = fields_of(next(records(path)))
        except (InputError, ValueError, StopIteration):
            return False
        return {1, 2, 5, 8} <= {*first}  # timestamps, tracks, scenario_id and map_features of a Scenario

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - the lanes are in the file
        """See :class:`.source.Source`."""
        for number, record in enumerate(records(path), 1):
            try:
                content = _content(fields_of(record))
                yield _scene(content, content["scenario_id"], path)
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise InputError(f"{path}: record {number}: not {CONTENT}: {type(error).__name__} {error}") from error


def _scene(content: Mapping[str, Any], name: str, path: Path) -> Scene:
    rows = []
    for track in content["objects"]:
        for step, valid in enumerate(track["valid"]):
            if not valid:
                continue
            place, velocity = track["position"][step], track["velocity"][step]
            row = (place["x"], place["y"], place.get("z", 0.0), track["heading"][step], velocity["x"], velocity["y"])
            rows.append((str(track["id"]), step, *row, track["length"], track["width"], track["type"]))
    tracks, scene = LoadedTable.of(path, pd.DataFrame(rows, columns=COLUMNS)), f"womd_{name}"
    mapping = tracks.meaning(KINDS, rate_hz=RATE_HZ)
    recorder = (content.get("metadata") or {}).get("sdc_track_index", -1)
    ego = str(content["objects"][recorder]["id"]) if 0 <= recorder < len(content["objects"]) else None
    signals = _signals(content.get("tl_states") or {})
    return Scene(scene, tracks, mapping, partial(lanes_of, content, path), scene, signals, ego)


def lanes_of(content: Mapping[str, Any], path: Path) -> LaneGraph:
    """Returns the lanes of vehicles; successors that the file does not name follow from where lanes begin and end."""
    roads = [road for road in content["roads"] if road["type"] == "lane" and road.get("map_element_id") != BIKE_LANE]
    bikes = sum(road["type"] == "lane" for road in content["roads"]) - len(roads)
    lit = {str(lane) for lane in content.get("tl_states") or {}}
    lines = {}
    for road in roads:
        try:
            name = str(road["id"])
            lines[name] = polyline([[point["x"], point["y"], point["z"]] for point in road["geometry"]], f"lane {name}")
        except ValueError:  # a lane of one point, at the edge of the map
            continue
    if not lines:
        raise InputError(f"{path}: the scenario has no lanes")
    widths = _widths(lines)
    lanelets = [
        Lanelet(
            name,
            *around(lines[name], widths[name]),
            tuple(map(str, road.get("exit_lanes", ()))),
            speed_limit=road.get("speed_limit_mph", 0.0) * MPH or SPEED_LIMIT,
            lights=(name,) if name in lit else (),
            predecessors=tuple(map(str, road.get("entry_lanes", ()))),
        )
        for road in roads
        if (name := str(road["id"])) in lines
    ]
    has_exits = any("exit_lanes" in road for road in roads)
    notes = [f"{bikes} lanes of bicycles are no lanes of vehicles"] if bikes else []
    notes += [] if has_exits else ["the file does not say which lanes follow each other: their ends decide"]
    return LaneGraph(tuple(linked(lanelets, ends=not has_exits)), notes=tuple(notes))


def _widths(lines: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Returns widths of lanes [m]: the distance to the next one beside in the same direction, if it is one."""
    names = [*lines]
    middles = np.array([at_shares(line[:, :2], np.array([0.5]))[0] for line in lines.values()])
    widths = {}
    for index, name in enumerate(names):
        line = lines[name][:, :2]
        half = len(line) // 2
        step = line[min(half + 1, len(line) - 1)] - line[max(half - 1, 0)]
        course = float(np.arctan2(step[1], step[0]))
        beside = []
        for other in np.flatnonzero(np.hypot(*(middles - middles[index]).T) <= 200.0).tolist():
            if other == index:
                continue
            away = lines[names[other]][:, :2] - middles[index]
            ahead, left = to_body(away[:, 0], away[:, 1], np.array(course))
            near = np.abs(ahead) < 1.0
            if near.any():
                beside.append(float(np.abs(left[near]).min()))
        fit = [distance for distance in beside if WIDTHS[0] <= distance <= WIDTHS[1]]
        widths[name] = min(fit, default=LANE_WIDTH)
    return widths


def _signals(states: Mapping[str, Any]) -> Sequence[SignalChange]:
    """Returns the changes of the lights of lanes; between two times at which a light is seen, it shows the first."""
    changes: list[SignalChange] = []
    for lane, shown in states.items():
        colours = [COLOURS.get(str(state).lower().removeprefix("arrow_"), "unknown") for state in shown["state"]]
        changes += changes_of(str(lane), [step / RATE_HZ for step in shown["time_index"]], colours)
    return sorted(changes)


def changes_of(lane: str, times: Iterable[float], states: Iterable[str]) -> list[SignalChange]:
    """Returns what the light of a lane shows at `times` [s]: the first state, and each that differs from the last."""
    runs = groupby(zip(times, states, strict=True), itemgetter(1))
    return [(float(next(run)[0]), lane, state) for state, run in runs]


# The messages of TFRecord files, by numbers of their fields


def _content(scenario: Fields) -> dict[str, Any]:
    """Returns a Scenario in the form of the JSON files."""
    features = [fields_of(feature) for feature in scenario.get(8, [])]
    signals: dict[str, dict[str, list[Any]]] = {}
    for step, states in enumerate(scenario.get(7, [])):
        for state in map(fields_of, fields_of(states).get(1, [])):
            shown = signals.setdefault(str(_whole(state, 1)), {"time_index": [], "state": []})
            shown["time_index"].append(step)
            shown["state"].append(STATES[_whole(state, 2)])
    return {
        "scenario_id": bytes(scenario[5][-1]).decode(),
        "objects": [_object(fields_of(track)) for track in scenario[2]],
        "roads": [_lane(_whole(feature, 1), fields_of(feature[3][-1])) for feature in features if 3 in feature],
        "tl_states": signals,
        "metadata": {"sdc_track_index": _whole(scenario, 6)},
    }


def _object(track: Fields) -> dict[str, Any]:
    states = [fields_of(state) for state in track[3]]
    sizes = [state for state in states if _whole(state, 11)] or states
    return {
        "id": _whole(track, 1),
        "type": TYPES[_whole(track, 2)],
        "position": [
            {axis: _double(state, number) for axis, number in zip("xyz", (2, 3, 4), strict=True)} for state in states
        ],
        "heading": [_float(state, 8) for state in states],
        "velocity": [{"x": _float(state, 9), "y": _float(state, 10)} for state in states],
        "valid": [bool(_whole(state, 11)) for state in states],
        "length": float(np.median([_float(state, 5) for state in sizes])),
        "width": float(np.median([_float(state, 6) for state in sizes])),
    }


def _lane(name: int, lane: Fields) -> dict[str, Any]:
    points = [fields_of(point) for point in lane.get(8, [])]
    return {
        "type": "lane",
        "id": name,
        "map_element_id": _whole(lane, 2),
        "speed_limit_mph": _double(lane, 1),
        "geometry": [
            {axis: _double(point, number) for axis, number in zip("xyz", (1, 2, 3), strict=True)} for point in points
        ],
        "entry_lanes": _packed(lane, 9),
        "exit_lanes": _packed(lane, 10),
    }


def _whole(message: Fields, number: int) -> int:
    value = message.get(number, [0])[-1]
    if not isinstance(value, int):
        raise TypeError(f"field {number} is no whole number")
    return value


def _double(message: Fields, number: int) -> float:
    return float(np.frombuffer(message[number][-1], "<f8")[0]) if number in message else 0.0  # type: ignore[arg-type]


def _float(message: Fields, number: int) -> float:
    return float(np.frombuffer(message[number][-1], "<f4")[0]) if number in message else 0.0  # type: ignore[arg-type]


def _packed(message: Fields, number: int) -> list[int]:
    return [
        item for value in message.get(number, []) for item in ([value] if isinstance(value, int) else varints(value))
    ]
