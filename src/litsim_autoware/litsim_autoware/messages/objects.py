"""Agents and traffic lights as Autoware's perception publishes them, of ``autoware_perception_msgs``.

Objects are boxes in frame map at the middle of their height. Their predicted path is that of LitSim's own forecast, and
keeps speed and heading where there is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_autoware.messages.cdr import TIME, Fields, ListMessage, RecordList, header, stamped
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, ByteArray, FloatArray, IntArray, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.core.vehicle import HEIGHTS
from litsim_sim.ego_port.object_ids import uuids_of
from litsim_sim.lane_map.signal_links import relation_id
from litsim_sim.scenario.signals import Signals

POSES, POSE_S = 11, 0.5  # poses of a predicted path, [s] between them
LABELS = {Kind.CAR: 1, Kind.TRUCK: 2, Kind.MOTORCYCLE: 5, Kind.BICYCLE: 6, Kind.PEDESTRIAN: 7, Kind.UNKNOWN: 0}
AVAILABLE = 2  # of the orientation
RED, AMBER, GREEN, UNKNOWN_COLOUR = 1, 2, 3, 0
CIRCLE, OFF, ON, FLASHING = 1, 1, 2, 3
LIGHTS = {
    SignalState.UNAVAILABLE: (UNKNOWN_COLOUR, 0),
    SignalState.DARK: (UNKNOWN_COLOUR, OFF),
    SignalState.FLASHING_RED: (RED, FLASHING),
    SignalState.RED: (RED, ON),
    SignalState.RED_AMBER: (RED, ON),
    SignalState.GREEN_PERMISSIVE: (GREEN, ON),
    SignalState.GREEN: (GREEN, ON),
    SignalState.AMBER_PERMISSIVE: (AMBER, ON),
    SignalState.AMBER: (AMBER, ON),
    SignalState.FLASHING_AMBER: (AMBER, FLASHING),
}
"""Colour and status of an element of a traffic light by what a signal shows."""

_SEEN: Fields = (
    ("uuid", "(16,)u1"),
    ("existence", "f4"),
    ("classes", "u4"),
    ("label", "u1"),
    ("probability", "f4"),
)
_POSE: Fields = (("position", "(3,)f8"), ("orientation", "(4,)f8"), ("pose_covariance", "(36,)f8"))
_TWIST: Fields = (("twist", "(6,)f8"), ("twist_covariance", "(36,)f8"))
_ACCEL: Fields = (("acceleration", "(6,)f8"), ("acceleration_covariance", "(36,)f8"))
_SHAPE: Fields = (("shape", "u1"), ("corners", "u4"), ("size", "(3,)f8"))
_PATH: Fields = (
    ("paths", "u4"),
    ("poses", "u4"),
    ("path", f"({POSES},7)f8"),
    ("path_sec", "i4"),
    ("path_nanosec", "u4"),
    ("confidence", "f4"),
)

PREDICTED = ListMessage(header("map"), _SEEN, (*_POSE, *_TWIST, *_ACCEL, *_PATH, *_SHAPE))
TRACKED = ListMessage(header("map"), _SEEN, (*_POSE, *_TWIST, *_ACCEL, ("oriented", "u1"), ("still", "u1"), *_SHAPE))
GROUPS = ListMessage(
    TIME,
    (),
    (
        ("group", "i8"),
        ("elements", "u4"),
        ("colour", "u1"),
        ("form", "u1"),
        ("status", "u1"),
        ("confidence", "f4"),
        ("predictions", "u4"),
    ),
)

_TIMES: FloatArray = POSE_S * np.arange(POSES, dtype=np.float64)  # [s]
_LABELS = np.zeros(256, np.uint8)
_HEIGHTS = np.full(256, HEIGHTS[Kind.UNKNOWN])
for _kind, _height in HEIGHTS.items():
    _LABELS[_kind], _HEIGHTS[_kind] = LABELS[_kind], _height
_LIGHTS = np.zeros((256, 2), np.uint8)
for _state, _light in LIGHTS.items():
    _LIGHTS[_state] = _light


@dataclass(frozen=True)
class Forecast:
    """LitSim's forecasts of some agents, each of the most probable manoeuvre.

    Attributes:
        step: at which they were made.
        dt: time between their points [s]; the first lies as long after the step.
        id: (n,) of the agents, ascending.
        mean: (n, T, 2) box centres in frame map [m].
        yaw: (n, T) headings [rad].
        probability: (n,) of the manoeuvre.
        valid: (n,) whether there is a forecast.
    """

    step: int
    dt: float
    id: IntArray
    mean: FloatArray
    yaw: FloatArray
    probability: FloatArray
    valid: BoolArray

    def rows(self, ids: IntArray) -> tuple[IntArray, IntArray]:
        """Places among `ids` (m,) of those that have a forecast, and their rows here."""
        if not len(self.id) or self.mean.shape[1] < 2:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        row = np.minimum(np.searchsorted(self.id, ids), len(self.id) - 1)
        place = np.flatnonzero((self.id[row] == ids) & self.valid[row])
        return place, row[place]

    def at(self, rows: IntArray, step: int, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (r, k, 2) [m] and headings (r, k) [rad] at `times` (k,) after a step [s].

        They are interpolated between the points; after the last, an agent keeps the velocity that it has there.
        """
        point = (times + STEP_S * (step - self.step)) / self.dt - 1.0
        before = np.clip(np.floor(point).astype(np.int64), 0, self.mean.shape[1] - 2)
        share = point - before
        near, far = self.mean.take(before, 1), self.mean.take(before + 1, 1)
        yaw, turn = self.yaw.take(before, 1), wrap_angle(self.yaw.take(before + 1, 1) - self.yaw.take(before, 1))
        return (near + share[:, None] * (far - near))[rows], (yaw + np.minimum(share, 1.0) * turn)[rows]


def predicted_objects(table: AgentTable, stamp_ns: int, forecast: Forecast | None = None) -> bytes:
    """``PredictedObjects`` of all agents of `table`, with the paths of a `forecast` of this step or one before."""
    records = _filled(PREDICTED, table)
    body = records.body
    body["paths"], body["poses"], body["confidence"] = 1, POSES, 1.0
    body["path_sec"], body["path_nanosec"] = divmod(round(POSE_S * 1e9), 10**9)
    way = table.speed[:, None] * _TIMES
    path = body["path"]
    path[:, :, 0] = table.x[:, None] + way * np.cos(table.yaw)[:, None]
    path[:, :, 1] = table.y[:, None] + way * np.sin(table.yaw)[:, None]
    path[:, :, 2] = body["position"][:, None, 2]
    path[:, :, 5:] = body["orientation"][:, None, 2:]
    if forecast is not None:
        places, rows = forecast.rows(table.id)
        mean, yaw = forecast.at(rows, table.step, _TIMES[1:])
        path[places, 1:, :2] = mean
        path[places, 1:, 5], path[places, 1:, 6] = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
        body["confidence"][places] = forecast.probability[rows]
    return records.data(stamped(stamp_ns))


def tracked_objects(table: AgentTable, stamp_ns: int) -> bytes:
    """``TrackedObjects`` of all agents of `table`."""
    records = _filled(TRACKED, table)
    records.body["oriented"], records.body["still"] = AVAILABLE, table.speed == 0.0
    return records.data(stamped(stamp_ns))


def lights_of(signals: Signals | None) -> tuple[IntArray, IntArray]:
    """Ids of Lanelet2 relations that are traffic lights, and the group of each among those of `signals`.

    A group whose name is a number is that relation, as in a map that was imported; and every connection is one of its
    own, as in a map that was exported.
    """
    if signals is None:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    numbered = {int(name): row for row, name in enumerate(signals.groups) if name.isascii() and name.isdigit()}
    links = zip(signals.link_names, signals.link_group.tolist(), strict=True)
    lights = {relation_id(name): group for name, group in links} | numbered
    return np.array([*lights], np.int64), np.array([*lights.values()], np.int64)


def traffic_lights(groups: IntArray, states: ByteArray, stamp_ns: int) -> bytes:
    """``TrafficLightGroupArray`` of groups (n,), the ids of their Lanelet2 relations, and what they show (n,)."""
    records = GROUPS.records(len(groups))
    body = records.body
    body["group"], body["elements"], body["form"], body["confidence"] = groups, 1, CIRCLE, 1.0
    body["colour"], body["status"] = _LIGHTS[states].T
    return records.data(stamped(stamp_ns))


def quaternions(yaw: FloatArray) -> FloatArray:
    """(n, 4) of rotations by `yaw` (n,) about the vertical [rad]."""
    turns = np.zeros((len(yaw), 4))
    turns[:, 2], turns[:, 3] = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    return turns


def _filled(message: ListMessage, table: AgentTable) -> RecordList:
    """Records with what all kinds of objects have."""
    records = message.records(len(table))
    for name in ("existence", "probability", "classes"):
        records.head(name, 1)
    records.head("label", _LABELS[table.kind])
    records.head("uuid", uuids_of(table.id))
    body, height = records.body, _HEIGHTS[table.kind]
    place, size = body["position"], body["size"]
    place[:, 0], place[:, 1], place[:, 2] = table.x, table.y, 0.5 * height
    size[:, 0], size[:, 1], size[:, 2] = table.length, table.width, height
    body["orientation"] = quaternions(table.yaw)
    body["twist"][:, 0], body["twist"][:, 5] = table.speed, table.yaw_rate
    body["acceleration"][:, 0] = table.acceleration
    return records
