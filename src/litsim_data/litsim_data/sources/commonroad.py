"""CommonRoad scenarios: lanelets, obstacles with their trajectories, and cycles of traffic lights, in one XML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.maps.commonroad import read_graph, read_root
from litsim_data.maps.lane_graph import LaneGraph
from litsim_data.sources.source import Scene, SignalChange, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import read_head
from litsim_sim.scenario.signals import NAMES

KINDS = {
    "car": "car",
    "parkedvehicle": "car",
    "taxi": "car",
    "priorityvehicle": "car",
    "truck": "truck",
    "bus": "truck",
    "motorcycle": "motorcycle",
    "bicycle": "bicycle",
    "pedestrian": "pedestrian",
    "unknown": "unknown",
}
"""Our kinds of CommonRoad's types of obstacles, in lower case; others, such as buildings and trains, are left out."""
STATES = {"redyellow": "red_amber", "inactive": "off"}
"""Names of states that are not those of :data:`litsim_sim.scenario.signals.NAMES`, in lower case."""


class CommonRoad(Source):
    """Scenarios of a few seconds; their planning problems are not used: an ego is one of the recorded vehicles."""

    content = "a CommonRoad scenario with dynamic obstacles"
    licence = "as the source of the scenario says"
    citation = "Althoff, Koschi, Manzinger, CommonRoad: Composable Benchmarks for Motion Planning on Roads, IV 2017"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return b"<commonRoad" in read_head(path)

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        root = read_root(path)
        try:
            step = float(root.get("timeStepSize", ""))
        except ValueError as error:
            raise InputError(f"{path}: attribute timeStepSize: {error}") from error
        table, left_out = _table(root, path)
        tracks = LoadedTable.of(path, table)
        # A file is small, its units are fixed.
        mapping = tracks.meaning(KINDS, rate_hz=1.0 / step, accept=["speed", "heading", "side", "size"])
        problems = len(root.findall("planningProblem"))
        notes = [f"{count} obstacles are left out: {why}" for why, count in sorted(left_out.items())]
        notes += [f"{problems} planning problems are not used: an ego is one of the vehicles"] if problems else []
        name = root.get("benchmarkID") or path.stem
        source = root.get("source", "")
        notes += [f"source of the scenario: {source}"] if source else []
        signals = _signals(root, step, int(table["frame"].max()), path)

        def map_of() -> LaneGraph:
            return read_graph(root if lanes is None else read_root(lanes), lanes or path)

        yield Scene(name, tracks, mapping, map_of, name, signals, notes=tuple(notes))


def _table(root: ET.Element, path: Path) -> tuple[pd.DataFrame, Counter[str]]:
    """Returns the states of the obstacles, and the numbers of obstacles left out, by why."""
    rows: list[tuple[Any, ...]] = []
    left_out: Counter[str] = Counter()
    elements = [*root.findall("dynamicObstacle"), *root.findall("staticObstacle"), *root.findall("obstacle")]
    last = max((int(t.text or 0) for t in root.findall("dynamicObstacle/trajectory/state/time/exact")), default=0)
    for element in elements:
        number, kind = element.get("id", "?"), element.findtext("type", "").lower()
        if kind not in KINDS:
            left_out[f"type {kind or 'none'}"] += 1
            continue
        initial = element.find("initialState")
        states = [*([] if initial is None else [initial]), *element.findall("trajectory/state")]
        fixed = element.tag == "staticObstacle" or element.findtext("role") == "static"
        if not fixed and len(states) < 2:
            left_out["no trajectory of single states"] += 1
            continue
        try:
            size = _size(element)
            found = [_state(state) for state in states]
        except ValueError as error:
            raise InputError(f"{path}: obstacle {number}: {error}") from error
        if fixed:
            found = [(step, *found[0][1:]) for step in range(last + 1)]
        rows += [(number, kind, *size, *state) for state in found]
    if not rows:
        why = f"; left out: {dict(left_out)}" if left_out else ""
        raise InputError(f"{path}: no dynamic obstacles with trajectories{why}: as a map alone, see data map")
    columns = ["vehicle_id", "kind", "length", "width", "frame", "x", "y", "yaw", "speed"]
    return pd.DataFrame(rows, columns=columns), left_out


def _size(element: ET.Element) -> tuple[float, float]:
    """Returns length and width [m] of an obstacle: a rectangle or a circle."""
    shape = element.find("shape")
    if shape is None:
        raise ValueError("no shape")
    if (radius := shape.findtext("circle/radius")) is not None:
        return 2.0 * float(radius), 2.0 * float(radius)
    return _number(shape.find("rectangle/length")), _number(shape.find("rectangle/width"))


def _state(state: ET.Element) -> tuple[int, float, float, float, float]:
    """Returns step, x, y [m], orientation [rad] and speed [m/s] of a state."""
    place = state.find("position/point")
    place = state.find("position/*/center") if place is None else place
    if place is None:
        raise ValueError("a state without a position that is a point")
    x, y = (_number(place.find(axis)) for axis in "xy")
    speed = state.find("velocity")
    return (
        round(_value(state.find("time"))),
        x,
        y,
        _value(state.find("orientation")),
        0.0 if speed is None else _value(speed),
    )


def _value(element: ET.Element | None) -> float:
    """Returns a value that is exact, or the middle of an interval."""
    if element is None:
        raise ValueError("a state without time or orientation")
    if (exact := element.find("exact")) is not None:
        return _number(exact)
    return 0.5 * (_number(element.find("intervalStart")) + _number(element.find("intervalEnd")))


def _number(element: ET.Element | None) -> float:
    if element is None:
        raise ValueError("a number is missing")
    return float(element.text or "")


def _signals(root: ET.Element, step: float, last: int, path: Path) -> list[SignalChange]:
    """Returns the changes of all traffic lights, whose cycles are given in steps, up to the step `last`."""
    changes: list[SignalChange] = []
    for light in root.findall("trafficLight"):
        cycle = light.find("cycle") if light.find("cycle") is not None else light.find("trafficLightCycle")
        elements = [] if cycle is None else cycle.findall("cycleElement")
        if cycle is None or not elements or light.findtext("active", "true") == "false":
            continue
        try:
            lasts = [int(element.findtext("duration", "")) for element in elements]
            begin = int(cycle.findtext("timeOffset", "0"))
        except ValueError as error:
            raise InputError(f"{path}: traffic light {light.get('id')}: {error}") from error
        period = sum(lasts)
        if min(lasts) < 1:
            raise InputError(f"{path}: traffic light {light.get('id')}: duration {min(lasts)}, expected at least 1")
        begin -= period * -(-begin // period)  # of the cycle that runs at step 0
        colours = [element.findtext("color", "").lower() for element in elements]
        while begin <= last:
            for begun, colour in zip(accumulate(lasts[:-1], initial=begin), colours, strict=True):
                state = STATES.get(colour, colour)
                if state not in NAMES:
                    raise InputError(f"{path}: traffic light {light.get('id')}: colour {colour!r} is unknown")
                changes.append((begun * step, light.get("id", ""), state))
            begin += period
    return sorted(changes)
