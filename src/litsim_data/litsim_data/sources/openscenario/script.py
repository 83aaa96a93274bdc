"""The script of an OpenSCENARIO: which actions move an entity, where it is then, and when all ends."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import cached_property
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from litsim_data.maps.opendrive_roads import Pose, Roads
from litsim_data.sources.openscenario.motion import ORDER, OVERWRITE, Played, Player, lasting
from litsim_data.sources.openscenario.positions import LATEST, Positions, Track, last_time
from litsim_data.sources.openscenario.storyboard import Storyboard, action_in
from litsim_data.sources.openscenario.xml import UnreadError, child

PASSED_OVER = {
    "ControllerAction",
    "ActivateControllerAction",
    "VisibilityAction",
    "AppearanceAction",
    "AssignRouteAction",
    "AcquirePositionAction",
}
"""Actions of an entity that are not simulated, and that leave it on its way."""
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
        self.entities = {one.get("name", ""): one for one in root.findall("Entities/ScenarioObject")}
        self.notes: list[str] = []
        self._storyboard = Storyboard(root, self._end_of)
        self._positions = Positions(self._roads_or_refuse, self._pose_of)
        self._players: dict[str, Player] = {}
        self._tracks: dict[str, Track | UnreadError] = {}
        self._placing: set[str] = set()
        """Entities whose first position is being read."""

    @cached_property
    def end(self) -> float:
        """The time [s] at which the StopTrigger ends the scenario, or else the last action that is read; 0 if none."""
        whole = self._root.find("Storyboard")
        try:
            stop = math.inf if whole is None else self._storyboard.stop(whole)
        except UnreadError as error:
            stop = math.inf
            self.notes.append(f"the StopTrigger is passed over: {error}")
        if stop <= LATEST:
            return stop
        if stop < math.inf:
            self.notes.append(f"the StopTrigger is passed over: it ends at {stop:g} s, expected at most {LATEST:g} s")
        ends = [0.0]
        first = [action for actions in self._privates.values() for action in actions]
        for action in (*first, *self._root.iterfind("Storyboard/Story//Event/Action")):
            try:
                ends.append(self._end_of(action, 0.0) if action.tag != "Action" else self._storyboard.end(action))
            except ValueError:  # its entity says why
                continue
        return max(end for end in ends if end <= LATEST)

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

    def _played(self, name: str) -> Track:
        if name in self._players:
            raise UnreadError(f"{name} is placed by where others are that are placed by it")
        walks = self.entities[name].find("Pedestrian") is not None
        player = Player(self._actions(name), self._positions, lambda: None if walks else self._roads)
        self._players[name] = player
        return player.play(self.end)

    def _actions(self, name: str) -> list[Played]:
        """Returns the actions of an entity that are played, and notes those that are passed over."""
        played = [Played(0.0, action_in(action)) for action in self._privates.get(name, [])]
        for event, action in self._events.get(name, []):
            inner, maneuver = action_in(action), self._storyboard.around(event)
            if inner.tag in PASSED_OVER:
                played.append(Played(0.0, inner))
                continue
            start = self._storyboard.start(event)
            if event.get("maximumExecutionCount", "1") != "1":
                self.notes.append(f"event {event.get('name')} of {name} is executed once only")
            if start <= LATEST:
                played.append(Played(start, inner, maneuver))
                if event.get("priority") in OVERWRITES:
                    played.append(Played(start, OVERWRITE, maneuver))
                if (stop := self._storyboard.cut_off(event)) <= LATEST:
                    played.append(Played(stop, OVERWRITE, maneuver))
        passed = sorted({one.action.tag for one in played if one.action.tag in PASSED_OVER})
        if passed:
            self.notes.append(f"of {name}, {' and '.join(passed)} is passed over")
        played = [one for one in played if one.action.tag not in PASSED_OVER]
        for one in played:
            if one.action.tag not in ORDER:
                raise UnreadError(f"element {one.action.tag} is not read")
        return played

    @cached_property
    def _privates(self) -> dict[str, list[ET.Element]]:
        """The actions of Init by entity."""
        actions: dict[str, list[ET.Element]] = defaultdict(list)
        for private in self._root.iterfind("Storyboard/Init/Actions/Private"):
            actions[private.get("entityRef", "")] += private.findall("PrivateAction")
        for action in self._root.iterfind("Storyboard/Init/Actions/GlobalAction/EntityAction"):
            actions[action.get("entityRef", "")].append(action)
        return actions

    @cached_property
    def _events(self) -> dict[str, list[tuple[ET.Element, ET.Element]]]:
        """The events by entity, with an action of each that is the entity's."""
        selections = {
            one.get("name", ""): [ref.get("entityRef", "") for ref in one.iterfind("Members/EntityRef")]
            for one in self._root.iterfind("Entities/EntitySelection")
        }
        events: dict[str, list[tuple[ET.Element, ET.Element]]] = defaultdict(list)
        for group in self._root.iterfind("Storyboard/Story/Act/ManeuverGroup"):
            refs = [ref.get("entityRef", "") for ref in group.iterfind("Actors/EntityRef")]
            actors = dict.fromkeys(name for ref in refs for name in selections.get(ref, [ref]))
            if group.find("Actors[@selectTriggeringEntities='true']") is not None:
                self.notes.append(f"entities that trigger ManeuverGroup {group.get('name')} are not among its actors")
            for event in group.iterfind("Maneuver/Event"):
                for action in event.iterfind("Action"):
                    of_entity = action.find("GlobalAction/EntityAction")
                    own = [] if action.find("PrivateAction") is None else actors
                    for name in own if of_entity is None else [of_entity.get("entityRef", "")]:
                        events[name].append((event, action))
        return events

    def _end_of(self, action: ET.Element, start: float) -> float:
        """Returns when an action that starts at a time ends [s]; raises UnreadError where that is not known."""
        inner = action_in(action)
        if inner.tag == "FollowTrajectoryAction":
            if (last := last_time(inner, start, self._positions)) is not None:
                return max(start, last)
        elif inner.tag == "SpeedAction":
            dynamics = child(inner, "SpeedActionDynamics")
            if dynamics.get("dynamicsShape") == "step" or dynamics.get("dynamicsDimension") == "time":
                return start + lasting(dynamics, 0.0, 0.0)
        elif action.find("GlobalAction") is not None or inner.tag in ORDER or inner.tag in PASSED_OVER:
            return start
        raise UnreadError(f"the end of element {inner.tag} is not known")

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
        position = next(
            (
                one.find("Position")
                for one in map(action_in, self._privates.get(name, []))
                if one.tag == "TeleportAction"
            ),
            None,
        )
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
