"""Motion of the entities of an OpenSCENARIO storyboard: what they do at which times, and where they are then.

An entity stands or drives on with its speed, along its lane where the map has one, until an action changes that.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.opendrive_roads import Place, Pose, Roads
from litsim_data.sources.openscenario.positions import FASTEST, Positions, Track, trajectory
from litsim_data.sources.openscenario.transitions import EASED, Aside, lane_change, lane_offset, lasting, side_of
from litsim_data.sources.openscenario.xml import UnreadError, child, number
from litsim_sim.core.geometry import arc_lengths
from litsim_sim.core.scene import RATE_HZ, STEP_S, FloatArray

ROUNDING = 1e-6  # [frames] within which a time is that of a frame
WAY_MAX = 20_000.0  # [m] along lanes, after which an entity drives straight on
OVERWRITE = ET.Element("Overwrite")
"""Stands for an event that ends what its maneuver does."""
ORDER = (
    "Overwrite",
    "AddEntityAction",
    "TeleportAction",
    "SpeedAction",
    "LaneChangeAction",
    "LaneOffsetAction",
    "FollowTrajectoryAction",
    "DeleteEntityAction",
)
"""Actions that a player plays; actions of one time in this order."""


class Played(NamedTuple):
    """An action of an entity: when it starts [s], its innermost element, and the maneuver that it belongs to."""

    time: float
    action: ET.Element
    maneuver: ET.Element | None = None


class Speed(NamedTuple):
    """A speed that changes from `first` to `last` [m/s] within `lasts` [s] from `begin` [s] on.

    With `other`, it leads to what that returns for a time [s] instead, and stays there.
    """

    first: float = 0.0
    last: float = 0.0
    begin: float = 0.0
    lasts: float = 0.0
    shape: str = "linear"
    other: Callable[[FloatArray], FloatArray] | None = None

    def at(self, times: FloatArray) -> FloatArray:
        """Returns the speeds [m/s] at times [s]."""
        share = np.clip((times - self.begin) / self.lasts, 0.0, 1.0) if self.lasts else np.ones(len(times))
        last = self.last if self.other is None else self.other(times)
        return self.first + (last - self.first) * EASED[self.shape][0](share)


class Player:
    """Plays the actions of an entity to a track.

    Attributes:
        time, pose: up to which the track is made [s], and where the entity is then, if that is known.
        ends: when actions ended whose end depends on how the entity moves [s].
        lanes_until: when the entity left the last lane of its road [s]; infinite if never.

    Args:
        actions: what it does.
        positions: the reader of positions.
        roads: the roads whose lanes it follows; None if it follows none.
    """

    def __init__(self, actions: Sequence[Played], positions: Positions, roads: Callable[[], Roads | None]) -> None:
        self._positions, self._roads = positions, roads
        self._actions = {played.action for played in actions}
        self.ends: dict[ET.Element, float] = {}
        self.lanes_until = math.inf
        self._queue: list[tuple[float, int, int, Callable[[], None]]] = []
        self._order = count()
        for played in actions:
            rank = ORDER.index(played.action.tag)
            self._push(played.time, rank, partial(getattr(self, f"_{played.action.tag}"), played))
        self.time = 0.0
        self.pose: Pose | None = None
        self._present, self._speed, self._travelled = True, Speed(), 0.0
        self._along: Track | None = None
        self._aside: Aside | None = None
        self._odometer = 0.0
        self._on_track: ET.Element | None = None
        self._follows: tuple[Track, ET.Element | None] | None = None
        self._times: list[FloatArray] = []
        self._poses: list[FloatArray] = []

    def play(self, end: float) -> Track:
        """Returns the track by the end of the scenario [s], with a pose for each frame at which the entity is there.

        Raises:
            UnreadError: an action is not read, or the entity is nowhere.
        """
        while self._queue and self._queue[0][0] <= end:
            time, *_, action = heapq.heappop(self._queue)
            self._advance(time)
            action()
        self._advance(end, closed=True)
        if not self._times:
            raise UnreadError("no TeleportAction, nor any other, says where it is")
        return Track(np.concatenate(self._times), np.concatenate(self._poses))

    def plays(self, action: ET.Element) -> bool:
        """Returns whether it plays an action, by its innermost element."""
        return action in self._actions

    def _push(self, time: float, rank: int, action: Callable[[], None]) -> None:
        heapq.heappush(self._queue, (max(time, 0.0), rank, next(self._order), action))

    def _advance(self, to: float, *, closed: bool = False) -> None:
        """Makes the track up to a time [s], the frame at which belongs to what comes next unless `closed`."""
        begin, end = math.ceil(self.time * RATE_HZ - ROUNDING), math.ceil(to * RATE_HZ - ROUNDING)
        end += closed and end <= to * RATE_HZ + ROUNDING
        if self.pose is not None:
            frames = np.arange(begin, end)
            times = np.r_[frames * STEP_S, to]
            poses = self._driven(times) if self._follows is None else self._follows[0].at(times)
            if self._present and len(frames):
                self._times.append(times[:-1])
                self._poses.append(poses[:-1])
            self.pose = _pose(poses[-1])
        self.time = to

    def _driven(self, times: FloatArray) -> FloatArray:
        """Returns the poses at times [s], from the present one on with its speed along its way."""
        instants = np.r_[self.time, times]
        speeds = self._speed.at(instants)
        way = np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(instants).clip(0.0))
        if self._along is None:
            return self._beside(self._onward(self.pose, way, times), way, times)
        poses = self._along.at(self._travelled + way)
        beyond = self._travelled + way - self._along.times[-1]
        self._travelled += way[-1]
        if beyond[-1] < 0.0:
            return poses
        if self._on_track is not None:
            self.ends[self._on_track] = _when(beyond, 0.0, times)
        last, self._along = self._along.poses[-1], None
        return np.where(beyond[:, None] > 0.0, self._onward(_pose(last), beyond.clip(0.0), times), poses)

    def _beside(self, poses: FloatArray, way: FloatArray, times: FloatArray) -> FloatArray:
        """Returns poses at times [s], along the lane that the entity changes to, moved to where it is by then."""
        ways, aside = self._odometer + way, self._aside
        begin, self._odometer = self._odometer, float(ways[-1])
        if aside is None:
            return poses
        when, now = (times, self.time) if aside.by_time else (ways, begin)
        moved = aside.moved(when) - aside.moved(np.array([now]))
        if when[-1] >= aside.begin + aside.lasts:
            self.ends[aside.action] = _when(when, aside.begin + aside.lasts, times)
            self._aside = None
        slope = np.gradient(np.r_[0.0, moved]) / np.maximum(np.gradient(np.r_[0.0, way]), 1e-6)
        yaw = poses[:, 2]
        x, y = poses[:, 0] - moved * np.sin(yaw), poses[:, 1] + moved * np.cos(yaw)
        return np.column_stack([x, y, yaw + np.arctan(slope[1:]) * (np.diff(np.r_[0.0, way]) > 0.0)])

    def _onward(self, pose: Pose | None, way: FloatArray, times: FloatArray) -> FloatArray:
        """Returns poses at distances `way` (n,) [m] from a pose on, along the lane and then straight."""
        assert pose is not None
        roads, before = self._roads() if way[-1] > 0.0 else None, 0.0
        place = None if roads is None else roads.place(*pose)
        if place is not None and self._aside is not None:
            place = self._lane_ahead(place, pose, self._aside)
        along = None
        if roads is not None and place is not None:
            line = roads.way(place, pose[2], min(float(way[-1]), WAY_MAX))
            lengths = arc_lengths(line[:, :2])
            if len(line) > 1 and lengths[-1] > 0.0:
                along = Track(lengths, line)
                pose, before = _pose(line[-1]), float(lengths[-1])
        if roads is not None and way[-1] > before:
            self.lanes_until = min(self.lanes_until, _when(way, before, times))
        x, y, heading = pose
        rest = (way - before).clip(0.0)
        straight = np.column_stack(
            [x + rest * math.cos(heading), y + rest * math.sin(heading), np.full(len(way), heading)]
        )
        return straight if along is None else np.where((way > before)[:, None], straight, along.at(way))

    def _lane_ahead(self, place: Place, pose: Pose, aside: Aside) -> Place:
        """Returns a place on the road, on the lane that the entity is changing to."""
        now = self.time if aside.by_time else self._odometer
        left = aside.shift - float(aside.moved(np.array([now]))[0])
        t = place.t + left * side_of(place, pose)
        lane = place.road.lane_at(place.s, t)
        return place if lane is None else replace(place, lane=lane)

    def _halt(self) -> None:
        """Ends what the entity follows: it drives on with the speed that it then has."""
        if self._follows is not None:
            times, lengths = self._follows[0].times, arc_lengths(self._follows[0].poses[:, :2])
            now = min(max(self.time, times[0]), times[-1])
            before = max(now - STEP_S, times[0])
            way = float(np.diff(np.interp([before, now], times, lengths))[0])
            last = way / (now - before) if now > before else 0.0
            self._speed = Speed(last, last)
        self._follows = self._along = self._aside = None

    def _place(self, position: ET.Element | None) -> None:
        """Puts the entity at a position, if there is one, from which it drives on with the speed of its last action."""
        if position is not None:
            self._follows = self._along = self._aside = None
            self.pose = self._positions.pose(position, self.time)[0]

    def _Overwrite(self, played: Played) -> None:  # noqa: N802 - named after the element, as those below
        if self._follows is not None and self._follows[1] is played.maneuver:
            self._halt()

    def _TeleportAction(self, played: Played) -> None:  # noqa: N802
        self._place(child(played.action, "Position"))

    def _AddEntityAction(self, played: Played) -> None:  # noqa: N802
        self._present = True
        self._place(played.action.find("Position"))

    def _DeleteEntityAction(self, played: Played) -> None:  # noqa: N802, ARG002
        self._advance(self.time, closed=True)
        self._present = False

    def _SpeedAction(self, played: Played) -> None:  # noqa: N802
        other, target = None, child(played.action, "SpeedActionTarget/*")
        last = number(target, "value")
        if target.tag == "RelativeTargetSpeed":
            other = partial(self._relative_speed, target)
            last = float(other(np.array([self.time]))[0])
        if not 0.0 <= last <= FASTEST:
            raise UnreadError(f"element {target.tag}: value is {last:g}, expected 0 to {FASTEST:g}")
        if self._follows is not None:
            self._halt()
        first = float(self._speed.at(np.array([self.time]))[0])
        dynamics = child(played.action, "SpeedActionDynamics")
        lasts = lasting(dynamics, last - first, 0.5 * (first + last))
        shape = dynamics.get("dynamicsShape", "") if lasts else "linear"
        goes_on = other if target.get("continuous") == "true" else None
        self._speed = Speed(first, last, self.time, lasts, shape, goes_on)
        if goes_on is None:
            self.ends[played.action] = self.time + lasts

    def _relative_speed(self, target: ET.Element, times: FloatArray) -> FloatArray:
        """Returns the speeds [m/s] at times [s] that are relative to those of an entity."""
        value, other = number(target, "value"), self._positions.speed_of(target.get("entityRef", ""), times)
        relative = other * value if target.get("speedTargetValueType") == "factor" else other + value
        return relative.clip(0.0, FASTEST)

    def _LaneChangeAction(self, played: Played) -> None:  # noqa: N802
        self._move_aside(lane_change(played.action, self._ready(), self.time, self._positions))

    def _LaneOffsetAction(self, played: Played) -> None:  # noqa: N802
        self._move_aside(lane_offset(played.action, self._ready(), self._positions))

    def _ready(self) -> Pose:
        """Returns where the entity is, which ends what it follows."""
        if self.pose is None:
            raise UnreadError("an action beside its lane of who is nowhere")
        if self._follows is not None:
            self._halt()
        return self.pose

    def _move_aside(self, aside: Aside) -> None:
        """Begins to move to the left, or does so at once."""
        if aside.lasts > 0.0:
            self._aside = aside._replace(begin=self.time if aside.by_time else self._odometer)
            return
        assert self.pose is not None
        x, y, heading = self.pose
        self.pose = x - aside.shift * math.sin(heading), y + aside.shift * math.cos(heading), heading
        self.ends[aside.action] = self.time

    def _FollowTrajectoryAction(self, played: Played) -> None:  # noqa: N802
        track, by_time = trajectory(played.action, self.time, self._positions)
        if by_time:
            rank = len(ORDER)
            if track.times[-1] > self.time:
                self._push(max(track.times[0], self.time), rank, partial(self._follow, track, played.maneuver))
                self._push(track.times[-1], rank, partial(self._finish, track))
            return
        self._follows, self._along, self._travelled = None, track, 0.0
        self._on_track, self._aside = played.action, None
        self.pose = _pose(track.poses[0])

    def _follow(self, track: Track, maneuver: ET.Element | None) -> None:
        self._follows, self._along, self._aside = (track, maneuver), None, None
        self.pose = _pose(track.at(np.array([self.time]))[0])

    def _finish(self, track: Track) -> None:
        if self._follows is not None and self._follows[0] is track:
            self._halt()


def _when(values: FloatArray, value: float, times: FloatArray) -> float:
    """Returns the first time [s] at which values (n,), which ascend, reach a value."""
    row = min(int(np.searchsorted(values, value - 1e-9)), len(values) - 1)
    return float(np.interp(value, values[row - 1 : row + 1], times[row - 1 : row + 1])) if row else float(times[0])


def _pose(row: FloatArray) -> Pose:
    x, y, heading = row.tolist()
    return x, y, heading
