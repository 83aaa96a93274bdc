"""Transitions of OpenSCENARIO's actions: how long they last, their shapes, and those to another place of the road."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.opendrive_roads import Place, Pose
from litsim_data.sources.openscenario.positions import LATEST, Positions, lane_beside
from litsim_data.sources.openscenario.xml import UnreadError, child, number
from litsim_sim.core.scene import FloatArray

EASED: dict[str, tuple[Callable[[FloatArray], FloatArray], float]] = {
    "linear": (lambda share: share, 1.0),
    "cubic": (lambda share: share**2 * (3.0 - 2.0 * share), 1.5),
    "sinusoidal": (lambda share: 0.5 - 0.5 * np.cos(np.pi * share), 0.5 * math.pi),
}
"""Share of a change of speed by the share of its time, and its greatest slope, by dynamicsShape."""


STRONGEST = {"cubic": 6.0, "sinusoidal": 0.5 * math.pi**2}
"""Greatest curvature of a change, by dynamicsShape: the acceleration of a move of 1 m within 1 s."""


class Aside(NamedTuple):
    """A change of lane: to a place `shift` to the left [m], from `begin` on, that `lasts` so long, both [s] or [m]."""

    action: ET.Element
    shift: float
    begin: float
    lasts: float
    shape: str
    by_time: bool

    def moved(self, when: FloatArray) -> FloatArray:
        """Returns how far to the left the entity has moved [m] at times [s], or after ways [m]."""
        return self.shift * EASED[self.shape][0](np.clip((when - self.begin) / self.lasts, 0.0, 1.0))


def lasting(dynamics: ET.Element, change: float, mean: float) -> float:
    """Returns how long a change of speed lasts [s].

    Args:
        dynamics: the SpeedActionDynamics.
        change, mean: of the speed, and the speed on average [m/s].

    Raises:
        UnreadError: the dynamics are not read.
    """
    shape, dimension, value = (
        dynamics.get("dynamicsShape"),
        dynamics.get("dynamicsDimension"),
        number(dynamics, "value"),
    )
    if shape == "step":
        return 0.0
    value = abs(value) if dimension == "rate" else value  # some give that of braking as below 0
    if shape not in EASED or dimension not in ("time", "rate", "distance") or value < 0.0:
        raise UnreadError(f"element SpeedActionDynamics: {dimension} {value:g} of shape {shape} is not read")
    if dimension == "time":
        return value
    per = value if dimension == "rate" else abs(mean)
    amount = EASED[shape][1] * abs(change) if dimension == "rate" else value
    return min(amount / per, LATEST) if per > 0.0 else 0.0


def lane_change(change: ET.Element, pose: Pose, time: float, positions: Positions) -> Aside:
    """Returns the move of a LaneChangeAction from a pose on, at a time [s]; its beginning is left open.

    Raises:
        UnreadError: the action is not read, or there is no such lane.
    """
    dynamics, target = child(change, "LaneChangeActionDynamics"), child(change, "LaneChangeTarget/*")
    place = positions.on_road(change, "it", pose)
    lane = _target_lane(target, time, positions)
    middle = place.road.middle(lane, place.s)
    if middle is None:
        raise UnreadError(f"element {target.tag}: road {place.road.id:.60} has no lane {lane} at s {place.s:g}")
    shift = (middle[0] - place.t) * side_of(place, pose) + number(change, "targetLaneOffset", 0.0)
    by_time = dynamics.get("dynamicsDimension") != "distance"
    return Aside(change, shift, 0.0, lasting(dynamics, shift, 1.0), dynamics.get("dynamicsShape", ""), by_time)


def lane_offset(offset: ET.Element, pose: Pose, positions: Positions) -> Aside:
    """Returns the move of a LaneOffsetAction from a pose on; its beginning is left open.

    Raises:
        UnreadError: the action is not read.
    """
    target, dynamics = (
        child(offset, "LaneOffsetTarget/AbsoluteTargetLaneOffset"),
        child(offset, "LaneOffsetActionDynamics"),
    )
    shape, most = dynamics.get("dynamicsShape", ""), number(dynamics, "maxLateralAcc")
    if shape not in STRONGEST or most <= 0.0:
        raise UnreadError(f"element LaneOffsetAction: maxLateralAcc {most:g} of shape {shape} is not read")
    place = positions.on_road(offset, "it", pose)
    middle = place.road.middle(place.lane, place.s)
    shift = 0.0 if middle is None else (middle[0] - place.t) * side_of(place, pose) + number(target, "value")
    return Aside(offset, shift, 0.0, math.sqrt(STRONGEST[shape] * abs(shift) / most), shape, by_time=True)


def _target_lane(target: ET.Element, time: float, positions: Positions) -> int:
    """Returns the number of the lane that a LaneChangeAction leads to."""
    count = int(number(target, "value"))
    if target.tag == "AbsoluteTargetLane":
        return count
    name = target.get("entityRef", "")
    pose = positions.pose_of(name, time)
    place = positions.on_road(target, name, pose)
    return lane_beside(place.lane, int(count * side_of(place, pose)))


def side_of(place: Place, pose: Pose) -> float:
    """Returns 1 for a pose along its road, whose left is the road's left, and -1 for a pose against its road."""
    return 1.0 if math.cos(pose[2] - place.pose[2]) > 0.0 else -1.0
