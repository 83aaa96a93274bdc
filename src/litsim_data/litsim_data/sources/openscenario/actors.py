"""Who acts in an OpenSCENARIO: the actions of each entity, as they stand in Init and in the story."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from xml.etree import ElementTree as ET


def first_actions(root: ET.Element) -> Mapping[str, list[ET.Element]]:
    """Returns the actions of Init by entity."""
    actions: dict[str, list[ET.Element]] = defaultdict(list)
    for private in root.iterfind("Storyboard/Init/Actions/Private"):
        actions[private.get("entityRef", "")] += private.findall("PrivateAction")
    for action in root.iterfind("Storyboard/Init/Actions/GlobalAction/EntityAction"):
        actions[action.get("entityRef", "")].append(action)
    return actions


def events_of_entities(root: ET.Element) -> tuple[Mapping[str, list[tuple[ET.Element, ET.Element]]], list[str]]:
    """Returns the events by entity, with an action of each that is the entity's, and notes on who is left out."""
    selections = {
        selection.get("name", ""): [ref.get("entityRef", "") for ref in selection.iterfind("Members/EntityRef")]
        for selection in root.iterfind("Entities/EntitySelection")
    }
    events: dict[str, list[tuple[ET.Element, ET.Element]]] = defaultdict(list)
    notes = []
    for group in root.iterfind("Storyboard/Story/Act/ManeuverGroup"):
        refs = [ref.get("entityRef", "") for ref in group.iterfind("Actors/EntityRef")]
        actors = dict.fromkeys(name for ref in refs for name in selections.get(ref, [ref]))
        if group.find("Actors[@selectTriggeringEntities='true']") is not None:
            notes.append(f"entities that trigger ManeuverGroup {group.get('name')} are not among its actors")
        for event in group.iterfind("Maneuver/Event"):
            for action in event.iterfind("Action"):
                of_entity = action.find("GlobalAction/EntityAction")
                own = [] if action.find("PrivateAction") is None else actors
                for name in own if of_entity is None else [of_entity.get("entityRef", "")]:
                    events[name].append((event, action))
    return events, notes
