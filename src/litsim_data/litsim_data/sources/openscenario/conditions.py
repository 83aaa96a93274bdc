"""Conditions on entities of an OpenSCENARIO storyboard, by where the entities are at each frame.

Speeds and distances are those of frames at 10 Hz, so that a condition holds at most a frame later than in between.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from litsim_data.maps.opendrive_roads import Roads
from litsim_data.sources.openscenario.positions import Positions
from litsim_data.sources.openscenario.xml import UnreadError, child, number
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray

Span = tuple[float, float]
"""First and last time [s] at which a condition holds."""
RULES: dict[str, Callable[[FloatArray, float], BoolArray]] = {
    "greaterThan": np.greater,
    "greaterOrEqual": np.greater_equal,
    "lessThan": np.less,
    "lessOrEqual": np.less_equal,
    "equalTo": lambda values, value: np.abs(values - value) < SAME,
    "notEqualTo": lambda values, value: np.abs(values - value) >= SAME,
}
SAME = 0.05  # [m], [m/s] or [m/s2] within which two figures of frames are equal
STANDING = 0.01  # [m/s]
CARTESIAN = ("cartesianDistance", "euclidianDistance")


@dataclass(frozen=True)
class Seen:
    """An entity at each frame.

    Attributes:
        poses: (n, 3) x, y [m] and heading [rad] of its reference point; NaN where it is absent.
        box: how far ahead and left of that point the middle of its box is, and the box's length and width [m].
        lanes_until: when it leaves the last lane of its road [s]; infinite if never.
    """

    poses: FloatArray
    box: tuple[float, float, float, float]
    lanes_until: float = math.inf

    @cached_property
    def speed(self) -> FloatArray:
        """Speeds (n,) [m/s]."""
        way = np.hypot(*np.diff(self.poses[:, :2], axis=0).T) / STEP_S
        after, before = np.r_[way, np.nan], np.r_[np.nan, way]
        return np.where(np.isnan(after), before, np.where(np.isnan(before), after, 0.5 * (after + before)))

    @cached_property
    def travelled(self) -> FloatArray:
        """Distances (n,) [m] since it is there."""
        way = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        total = np.r_[0.0, np.nancumsum(way)]
        return np.where(np.isnan(self.poses[:, 0]), np.nan, total)

    @cached_property
    def boxes(self) -> np.ndarray:
        """Its boxes (n,) as polygons; empty where it is absent."""
        ahead, left, length, width = self.box
        corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (0.5 * length, 0.5 * width) + (ahead, left)
        cos, sin = np.cos(self.poses[:, 2:]), np.sin(self.poses[:, 2:])
        x = self.poses[:, :1] + cos * corners[:, 0] - sin * corners[:, 1]
        y = self.poses[:, 1:2] + sin * corners[:, 0] + cos * corners[:, 1]
        return np.array(
            [shapely.Polygon(outline) if np.isfinite(outline).all() else None for outline in np.stack([x, y], axis=2)]
        )


class Conditions:
    """Conditions on entities.

    Args:
        seen: returns an entity by its name; it raises UnreadError where its motion is not known.
        positions: the reader of positions.
        roads: returns the roads of the map; it raises UnreadError where there are none.
    """

    def __init__(self, seen: Callable[[str], Seen], positions: Positions, roads: Callable[[], Roads]) -> None:
        self._seen, self._positions, self._roads = seen, positions, roads

    @staticmethod
    def check(condition: ET.Element) -> None:
        """Refuses conditions of kinds that are not read.

        Raises:
            UnreadError: it is one.
        """
        kind = child(condition, "EntityCondition/*")
        if kind.tag not in KINDS:
            raise UnreadError(f"element {kind.tag} is not read")

    def spans(self, condition: ET.Element) -> list[Span]:
        """Returns when a ByEntityCondition holds [s], for any or all of its triggering entities.

        Raises:
            UnreadError: it is not read, or the motion of an entity is not known.
        """
        kind = child(condition, "EntityCondition/*")
        group = child(condition, "TriggeringEntities")
        names = [entity.get("entityRef", "") for entity in group.findall("EntityRef")]
        if not names:
            raise UnreadError(f"element {kind.tag} has no triggering entities")
        held = np.array([KINDS[kind.tag](self, self._seen(name), kind) for name in names])
        every = group.get("triggeringEntitiesRule") == "all"
        return spans_of(np.asarray(held.all(axis=0) if every else held.any(axis=0), np.bool_))

    def _compared(self, values: FloatArray, condition: ET.Element) -> BoolArray:
        rule = condition.get("rule", "")
        if rule not in RULES:
            raise UnreadError(f"element {condition.tag}: rule {rule} is not read")
        return RULES[rule](values, number(condition, "value"))  # NaN compares as false

    def _compared_along(self, values: FloatArray, condition: ET.Element) -> BoolArray:
        if condition.get("direction") not in (None, "longitudinal"):
            raise UnreadError(f"element {condition.tag}: direction {condition.get('direction')} is not read")
        return self._compared(values, condition)

    def _compared_until(self, gap: FloatArray, speed: FloatArray, condition: ET.Element) -> BoolArray:
        """Returns at which frames (n,) times to what is `gap` [m] ahead compare, at a `speed` [m/s] towards it."""
        times = np.full(len(gap), np.nan)
        np.divide(gap, speed, out=times, where=(gap >= 0.0) & (speed > STANDING))
        return self._compared(times, condition)

    def speed(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """Returns at which frames (n,) a SpeedCondition holds; as those below."""
        return self._compared_along(subject.speed, condition)

    def acceleration(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """AccelerationCondition."""
        ends_at_once = len(subject.speed) < 2
        change = np.full(len(subject.speed), np.nan) if ends_at_once else np.gradient(subject.speed, STEP_S)
        return self._compared_along(change, condition)

    def stand_still(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """StandStillCondition."""
        return lasting_for(subject.speed < STANDING, number(condition, "duration"))

    def end_of_road(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """EndOfRoadCondition."""
        times = STEP_S * np.arange(len(subject.poses))
        return np.asarray(times >= subject.lanes_until + number(condition, "duration"), np.bool_)

    def travelled(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """TraveledDistanceCondition."""
        return np.asarray(subject.travelled >= number(condition, "value"), np.bool_)

    def reach(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """ReachPositionCondition."""
        return np.asarray(self._away(subject, condition) <= number(condition, "tolerance"), np.bool_)

    def distance(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """DistanceCondition."""
        if condition.get("freespace") == "true" or condition.get("relativeDistanceType") not in (None, *CARTESIAN):
            raise UnreadError(f"element {condition.tag}: freespace and distances along a road or lane are not read")
        return self._compared(self._away(subject, condition), condition)

    def _away(self, subject: Seen, condition: ET.Element) -> FloatArray:
        """Returns distances (n,) [m] from a position, which may be relative to another entity."""
        position = child(condition, "Position")
        if position.find(".//*[@entityRef]") is None:
            (x, y, _), _ = self._positions.pose(position, 0.0)
            return np.hypot(subject.poses[:, 0] - x, subject.poses[:, 1] - y)
        raise UnreadError(f"element {condition.tag}: positions that move are not read")

    def collision(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """CollisionCondition."""
        other = self._seen(child(condition, "EntityRef").get("entityRef", ""))
        return np.asarray(shapely.intersects(subject.boxes, other.boxes), np.bool_)

    def relative_speed(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """RelativeSpeedCondition."""
        return self._compared(_closing(subject, self._seen(condition.get("entityRef", ""))), condition)

    def relative_distance(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """RelativeDistanceCondition."""
        other, kind = self._seen(condition.get("entityRef", "")), condition.get("relativeDistanceType")
        free = condition.get("freespace") == "true"
        if kind in CARTESIAN:
            apart = np.hypot(*(other.poses - subject.poses)[:, :2].T)
            return self._compared(shapely.distance(subject.boxes, other.boxes) if free else apart, condition)
        if kind == "longitudinal":
            return self._compared(np.abs(self._gap(subject, other, condition)), condition)
        if kind == "lateral" and not free and condition.get("coordinateSystem") in (None, "entity"):
            return self._compared(np.abs(_seen_from(subject, other)[1]), condition)
        raise UnreadError(f"element {condition.tag}: {kind} distances of this kind are not read")

    def headway(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """TimeHeadwayCondition: of who is ahead."""
        gap = self._gap(subject, self._seen(condition.get("entityRef", "")), condition)
        return self._compared_until(gap, subject.speed, condition)

    def time_to_collision(self, subject: Seen, condition: ET.Element) -> BoolArray:
        """TimeToCollisionCondition: with who is ahead and slower."""
        target = child(condition, "TimeToCollisionConditionTarget/*")
        if target.tag != "EntityRef":
            raise UnreadError(f"element {condition.tag}: a target that is a position is not read")
        other = self._seen(target.get("entityRef", ""))
        return self._compared_until(self._gap(subject, other, condition), _closing(subject, other), condition)

    def _gap(self, subject: Seen, other: Seen, condition: ET.Element) -> FloatArray:
        """Returns how far ahead (n,) [m] another entity is, below 0 behind: of its reference point, or free space."""
        system = condition.get("coordinateSystem", "road" if condition.get("alongRoute") == "true" else "entity")
        if system == "entity":
            ahead = _seen_from(subject, other)[0]
        elif system in ("road", "lane"):
            ahead = self._along_road(subject, other)
        else:
            raise UnreadError(f"element {condition.tag}: coordinateSystem {system} is not read")
        if condition.get("freespace") != "true":
            return ahead
        oncoming = np.where(np.cos(other.poses[:, 2] - subject.poses[:, 2]) < 0.0, -1.0, 1.0)
        between = ahead + oncoming * other.box[0] - subject.box[0]
        return np.sign(between) * np.maximum(np.abs(between) - 0.5 * (subject.box[2] + other.box[2]), 0.0)

    def _along_road(self, subject: Seen, other: Seen) -> FloatArray:
        """Returns how far ahead (n,) [m] another entity is along the road, for which both have to be on one."""
        ahead = np.full(len(subject.poses), np.nan)
        for row, (mine, its) in enumerate(zip(subject.poses, other.poses, strict=True)):
            if np.isfinite(mine).all() and np.isfinite(its).all():
                here, there = (self._roads().place(*map(float, pose)) for pose in (mine, its))
                if here is None or there is None:
                    continue  # beside the road, the other is not ahead
                if here.road is not there.road:
                    raise UnreadError("distances along roads are read on one road only")
                along = math.cos(mine[2] - here.pose[2]) > 0.0
                ahead[row] = (there.s - here.s) * (1.0 if along else -1.0)
        return ahead


KINDS: dict[str, Callable[[Conditions, Seen, ET.Element], BoolArray]] = {
    "SpeedCondition": Conditions.speed,
    "AccelerationCondition": Conditions.acceleration,
    "StandStillCondition": Conditions.stand_still,
    "EndOfRoadCondition": Conditions.end_of_road,
    "TraveledDistanceCondition": Conditions.travelled,
    "ReachPositionCondition": Conditions.reach,
    "DistanceCondition": Conditions.distance,
    "CollisionCondition": Conditions.collision,
    "RelativeSpeedCondition": Conditions.relative_speed,
    "RelativeDistanceCondition": Conditions.relative_distance,
    "TimeHeadwayCondition": Conditions.headway,
    "TimeToCollisionCondition": Conditions.time_to_collision,
}
"""What tells when each kind of condition holds."""


def spans_of(held: BoolArray) -> list[Span]:
    """Returns the spans of time of frames (n,) at which something holds; what holds at the last one goes on."""
    edges = np.diff(np.r_[False, held, False].astype(np.int8))
    spans = zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    return [(first * STEP_S, math.inf if end == len(held) else (end - 1) * STEP_S) for first, end in spans]


def lasting_for(held: BoolArray, seconds: float) -> BoolArray:
    """Returns at which frames (n,) something has held for so long."""
    frames = np.arange(len(held))
    since = np.maximum.accumulate(np.where(held, -1, frames))  # last frame at which it did not hold
    return np.asarray(held & ((frames - since - 1) * STEP_S >= seconds - 1e-9), np.bool_)


def _closing(subject: Seen, other: Seen) -> FloatArray:
    """Returns how much faster (n,) [m/s] an entity is than another one is along its heading."""
    return subject.speed - other.speed * np.cos(other.poses[:, 2] - subject.poses[:, 2])


def _seen_from(subject: Seen, other: Seen) -> tuple[FloatArray, FloatArray]:
    """Returns how far ahead and left (n,) [m] of an entity another one is."""
    away = (other.poses - subject.poses)[:, :2]
    return to_body(away[:, 0], away[:, 1], subject.poses[:, 2])
