"""What the stack that drives the ego has planned, thinned for pictures: recorded trajectories, by their types."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.core.topic_names import EGO_ROUTE
from litsim_sim.record.bag import BagMessage, BagReader
from litsim_sim.record.decoding import UNDECODABLE, decoded
from litsim_sim.record.run import Run
from litsim_sim.scenario.run_info import EXTERNAL

AUTOWARE, PATH = "autoware_planning_msgs/msg/Trajectory", "nav_msgs/msg/Path"
TYPES = (AUTOWARE, PATH)
"""Types of recorded topics that are plans; of several topics, those of the first type in this list are taken."""
POINTS_MAX = 60  # most points of one plan
AT_REST = 0.05  # [m/s] speed below which the plan is to stand


@dataclass(frozen=True)
class Plans:
    """Planned trajectories of the ego, ordered by step; m of them with P points in all.

    Attributes:
        topic: on which they were published; empty without any.
        step: (m,) at which they came, ascending, each once.
        end: (m,) number of points up to and with the last of each.
        place: (P, 2) points in frame map [m].
        stop: (m,) whether the ego is to stand at the last point.
    """

    topic: str
    step: IntArray
    end: IntArray
    place: FloatArray
    stop: IntArray


NO_PLANS = Plans("", np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0, np.int64))


def read_plans(run: Run) -> Plans:
    """Returns the plans in the bag of a run whose ego an external stack drives, the last of each step; else none.

    Raises:
        InputError: a message on their topic cannot be read.
    """
    if run.info.ego != EXTERNAL:
        return NO_PLANS
    reader = BagReader(run.path)
    topics = [name for kind in TYPES for name, topic in reader.topics.items() if topic.type_name == kind]
    newest: dict[str, dict[int, BagMessage]] = {}
    for message in reader.messages({*topics} - {EGO_ROUTE}):
        newest.setdefault(message.topic, {})[round(message.log_time_ns / (run.info.dt * 1e9))] = message
    topic = next((name for name in topics if name in newest), "")
    if not topic:
        return NO_PLANS
    described = reader.topics[topic]
    plans: list[tuple[int, FloatArray, bool]] = []
    try:
        for step, message in sorted(newest[topic].items()):
            line, stop = _points(decoded(described, message.data), described.type_name)
            if len(line):
                plans.append((step, line, stop))
    except UNDECODABLE as error:
        raise InputError(f"{run.path}: topic {topic}: not a {described.type_name}: {error}") from error
    if not plans:
        return NO_PLANS
    steps, points, stops = zip(*plans, strict=True)
    ends = np.cumsum([len(point) for point in points])
    return Plans(topic, np.array(steps, np.int64), ends, np.concatenate(points), np.array(stops, np.int64))


def _points(message: Any, kind: str) -> tuple[FloatArray, bool]:
    """Returns points (k, 2) [m] of a plan up to where it stands, POINTS_MAX at most, and whether it does."""
    if kind == PATH:
        places = [pose.pose.position for pose in message.poses]
        rest = np.empty(0, np.int64)
    else:
        places = [point.pose.position for point in message.points]
        speed = np.array([point.longitudinal_velocity_mps for point in message.points])
        rest = np.flatnonzero(speed < AT_REST)
        rest = rest[rest > 0]  # that of the first point is where the ego is
    end = int(rest[0]) + 1 if len(rest) else len(places)
    line = np.array([(place.x, place.y) for place in places[:end]], np.float64).reshape(-1, 2)
    line = line[np.isfinite(line).all(axis=1)]
    if len(line) > POINTS_MAX:
        line = line[np.rint(np.linspace(0, len(line) - 1, POINTS_MAX)).astype(int)]
    return line, bool(len(rest))
