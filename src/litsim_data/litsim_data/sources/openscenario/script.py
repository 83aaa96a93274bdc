"""The script of an OpenSCENARIO: which actions move an entity, where it is then, and when all ends.

What starts by where entities are is decided one after the other: all are played without it, then what starts first is
decided, and all are played again, with it. What happens before is not changed by what comes later.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.opendrive_roads import Pose, Roads
from litsim_data.sources.openscenario.actors import events_of_entities, first_actions
from litsim_data.sources.openscenario.conditions import Conditions, Seen, Span
from litsim_data.sources.openscenario.motion import ORDER, OVERWRITE, Played, Player
from litsim_data.sources.openscenario.positions import LATEST, Positions, Track, last_time
from litsim_data.sources.openscenario.storyboard import Key, Storyboard, action_in
from litsim_data.sources.openscenario.transitions import lasting
from litsim_data.sources.openscenario.xml import UnreadError, box_of, child
from litsim_sim.core.scene import RATE_HZ, STEP_S, FloatArray

PASSED_OVER = {
    "ControllerAction",
    "ActivateControllerAction",
    "VisibilityAction",
    "AppearanceAction",
    "AssignRouteAction",
    "AcquirePositionAction",
}
"""Actions of an entity that are not simulated, and that leave it on its way."""
HORIZON_S = 120.0  # [s] within which what depends on where entities are is looked for, chosen to bound the work
ROUNDS_MAX = 200  # times that what starts next is looked for
T = TypeVar("T")
OVERWRITES = ("overwrite", "override")


class Script:
    """A scenario whose entities are moved.

    Args:
        root: the scenario, with values in place of parameters.
        road: the map that positions refer to; anything but an OpenDRIVE file has no roads to refer to.

    Attributes:
        entities: its elements ScenarioObject by name.
        notes: sentences on what is passed over.
    """

    def __init__(self, root: ET.Element, road: Path | None) -> None:
        self._root, self._road = root, road
        self._told: list[str] = []
        self.entities = {entity.get("name", ""): entity for entity in root.findall("Entities/ScenarioObject")}
        self._first_actions, (self._events, self._left_out) = first_actions(root), events_of_entities(root)
        self._storyboard = Storyboard(root, self._end_of, self._holds)
        self._positions = Positions(self._roads_or_refuse, self._pose_of, self._speed_of)
        self._conditions = Conditions(self._seen, self._positions, self._roads_or_refuse)
        self._whole = child(root, "Storyboard") if root.find("Storyboard") is not None else ET.Element("Storyboard")
        self._horizon = HORIZON_S
        self._looking = False
        """Whether conditions on entities are looked at, which needs the tracks of all; else they hold at no time."""
        self._unread: dict[ET.Element, UnreadError] = {}
        """Acts and events whose start is not read, once conditions on entities are looked at."""
        self._forget()
        self.end = self._settled()
        self._horizon = self.end
        self._forget()

    def track(self, name: str) -> Track:
        """Returns the track of an entity.

        Raises:
            UnreadError: something that moves the entity is not read.
        """
        if name not in self._tracks:
            try:
                self._tracks[name] = self._played(name)
            except (ValueError, RecursionError) as error:
                self._tracks[name] = UnreadError(str(error))
        track = self._tracks[name]
        if isinstance(track, UnreadError):
            raise track
        return track

    def _forget(self) -> None:
        """Forgets where entities are."""
        self._players: dict[str, Player] = {}
        self._tracks: dict[str, Track | UnreadError] = {}
        self._placing: set[str] = set()
        """Entities whose first position is being read."""
        self._by_name: dict[str, Seen] = {}
        self.notes = [*self._left_out, *self._told]

    def _settled(self) -> float:
        """Decides what depends on where entities are, and returns when the scenario ends [s]; 0 if nothing says so."""
        try:
            stop = self._storyboard.stop(self._whole)
        except UnreadError:
            stop = math.inf
        self._horizon = min(stop, HORIZON_S) if stop <= LATEST else HORIZON_S
        if self._storyboard.any_waits():
            for _ in range(ROUNDS_MAX):
                if not self._decide_next():
                    break
        self._look(self._play_all)
        return self._look(self._last)

    def _play_all(self) -> None:
        """Plays all entities up to the horizon."""
        self._looking = False
        self._storyboard.forget()
        self._forget()
        for name in self.entities:
            with suppress(UnreadError):  # which is told where the track is needed
                self.track(name)

    def _look(self, what: Callable[[], T]) -> T:
        """Returns what is computed while conditions on entities are looked at."""
        self._storyboard.forget()
        self._looking = True
        try:
            return what()
        finally:
            self._looking = False
            self._storyboard.forget()

    def _decide_next(self) -> bool:
        """Decides what starts or stops next by where entities are; returns whether there was something."""
        self._play_all()
        unread = len(self._unread)
        times = self._look(self._times_ahead)
        first = min(times.values(), default=math.inf)
        self._storyboard.decided |= {key: time for key, time in times.items() if time <= first + 1e-9}
        if ("stop", self._whole) in self._storyboard.decided:
            self._horizon = first
            return False
        return bool(times) or len(self._unread) > unread

    def _times_ahead(self) -> dict[Key, float]:
        """Returns what starts and stops by where entities are, up to the horizon [s]."""
        times: dict[Key, float] = {}
        for what, element in self._storyboard.decidable():
            try:
                if self._storyboard.waits(what, element):
                    times[what, element] = getattr(self._storyboard, what)(element)
            except UnreadError as error:
                self._unread.setdefault(element, error)
        return {key: time for key, time in times.items() if time <= self._horizon}

    def _last(self) -> float:
        """Returns when the scenario ends [s]: by its StopTrigger, else by the last action that is read; 0 if none."""
        stop, named = math.inf, self._whole.find("StopTrigger//ByEntityCondition") is not None
        try:
            stop = self._storyboard.stop(self._whole)
        except UnreadError as error:
            self._told.append(f"the StopTrigger is passed over: {error}")
        if stop <= LATEST:
            return stop
        if stop < math.inf:
            self._told.append(f"the StopTrigger is passed over: it ends at {stop:g} s, expected at most {LATEST:g} s")
        elif named and not self._told:
            self._told.append(f"the StopTrigger is not met within {self._horizon:g} s")
        ends = [0.0]
        first = [action for actions in self._first_actions.values() for action in actions]
        for action in (*first, *self._root.iterfind("Storyboard/Story//Event/Action")):
            with suppress(ValueError):  # its entity says why
                ends.append(self._end_of(action, 0.0)[0] if action.tag != "Action" else self._storyboard.end(action))
        return max(end for end in ends if end <= LATEST)

    def _holds(self, condition: ET.Element) -> list[Span]:
        """Returns when a condition on entities holds; at no time while these are not looked at."""
        Conditions.check(condition)
        return self._conditions.spans(condition) if self._looking else []

    def _seen(self, name: str) -> Seen:
        """Returns an entity at each frame up to the horizon; raises UnreadError where that is not known."""
        if name not in self._by_name:
            track = self.track(name)
            poses = np.full((round(self._horizon * RATE_HZ) + 1, 3), np.nan)
            rows = np.round(track.times * RATE_HZ).astype(np.int64)
            poses[rows[rows < len(poses)]] = track.poses[rows < len(poses)]
            self._by_name[name] = Seen(poses, box_of(self.entities[name]), self._players[name].lanes_until)
        return self._by_name[name]

    def _played(self, name: str) -> Track:
        if name not in self.entities:
            raise UnreadError(f"there is no entity {name:.60}")
        if name in self._players:
            raise UnreadError(f"{name} is placed by where others are that are placed by it")
        walks = self.entities[name].find("Pedestrian") is not None
        player = Player(self._actions(name), self._positions, lambda: None if walks else self._roads)
        self._players[name] = player
        return player.play(self._horizon)

    def _actions(self, name: str) -> list[Played]:
        """Returns the actions of an entity that are played, and notes those that are passed over."""
        played = [Played(0.0, action_in(action)) for action in self._first_actions.get(name, [])]
        for event, action in self._events.get(name, []):
            inner, maneuver = action_in(action), self._storyboard.around(event)
            if inner.tag in PASSED_OVER:
                played.append(Played(0.0, inner))
                continue
            if self._waits(event):
                continue
            start = self._storyboard.start(event)
            if event.get("maximumExecutionCount", "1") != "1":
                self.notes.append(f"event {event.get('name')} of {name} is executed once only")
            if start <= LATEST:
                played.append(Played(start, inner, maneuver))
                if event.get("priority") in OVERWRITES:
                    played.append(Played(start, OVERWRITE, maneuver))
                if not self._storyboard.act_waits(event) and (stop := self._storyboard.cut_off(event)) <= LATEST:
                    played.append(Played(stop, OVERWRITE, maneuver))
        passed = sorted({play.action.tag for play in played if play.action.tag in PASSED_OVER})
        if passed:
            self.notes.append(f"of {name}, {' and '.join(passed)} is passed over")
        played = [play for play in played if play.action.tag not in PASSED_OVER]
        for play in played:
            if play.action.tag not in ORDER:
                raise UnreadError(f"element {play.action.tag} is not read")
        return played

    def _waits(self, event: ET.Element) -> bool:
        """Returns whether an event waits for where entities are; raises UnreadError where its start is not read."""
        for element in (event, self._storyboard.act_of(event)):
            if element in self._unread:
                raise self._unread[element]
        return self._storyboard.waits("start", event)

    def _end_of(self, action: ET.Element, start: float) -> tuple[float, bool]:
        """Returns when an action that starts at a time ends [s], and whether that depends on where entities are.

        Raises:
            UnreadError: it is not known.
        """
        inner = action_in(action)
        if inner.tag == "FollowTrajectoryAction":
            if (last := last_time(inner, start, self._positions)) is not None:
                return max(start, last), False
        elif inner.tag == "SpeedAction":
            dynamics = child(inner, "SpeedActionDynamics")
            continuous = inner.find("SpeedActionTarget/*[@continuous='true']") is not None
            by_time = dynamics.get("dynamicsShape") == "step" or dynamics.get("dynamicsDimension") == "time"
            if by_time and not continuous:
                return start + lasting(dynamics, 0.0, 0.0), False
        elif inner.tag not in ("LaneChangeAction", "LaneOffsetAction"):
            if action.find("GlobalAction") is not None or inner.tag in ORDER or inner.tag in PASSED_OVER:
                return start, False
            raise UnreadError(f"the end of element {inner.tag} is not known")
        ends = [player.ends.get(inner, math.inf) for player in self._players.values() if player.plays(inner)]
        return max(ends, default=math.inf), True

    def _speed_of(self, name: str, times: FloatArray) -> FloatArray:
        """Returns the speeds of an entity at times [m/s]; raises UnreadError where they are not known."""
        track, before = self.track(name), np.maximum(times - STEP_S, 0.0)
        return np.hypot(*(track.at(before + STEP_S) - track.at(before))[:, :2].T) / STEP_S

    def _pose_of(self, name: str, time: float) -> Pose:
        """Returns where an entity is at a time [s]; raises UnreadError where that is not known."""
        if name not in self.entities:
            raise UnreadError(f"there is no entity {name:.60}")
        player = self._players.get(name)
        if player is not None and player.pose is not None and player.time == time:
            return player.pose
        if time > 0.0:
            pose = self.track(name).at(np.array([time]))[0].tolist()
            return pose[0], pose[1], pose[2]
        first = map(action_in, self._first_actions.get(name, []))
        position = next((action.find("Position") for action in first if action.tag == "TeleportAction"), None)
        if position is None or name in self._placing:
            raise UnreadError(f"where {name} is at first is not known")
        self._placing.add(name)
        try:
            return self._positions.pose(position, 0.0)[0]
        finally:
            self._placing.discard(name)

    @cached_property
    def _roads(self) -> Roads | None:
        if self._road is None or self._road.suffix != ".xodr" or not self._road.is_file():
            return None
        return Roads(self._road)

    def _roads_or_refuse(self) -> Roads:
        if self._roads is None:
            raise UnreadError("positions on roads need the OpenDRIVE map")
        return self._roads
