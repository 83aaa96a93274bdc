"""Positions and trajectories of OpenSCENARIO in the frame of the map."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.opendrive_roads import STEP, Place, Pose, Road, Roads
from litsim_data.sources.openscenario.xml import UnreadError, child, number
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.recording import BOUNDS

FASTEST = BOUNDS["speed"][1]
LATEST = 86_400.0  # [s] at which something happens, at most


@dataclass(frozen=True)
class Track:
    """Poses (n, 3), x, y [m] and heading [rad], at times (n,) [s], or at distances [m], that ascend."""

    times: FloatArray
    poses: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Returns the poses (m, 3) at times (m,); before and after, the first and the last."""
        columns = (self.poses[:, 0], self.poses[:, 1], np.unwrap(self.poses[:, 2]))
        return np.column_stack([np.interp(times, self.times, column) for column in columns])


class Positions:
    """Poses of reference points by elements such as LanePosition.

    Args:
        roads: returns the roads of the map; it raises UnreadError where there are none.
        pose_of: returns where the entity of a name is at a time [s]; it raises UnreadError where that is not known.
        speed_of: returns its speeds [m/s] at times [s], likewise.
    """

    def __init__(
        self,
        roads: Callable[[], Roads],
        pose_of: Callable[[str, float], Pose],
        speed_of: Callable[[str, FloatArray], FloatArray],
    ) -> None:
        self._roads, self.pose_of, self.speed_of = roads, pose_of, speed_of

    def pose(self, position: ET.Element, time: float) -> tuple[Pose, bool]:
        """Returns the pose that a position stands for at a time [s], and whether it says the heading.

        Raises:
            UnreadError: the position is of a kind that is not read, or not on the map.
        """
        place = child(position, "*")
        if place.tag == "WorldPosition":
            given = place.get("h") is not None
            return (number(place, "x"), number(place, "y"), number(place, "h", 0.0)), given
        readers = {
            "RelativeWorldPosition": self._by_world,
            "RelativeObjectPosition": self._by_object,
            "RoadPosition": self._on_road,
            "LanePosition": self._on_lane,
            "RelativeRoadPosition": self._by_road,
            "RelativeLanePosition": self._by_lane,
        }
        if place.tag not in readers:
            raise UnreadError(f"element {place.tag} is not read")
        x, y, axis, ahead = readers[place.tag](place, time)
        orientation = place.find("Orientation")
        if orientation is None:
            return (x, y, ahead), False
        heading = number(orientation, "h", 0.0)
        return (x, y, heading if orientation.get("type") == "absolute" else axis + heading), True

    def _by_world(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:
        x, y, heading = self.pose_of(place.get("entityRef", ""), time)
        return x + number(place, "dx"), y + number(place, "dy"), heading, heading

    def _by_object(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:
        x, y, heading = self.pose_of(place.get("entityRef", ""), time)
        ahead, left = number(place, "dx"), number(place, "dy")
        cos, sin = math.cos(heading), math.sin(heading)
        return x + cos * ahead - sin * left, y + sin * ahead + cos * left, heading, heading

    def _on_road(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:  # noqa: ARG002 - is fixed
        x, y, axis = self._road(place.get("roadId", "")).pose(number(place, "s"), number(place, "t"))
        return x, y, axis, axis

    def _on_lane(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:  # noqa: ARG002 - is fixed
        road = self._road(place.get("roadId", ""))
        return _in_lane(road, int(number(place, "laneId")), number(place, "s"), number(place, "offset", 0.0))

    def _by_road(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:
        other = self._place_of(place, time)
        x, y, axis = other.road.pose(other.s + number(place, "ds"), other.t + number(place, "dt"))
        return x, y, axis, axis

    def _by_lane(self, place: ET.Element, time: float) -> tuple[float, float, float, float]:
        other = self._place_of(place, time)
        lane = lane_beside(other.lane, int(number(place, "dLane")))
        aside, ahead = number(place, "offset", 0.0), number(place, "ds", number(place, "dsLane", 0.0))
        s = other.s + ahead
        if 0.0 <= s <= other.road.length:
            return _in_lane(other.road, lane, s, aside)
        x, y, axis, _ = _in_lane(other.road, lane, other.s, aside)
        begin = Place(other.road, other.s, other.road.project(x, y)[1], lane)
        way = self._roads().way(begin, axis if ahead > 0.0 else axis + math.pi, abs(ahead))
        if arc_lengths(way[:, :2])[-1] < abs(ahead) - STEP:
            raise UnreadError(f"element {place.tag}: no lane leads {ahead:g} m on")
        x, y, heading = way[-1].tolist()
        return x, y, heading, heading

    def _place_of(self, place: ET.Element, time: float) -> Place:
        """Returns where on the roads the entity is that a position refers to."""
        name = place.get("entityRef", "")
        return self.on_road(place, name, self.pose_of(name, time))

    def on_road(self, element: ET.Element, name: str, pose: Pose) -> Place:
        """Returns where on the roads a pose is, for an element; raises UnreadError where it is on no lane."""
        on_road = self._roads().place(*pose)
        if on_road is None:
            raise UnreadError(f"element {element.tag}: {name} is on no lane")
        return on_road

    def _road(self, name: str) -> Road:
        road = self._roads().by_id.get(name)
        if road is None:
            raise UnreadError(f"there is no road {name:.60} on the map")
        return road


def lane_beside(lane: int, count: int) -> int:
    """Returns the number of the lane that lies `count` lanes higher; lane 0 is no lane and does not count."""
    other = lane + count
    return other if other * lane > 0 else other + (1 if lane < 0 else -1)


def trajectory(follow: ET.Element, start: float, positions: Positions) -> tuple[Track, bool]:
    """Returns the trajectory of a FollowTrajectoryAction that starts at a time [s].

    The way between vertices is straight, as the standard says. Where no heading is given it is that of the way.

    Returns:
        Poses by time [s], or by distance [m] where it has no time reference; and whether they are by time.

    Raises:
        UnreadError: it is no polyline, or cannot be driven.
    """
    whole, timing = child(follow, ".//Trajectory"), timing_of(follow, start)
    shape = child(whole, "Shape/*")
    if shape.tag != "Polyline" or whole.get("closed") == "true":
        raise UnreadError(
            f"element {shape.tag} is not read" if shape.tag != "Polyline" else "element Trajectory is closed"
        )
    vertices = shape.findall("Vertex")
    if len(vertices) < 2:
        raise UnreadError(f"element Polyline has {len(vertices)} vertices, expected at least 2")
    poses = _with_courses([positions.pose(child(vertex, "Position"), start) for vertex in vertices])
    lengths = arc_lengths(poses[:, :2])
    offset = number(follow, "initialDistanceOffset", 0.0)
    if not 0.0 <= offset < max(lengths[-1], 1e-9):
        raise UnreadError(f"element FollowTrajectoryAction: initialDistanceOffset {offset:g} is not on the trajectory")
    if timing is None:
        return _from(Track(lengths - offset, poses), 0.0), False
    times = timing[0] + timing[1] * np.array([number(vertex, "time", most=LATEST) for vertex in vertices])
    _check_drivable(times, lengths)
    track, begin = Track(times, poses), float(np.interp(offset, lengths, times))
    if offset > 0.0 and follow.find("TimeReference/Timing[@domainAbsoluteRelative='relative']") is not None:
        track = Track(times - (begin - times[0]), poses)
        return _from(track, times[0]), True
    track = _from(track, begin)
    waits = offset > 0.0 and start < begin  # where it begins, for its absolute time
    return Track(np.r_[start, track.times], np.vstack([track.poses[:1], track.poses])) if waits else track, True


def last_time(follow: ET.Element, start: float, positions: Positions) -> float | None:
    """Returns when a trajectory ends that starts at a time [s]; None where it has no time reference.

    Raises:
        UnreadError: as :func:`trajectory`.
    """
    timing, vertices = timing_of(follow, start), follow.findall(".//Polyline/Vertex")
    if timing is None:
        return None
    if not vertices or number(follow, "initialDistanceOffset", 0.0) > 0.0:  # which shifts times by the way
        return float(trajectory(follow, start, positions)[0].times[-1])
    return timing[0] + timing[1] * max(number(vertex, "time", most=LATEST) for vertex in vertices)


def timing_of(follow: ET.Element, start: float) -> tuple[float, float] | None:
    """Returns when the clock of a trajectory that starts at a time is zero [s], and its scale; None without a clock.

    Raises:
        UnreadError: the time reference is malformed.
    """
    timing = follow.find("TimeReference/Timing")
    if timing is None:
        return None
    domain = timing.get("domainAbsoluteRelative")
    if domain not in ("absolute", "relative"):
        raise UnreadError(f"element Timing: domainAbsoluteRelative is {domain}, expected absolute or relative")
    offset, scale = number(timing, "offset", most=LATEST), number(timing, "scale")
    if scale <= 0.0:
        raise UnreadError(f"element Timing: scale is {scale:g}, expected more than 0")
    return offset + (start if domain == "relative" else 0.0), scale


def _check_drivable(times: FloatArray, lengths: FloatArray) -> None:
    """Refuses times [s] that fall or are too late, and speeds, by distances along the way [m], that none has."""
    step, way = np.diff(times), np.diff(lengths)
    if times.max() > LATEST or (step < 0.0).any():
        raise UnreadError(f"element Vertex: times fall, or are later than {LATEST:g} s")
    if (way > FASTEST * step + 1e-3).any():
        row = int(np.argmax(way > FASTEST * step + 1e-3))
        raise UnreadError(f"element Vertex {row + 2}: is {way[row]:.4g} m and {step[row]:.3g} s after the one before")


def _with_courses(poses: list[tuple[Pose, bool]]) -> FloatArray:
    """Returns poses (n, 3), with the direction of the way where no heading is given; who stands looks as before."""
    points = [pose[:2] for pose, _ in poses]
    ahead = [math.atan2(b[1] - a[1], b[0] - a[0]) if a != b else None for a, b in pairwise(points)]
    course = next((angle for angle in ahead if angle is not None), 0.0)
    rows = []
    for (pose, given), angle in zip(poses, [*ahead, None], strict=True):
        course = course if angle is None else angle
        rows.append((*pose[:2], pose[2] if given else course))
    return np.array(rows)


def _from(track: Track, begin: float) -> Track:
    """Returns the part of a track from a time on."""
    later = track.times > begin
    if later.all():
        return track
    times = np.r_[begin, track.times[later]]
    return Track(times, np.vstack([track.at(times[:1]), track.poses[later]]))


def _in_lane(road: Road, lane: int, s: float, offset: float) -> tuple[float, float, float, float]:
    """Returns x, y [m], and directions of road and traffic [rad], at `offset` to the left of a lane's middle."""
    middle = road.middle(lane, s) if 0.0 <= s <= road.length else None
    if middle is None:
        raise UnreadError(f"there is no lane {lane} at s {s:g} of road {road.id:.60}")
    x, y, axis = road.pose(s, middle[0] + offset)
    return x, y, axis, axis if road.leads(lane) else axis + math.pi
