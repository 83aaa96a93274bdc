"""Scenes in the layout of ScenarioNet and MetaDrive: a pickle for each, of any data set that these convert."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from litsim_data.generic.kinds import likely_kind
from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.sources import argoverse, py123d, waymo
from litsim_data.sources.pickled import read_pickle
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.checks import CELLS_MAX, check_budget
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.input_files import TREE_MAX, open_input, read_head

KINDS = {"VEHICLE": "unknown", "PEDESTRIAN": "pedestrian", "CYCLIST": "bicycle"}
"""Our kinds; vehicles are of all sizes, unless the name that the data set has for them says more."""
BY_NAME = ("car", "truck", "motorcycle")
LIGHTS = {"traffic_light_green": "green", "traffic_light_red": "red", "traffic_light_yellow": "amber"}
ABOUT = py123d.ABOUT | {
    "waymo": (waymo.LICENCE, waymo.CITATION),
    "av2": (argoverse.Argoverse2.licence, argoverse.Argoverse2.citation),
    "pg": ("Apache-2.0", "Li et al., MetaDrive: Composing Diverse Driving Scenarios, TPAMI 2022"),
}
"""Licence and citation by ScenarioNet's name of the data set."""
WITH_HEIGHTS = ("waymo", "av2")
"""Data sets whose lanes have heights; those of nuScenes have directions in their place."""
COLUMNS = ("vehicle_id", "time", "x", "y", "z", "yaw", "length", "width", "kind")
EXPECTED = "a scene in ScenarioNet's layout"


class ScenarioNet(Source):
    """Scenes with lanes, and with lights where the data set has them."""

    content = "a scene of ScenarioNet or MetaDrive (*.pkl)"
    licence = "that of the data set from which ScenarioNet has converted it"
    citation = "a data set converted by ScenarioNet: Li et al., NeurIPS Datasets and Benchmarks 2023"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        if path.suffix != ".pkl" or read_head(path, 1) != b"\x80":
            return False
        with open_input(path, size_max=TREE_MAX) as file:
            content = file.read()
        return b"dynamic_map_states" in content and b"tracks" in content

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:  # noqa: ARG002 - the lanes are in the file
        """See :class:`.source.Source`."""
        content = read_pickle(path)
        try:
            yield _scene(content, path)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(f"{path}: not {EXPECTED}: {type(error).__name__} {error}") from error


def _scene(content: Mapping[str, Any], path: Path) -> Scene:
    about = content["metadata"]
    times = np.asarray(about["ts"], np.float64).ravel()
    high = about.get("dataset") in WITH_HEIGHTS
    features = {str(name): feature for name, feature in content["map_features"].items()}
    names = {name: name if re.fullmatch(r"[\w.-]+", name) else f"lane{row}" for row, name in enumerate(features)}
    lights = [light for light in content["dynamic_map_states"].values() if "lane" in light]
    lit = {names.get(str(light["lane"]), ""): _shown(light["state"]["object_state"]) for light in lights}
    name = re.sub(r"[^\w+=-]+", "_", f"{about.get('dataset', 'scenarionet')}_{content['id']}")
    tracks, notes = _tracks(content["tracks"], times, path)
    return Scene(
        name,
        tracks,
        tracks.meaning({kind: kind for kind in (*KINDS.values(), *BY_NAME)}),
        partial(waymo.lanes_of, {"roads": _roads(features, names, high=high), "tl_states": lit}, path),
        name,
        sorted(chain(*(waymo.changes_of(lane, times[: len(states)], states) for lane, states in lit.items()))),
        ego=str(about["sdc_id"]) if str(about.get("sdc_id")) in map(str, content["tracks"]) else None,
        notes=notes,
        about=ABOUT.get(str(about.get("dataset"))),
    )


def _tracks(objects: Mapping[Any, Any], times: FloatArray, path: Path) -> tuple[LoadedTable, tuple[str, ...]]:
    """Returns the tracks of road users, and a note for each kind of object that is no road user.

    Velocities are not used: those of some data sets are 0 throughout.
    """
    check_budget("rows of tracks", len(objects) * len(times) * len(COLUMNS), CELLS_MAX)
    pieces: list[dict[str, Any]] = []
    others: Counter[str] = Counter()
    for name, track in objects.items():
        if track["type"] not in KINDS:
            others[str(track["type"])] += 1
            continue
        state = track["state"]
        there = np.asarray(state["valid"], bool).ravel()
        place = np.asarray(state["position"], np.float64)
        if len(there) != len(times) or place.shape[0] != len(times) or place.shape[1] not in (2, 3):
            raise ValueError(
                f"track {name}: {len(there)} and {place.shape} states, expected those of {len(times)} times"
            )
        piece: dict[str, Any] = {"time": times, "x": place[:, 0], "y": place[:, 1], "yaw": state["heading"]}
        piece["z"] = place[:, 2] if place.shape[1] == 3 else np.zeros(len(times))
        for side in ("length", "width"):
            piece[side] = np.broadcast_to(
                state.get(side, np.nan), (len(times),) + (1,) * (np.ndim(state.get(side)) - 1)
            )
        values = {column: np.asarray(value, np.float64).reshape(len(times))[there] for column, value in piece.items()}
        own = likely_kind(str((track.get("metadata") or {}).get("type")).replace("VEHICLE", ""))
        fixed = {"vehicle_id": str(name), "kind": own if own in BY_NAME else KINDS[track["type"]]}
        pieces.append(values | {column: np.full(int(there.sum()), text, object) for column, text in fixed.items()})
    if not pieces:
        raise ValueError("no tracks of road users")
    columns = {column: np.concatenate([piece[column] for piece in pieces]) for column in COLUMNS}
    notes = (f"{count} tracks of type {kind} are left out" for kind, count in sorted(others.items()))
    return LoadedTable.of(path, columns), tuple(notes)


def _roads(features: Mapping[str, Any], names: Mapping[str, str], *, high: bool) -> list[dict[str, Any]]:
    """Returns the lanes as roads of Waymo's JSON, by `names` that SUMO takes; `high` ones have heights."""
    lanes = {name: feature for name, feature in features.items() if str(feature.get("type")).startswith("LANE_")}
    points = {name: np.asarray(feature["polyline"], np.float64) for name, feature in lanes.items()}
    check_budget("points of lanes", sum(map(len, points.values())), CELLS_MAX / len(COLUMNS))
    return [
        {
            "type": "lane",
            "id": names[name],
            "map_element_id": waymo.BIKE_LANE if feature["type"] == "LANE_BIKE_LANE" else 0,
            "speed_limit_mph": _limit(feature) / waymo.MPH,
            "geometry": [
                {"x": float(point[0]), "y": float(point[1]), "z": float(point[2]) if high else 0.0}
                for point in points[name]
            ],
            "entry_lanes": _named(feature.get("entry_lanes"), names),
            "exit_lanes": _named(feature.get("exit_lanes"), names),
        }
        for name, feature in lanes.items()
    ]


def _named(lanes: Any, names: Mapping[str, str]) -> list[str]:
    """Returns the names of those lanes that the map has."""
    return [names[str(lane)] for lane in (() if lanes is None else lanes) if str(lane) in names]


def _limit(feature: Mapping[str, Any]) -> float:
    """Returns the speed limit of a lane [m/s]; 0 for none."""
    for name, factor in (("speed_limit_mps", 1.0), ("speed_limit_mph", waymo.MPH), ("speed_limit_kmh", 1.0 / 3.6)):
        if (limit := feature.get(name)) is not None and np.isfinite(limit) and limit > 0.0:
            return float(limit) * factor
    return 0.0


def _shown(states: Sequence[Any]) -> list[str]:
    """Returns the name of our state at each time; "unknown" where a light is not seen."""
    plain = [str(state).lower().removeprefix("lane_state_").removeprefix("arrow_") for state in states]
    return [LIGHTS.get(state) or waymo.COLOURS.get(state, "unknown") for state in plain]
