"""Runs and scenarios as OpenSCENARIO XML 1.2: every agent follows a trajectory in time, on an OpenDRIVE map beside."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd

from litsim_data.exports.export import Content, Export, add, beside, write_xml
from litsim_data.exports.opendrive import OpenDrive
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.core.vehicle import HEIGHTS
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.signals import Signals

CATEGORIES = {Kind.TRUCK: "truck", Kind.MOTORCYCLE: "motorbike", Kind.BICYCLE: "bicycle"}
"""Vehicle category of kinds that are neither cars nor pedestrians."""
MASS = 75.0  # [kg] of pedestrians, which is not recorded
WHEELBASE = 0.6  # of the length; the reference point of a vehicle is the middle of its rear axle
LAMPS = {
    SignalState.FLASHING_RED: "flashing;off;off",
    SignalState.RED: "on;off;off",
    SignalState.RED_AMBER: "on;on;off",
    SignalState.GREEN_PERMISSIVE: "off;off;on",
    SignalState.GREEN: "off;off;on",
    SignalState.AMBER_PERMISSIVE: "off;on;off",
    SignalState.AMBER: "off;on;off",
    SignalState.FLASHING_AMBER: "off;flashing;off",
}
"""What the red, yellow and green lamp of a signal show; others are dark."""
PERFORMANCE = {"maxSpeed": 70, "maxAcceleration": 10, "maxDeceleration": 10}


class OpenScenario(Export):
    """Agents are there from their first frame to their last; lights show what they did."""

    endings, content = (".xosc",), "OpenSCENARIO XML 1.2, with OpenDRIVE beside"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        table, road = content.motion(), beside(out, ".xodr")
        lines = OpenDrive().write(content, road)
        root = ET.Element("OpenSCENARIO")
        origin = "; ".join(filter(None, (content.source, content.licence)))
        header = {"revMajor": 1, "revMinor": 2, "date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S}", "author": "LitSim"}
        add(root, "FileHeader", description=f"{content.name}{f': {origin}' if origin else ''}", **header)
        add(root, "CatalogLocations")
        add(root, "RoadNetwork/LogicFile", filepath=road.name)
        entities, board = add(root, "Entities"), add(root, "Storyboard")
        start = add(board, "Init/Actions")
        act = add(board, "Story", name="motion")
        act = add(act, "Act", name="motion")
        if content.signals is not None and len(content.signals.links):
            _add_signals(start, act, content.signals, content.net_file())
        end = float(table["t"].max())
        for vehicle, track in table.groupby("vehicle_id"):
            name = "Ego" if vehicle == content.ego else f"agent_{vehicle}"
            shift = _entity(entities, name, track.iloc[0])
            poses = pd.DataFrame(
                {
                    "x": track["x"] - shift * np.cos(track["yaw"]),
                    "y": track["y"] - shift * np.sin(track["yaw"]),
                    "h": track["yaw"],
                }
            )
            rows = [dict(zip("xyh", pose, strict=True)) for pose in poses.round(6).to_numpy().tolist()]
            self._follow(start, act, name, track["t"].tolist(), rows, end)
        _at(act, "StartTrigger", 0.0)
        _at(board, "StopTrigger", end)
        write_xml(root, out)
        return [content.counts, f"beside it: {road.name}", *lines]

    def _follow(
        self,
        start: ET.Element,
        act: ET.Element,
        name: str,
        times: list[float],
        poses: list[dict[str, float]],
        end: float,
    ) -> None:
        """Adds how an entity appears, follows its poses at `times` [s], and disappears before the `end` [s]."""
        group = add(act, "ManeuverGroup", name=name, maximumExecutionCount=1)
        add(add(group, "Actors", selectTriggeringEntities="false"), "EntityRef", entityRef=name)
        maneuver = add(group, "Maneuver", name=name)
        event = _event(maneuver, f"{name}_follows")
        if times[0] == 0.0:
            there = add(start, "Private", entityRef=name)
            add(there, "PrivateAction/TeleportAction/Position/WorldPosition", **poses[0])
        else:
            entity = add(add(event, "Action", name=f"{name}_appears"), "GlobalAction/EntityAction", entityRef=name)
            add(entity, "AddEntityAction/Position/WorldPosition", **poses[0])
        following = add(
            add(event, "Action", name=f"{name}_follows"), "PrivateAction/RoutingAction/FollowTrajectoryAction"
        )
        trajectory = add(following, "TrajectoryRef/Trajectory", name=name, closed="false")
        line = add(trajectory, "Shape/Polyline")
        for time, pose in zip(times, poses, strict=True):
            add(add(line, "Vertex", time=f"{time:g}"), "Position/WorldPosition", **pose)
        add(following, "TimeReference/Timing", domainAbsoluteRelative="absolute", scale=1, offset=0)
        add(following, "TrajectoryFollowingMode", followingMode="position")
        _at(event, "StartTrigger", times[0])
        if times[-1] < end:
            event = _event(maneuver, f"{name}_disappears")
            entity = add(add(event, "Action", name=f"{name}_disappears"), "GlobalAction/EntityAction", entityRef=name)
            add(entity, "DeleteEntityAction")
            _at(event, "StartTrigger", times[-1])


def _add_signals(start: ET.Element, act: ET.Element, signals: Signals, net: Path) -> None:
    """Adds what the signals of the OpenDRIVE map show at first, and as events all their changes.

    netconvert names signals after the lights of the `net` and the positions of their links.
    """
    own = {link.name: link for link in read_links(net)}
    names = [f"{own[link.name].light}_{own[link.name].index}" for link in signals.links]
    states = signals.states[signals.link_group]
    for name, state in zip(names, states[:, 0].tolist(), strict=True):
        _show(start, name, state)
    changes = states[:, 1:] != states[:, :-1]
    group = add(act, "ManeuverGroup", name="signals", maximumExecutionCount=1)
    add(group, "Actors", selectTriggeringEntities="false")
    maneuver = add(group, "Maneuver", name="signals")
    for step in changes.any(axis=0).nonzero()[0].tolist():
        time = STEP_S * (step + 1)
        event = _event(maneuver, f"signals at {time:g} s")
        for row in changes[:, step].nonzero()[0].tolist():
            action = add(event, "Action", name=f"signal {names[row]} at {time:g} s")
            _show(action, names[row], int(states[row, step + 1]))
        _at(event, "StartTrigger", time)


def _show(parent: ET.Element, name: str, state: int) -> None:
    """Adds an action by which a signal shows a :class:`SignalState`."""
    action = add(parent, "GlobalAction/InfrastructureAction/TrafficSignalAction")
    add(action, "TrafficSignalStateAction", name=name, state=LAMPS.get(SignalState(state), "off;off;off"))


def _entity(entities: ET.Element, name: str, row: pd.Series) -> float:
    """Adds an entity; returns how far before its reference point the centre of its box is [m]."""
    kind, scenario_object = Kind(int(row["kind"])), add(entities, "ScenarioObject", name=name)
    walks = kind is Kind.PEDESTRIAN
    if walks:
        entity = add(scenario_object, "Pedestrian", name=name, mass=MASS, pedestrianCategory="pedestrian")
    else:
        entity = add(scenario_object, "Vehicle", name=name, vehicleCategory=CATEGORIES.get(kind, "car"))
    shift = 0.0 if walks else round(0.5 * WHEELBASE * row["length"], 6)
    box = add(entity, "BoundingBox")
    add(box, "Center", x=shift, y=0, z=0.5 * HEIGHTS[kind])
    add(box, "Dimensions", width=row["width"], length=row["length"], height=HEIGHTS[kind])
    if not walks:
        add(entity, "Performance", **PERFORMANCE)
        wheels = {"maxSteering": 0.6, "wheelDiameter": 0.6, "trackWidth": 0.9 * row["width"], "positionZ": 0.3}
        axles = add(entity, "Axles")
        add(axles, "FrontAxle", positionX=2.0 * shift, **wheels)
        add(axles, "RearAxle", positionX=0, **wheels | {"maxSteering": 0})
    add(entity, "Properties")
    return shift


def _event(maneuver: ET.Element, name: str) -> ET.Element:
    return add(maneuver, "Event", name=name, priority="parallel", maximumExecutionCount=1)


def _at(parent: ET.Element, kind: str, time: float) -> None:
    """Adds a trigger of this kind that fires at a time of the simulation [s]."""
    condition = add(parent, f"{kind}/ConditionGroup/Condition", name=f"at {time:g} s", delay=0, conditionEdge="none")
    add(condition, "ByValueCondition/SimulationTimeCondition", value=f"{time:g}", rule="greaterOrEqual")
