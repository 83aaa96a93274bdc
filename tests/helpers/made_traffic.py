"""Traffic made by hand: vehicles that drive straight, change lanes and brake as told, or follow a path; their log."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from litsim_data.mining.events import Situation
from litsim_data.mining.signals import WaySignals
from litsim_sim.core.scene import STEP_S, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.net_lanes import Lane
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.recording import COLUMNS, Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged

SECONDS = 12.0
LANE_WIDTH = 3.66
MOTORWAY = LaneMap.from_net(packaged("nets/us101_like.net.xml"))
"""Lanes along +x from 0 to 640 m, the leftmost at y = -1.83 m; from 176 to 389 m an auxiliary lane from the on-ramp."""
STREET = LaneMap.from_net(packaged("nets/urban_like.net.xml"))


def lane_y(lane: float) -> float:
    """Centre of a lane of the motorway, 0 for the leftmost and 5 for the auxiliary one [m]."""
    return -LANE_WIDTH * (lane + 0.5)


@dataclass(frozen=True)
class Vehicle:
    """A vehicle's centre at every step of 0.1 s.

    Attributes:
        x, y: (steps,) [m].
        first: step of its first row.
    """

    id: int
    x: FloatArray
    y: FloatArray
    first: int = 0
    length: float = 4.5
    width: float = 2.0
    kind: int = 0

    def rows(self) -> pd.DataFrame:
        """The recording's rows; speeds, headings and accelerations are those of the positions."""
        vx, vy = np.gradient(self.x, STEP_S), np.gradient(self.y, STEP_S)
        speed = np.hypot(vx, vy)
        moving = speed > 1e-6
        yaw = np.unwrap(np.arctan2(vy, vx))
        if moving.any():  # a standing vehicle keeps its heading
            at = np.maximum.accumulate(np.where(moving, np.arange(len(yaw)), 0))
            yaw = yaw[np.where(moving[at], at, int(np.argmax(moving)))]
        values = {
            "vehicle_id": self.id,
            "frame": self.first + np.arange(len(self.x)),
            "x": self.x,
            "y": self.y,
            "yaw": yaw,
            "speed": speed,
            "acceleration": np.gradient(speed, STEP_S),
            "length": self.length,
            "width": self.width,
            "kind": self.kind,
            "lane": -1,
        }
        return pd.DataFrame(values)[list(COLUMNS)]


def times(seconds: float = SECONDS) -> FloatArray:
    return np.arange(round(seconds / STEP_S) + 1) * STEP_S


def straight(number: int, x: float, speed: float, lane: float, seconds: float = SECONDS) -> Vehicle:
    """Keeps its lane and its speed."""
    t = times(seconds)
    return Vehicle(number, x + speed * t, np.full(len(t), lane_y(lane)))


def braking(number: int, x: float, lane: float, speeds: Sequence[tuple[float, float]]) -> Vehicle:
    """Keeps its lane; its speed runs straight between the (time, speed) given."""
    t = times()
    speed = np.interp(t, *zip(*speeds, strict=True))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * STEP_S)])
    return Vehicle(number, x + way, np.full(len(t), lane_y(lane)))


def changing(number: int, x: float, speed: float, lanes: Sequence[tuple[float, float]]) -> Vehicle:
    """Keeps its speed along the road; its lane runs straight between the (time, lane) given."""
    t = times()
    return Vehicle(number, x + speed * t, lane_y(np.interp(t, *zip(*lanes, strict=True))))


def on_path(
    number: int, lanes: Sequence[str], begin: float, speed: float | Sequence[tuple[float, float]], seconds: float = 25.0
) -> Vehicle:
    """Drives along lanes of the street, from `begin` metres on, until they end.

    Its speed is constant, or runs straight between the (time, speed) given.
    """
    points = np.concatenate([STREET.lanes[STREET.row(name)].centerline for name in through(lanes)])
    keep = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-3])
    points = points[keep]
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    t = times(seconds)
    pace = np.interp(t, *zip(*speed, strict=True)) if isinstance(speed, Sequence) else np.full(len(t), speed)
    way = begin + np.append(0.0, np.cumsum(0.5 * STEP_S * (pace[1:] + pace[:-1])))
    way = way[way <= s[-1]]
    return Vehicle(number, np.interp(way, s, points[:, 0]), np.interp(way, s, points[:, 1]))


def through(lanes: Sequence[str]) -> list[str]:
    """`lanes` of the street with those inside junctions that lead from each to the next."""
    names = [lanes[0]]
    for target in lanes[1:]:
        inside = next(iter(_between(names[-1], target)))
        names += [*inside, target]
    return names


def _between(start: str, end: str) -> list[list[str]]:
    ways, found = [[start]], []
    while ways:
        way = ways.pop()
        for name in STREET.lanes[STREET.row(way[-1])].successors:
            if name == end:
                found.append(way[1:])
            elif STREET.lanes[STREET.row(name)].is_internal:
                ways.append([*way, name])
    return found


def log_of(*vehicles: Vehicle) -> Log:
    table = pd.concat([vehicle.rows() for vehicle in vehicles], ignore_index=True)
    recording = Recording.from_table(RecordingHeader("made"), table, "made")
    return Log.from_recording(recording, 0, int(table["frame"].max()) + 1)


def situation(*vehicles: Vehicle, lane_map: LaneMap = MOTORWAY, signals: WaySignals | None = None) -> Situation:
    return Situation.of(log_of(*vehicles), lane_map, signals)


def mirrored_lanes(lane_map: LaneMap) -> LaneMap:
    """The same net with y mirrored: left and right are exchanged."""
    count: dict[str, int] = {}
    for lane in lane_map.lanes:
        count[lane.edge_id] = max(count.get(lane.edge_id, 0), lane.index + 1)
    return LaneMap([_mirrored(lane, count[lane.edge_id]) for lane in lane_map.lanes])


def _mirrored(lane: Lane, count: int) -> Lane:
    line = lane.centerline * np.array([1.0, -1.0])
    return replace(lane, centerline=line, index=count - 1 - lane.index, left=lane.right, right=lane.left)


def mirrored_log(log: Log) -> Log:
    return replace(log, y=-log.y, yaw=-log.yaw, yaw_rate=-log.yaw_rate)
