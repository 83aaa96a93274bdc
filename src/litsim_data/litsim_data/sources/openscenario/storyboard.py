"""When the elements of an OpenSCENARIO storyboard start and end.

A trigger holds where all conditions of one of its groups do. A condition holds at intervals of time; its edge makes
points in time of these, and its delay shifts them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from xml.etree import ElementTree as ET

from litsim_data.sources.openscenario.conditions import Span
from litsim_data.sources.openscenario.xml import UnreadError, number

Key = tuple[str, ET.Element]
"""What of an element is asked for, its start, end or stop, and the element."""
ALWAYS: Span = (-math.inf, math.inf)
WRAPPERS = {"PrivateAction", "GlobalAction", "LongitudinalAction", "LateralAction", "RoutingAction", "EntityAction"}
"""Elements that stand around an action and say only of what kind it is."""


class Storyboard:
    """The storyboard of a scenario.

    Args:
        root: the root element of the scenario.
        end_of: returns when an action that starts at a time [s] ends [s], and whether that depends on where entities
            are; it raises UnreadError if that is not known.
        holds: returns when a condition on entities holds, which depends on where they are; it raises UnreadError if the
            condition is not read.

    Attributes:
        decided: when elements start and stop [s] that depend on where entities are, once that is known.
    """

    def __init__(
        self,
        root: ET.Element,
        end_of: Callable[[ET.Element, float], tuple[float, bool]],
        holds: Callable[[ET.Element], list[Span]],
    ) -> None:
        self._root, self._end_of, self._holds = root, end_of, holds
        self.decided: dict[Key, float] = {}
        self._moving = False
        """Whether what is being computed depends on where entities are."""
        self._parents = {part: whole for whole in root.iter() for part in whole}
        self._by_name: dict[tuple[str, str], list[ET.Element]] = {}
        for element in root.iter():
            self._by_name.setdefault((element.tag.lower(), element.get("name", "")), []).append(element)
        self._values = {
            declaration.get("name", ""): declaration.get("value", "")
            for declaration in root.findall("ParameterDeclarations/ParameterDeclaration")
        }
        self._times: dict[Key, tuple[float, bool] | None] = {}
        """When elements start, end and stop [s], and whether that depends on where entities are; None meanwhile."""

    def start(self, element: ET.Element) -> float:
        """Returns when a story, or an element in it, starts [s]; infinite if never.

        Raises:
            UnreadError: what it waits for is not read.
        """
        return self._remembered("start", element, partial(self._start, element))

    def end(self, element: ET.Element) -> float:
        """Returns when a story, or an element in it, ends [s]; infinite if never.

        Raises:
            UnreadError: that depends on what is not read.
        """
        return self._remembered("end", element, partial(self._end, element))

    def stop(self, element: ET.Element) -> float:
        """Returns when the StopTrigger of an act or storyboard ends it [s]; infinite if never, or without one.

        Raises:
            UnreadError: what the trigger waits for is not read.
        """
        return self._remembered("stop", element, partial(self._stop, element))

    def waits(self, what: str, element: ET.Element) -> bool:
        """Returns whether a start or stop depends on where entities are, and is not decided; raises UnreadError."""
        getattr(self, what)(element)
        entry = self._times.get((what, element))
        return (what, element) not in self.decided and entry is not None and entry[1]

    def any_waits(self) -> bool:
        """Returns whether anything depends on where entities are."""
        for what, element in self.decidable():
            with suppress(UnreadError):  # which its entity says
                if self.waits(what, element):
                    return True
        return False

    def act_of(self, element: ET.Element) -> ET.Element | None:
        """Returns the act around an element; None of acts themselves."""
        while (whole := self._parents.get(element)) is not None:
            if whole.tag == "Act":
                return whole
            element = whole
        return None

    def act_waits(self, event: ET.Element) -> bool:
        """Returns whether the stop of the act around an event depends on where entities are, and is not decided."""
        act = self.act_of(event)
        return act is not None and self.waits("stop", act)

    def forget(self) -> None:
        """Forgets what is not decided."""
        self._times.clear()

    def decidable(self) -> list[Key]:
        """Returns what may be decided: starts of acts and events, and stops of acts and of the storyboard."""
        starts = [("start", element) for tag in ("Act", "Event") for element in self._root.iter(tag)]
        return [*starts, *(("stop", element) for tag in ("Act", "Storyboard") for element in self._root.iter(tag))]

    def around(self, element: ET.Element) -> ET.Element:
        """Returns the element that directly holds another one."""
        return self._parents[element]

    def cut_off(self, event: ET.Element) -> float:
        """Returns when the StopTrigger of the act around an event ends it [s]; infinite if never.

        Raises:
            UnreadError: what the trigger waits for is not read.
        """
        act = self.act_of(event)
        return math.inf if act is None else self.stop(act)

    def _remembered(self, what: str, element: ET.Element, compute: Callable[[], float]) -> float:
        key = (what, element)
        if key in self.decided:
            return self.decided[key]
        if key not in self._times:
            self._times[key] = None
            outer, self._moving = self._moving, False
            try:
                self._times[key] = compute(), self._moving
            except (UnreadError, RecursionError) as error:
                del self._times[key]
                raise UnreadError(str(error)) from error
            finally:
                self._moving = outer
        entry = self._times[key]
        if entry is None:
            raise UnreadError(f"element {element.tag} {element.get('name')} waits for itself")
        self._moving |= entry[1]
        return entry[0]

    def _stop(self, element: ET.Element) -> float:
        trigger = element.find("StopTrigger")
        return math.inf if trigger is None or not len(trigger) else self._triggered(trigger, 0.0)

    def _start(self, element: ET.Element) -> float:
        if element.tag in ("Story", "Storyboard"):
            return 0.0
        whole = self._parents[element]
        since, trigger = self.start(whole), element.find("StartTrigger")
        time = since if trigger is None or not len(trigger) else self._triggered(trigger, since)
        skips = element.get("priority") == "skip" and time < math.inf
        if skips and any(self.start(other) < time < self.end(other) for other in whole.findall("Event")):
            return math.inf
        return time if time <= self.cut_off(element) else math.inf

    def _end(self, element: ET.Element) -> float:
        start = self.start(element)
        if element.tag == "Action" and start < math.inf:
            end, moving = self._end_of(element, start)
            self._moving |= moving
            return end
        parts = [part for part in element if part.tag in ("Act", "ManeuverGroup", "Maneuver", "Event", "Action")]
        end = max([start, *map(self.end, parts)])
        return min(end, self.stop(element)) if element.tag == "Act" else end

    def _triggered(self, trigger: ET.Element, since: float) -> float:
        """Returns the first time [s] from `since` on at which a trigger holds; infinite if it never does."""
        first = math.inf
        for group in trigger.findall("ConditionGroup"):
            spans = [ALWAYS]
            for condition in group.findall("Condition"):
                held = self._held(condition, since)
                spans = [(max(a, c), min(b, d)) for a, b in spans for c, d in held if max(a, c) <= min(b, d)]
            first = min([first, *(max(a, since) for a, b in spans if b >= since)])
        return first

    def _held(self, condition: ET.Element, since: float) -> list[Span]:
        """Returns when a condition holds, which is looked at from a time `since` [s] on: before, it counts as false."""
        spans, edge = self._true(condition), condition.get("conditionEdge", "none")
        rising = [(max(a, since),) * 2 for a, b in spans if b >= since]
        falling = [(b, b) for _, b in spans if since <= b < math.inf]
        points = {"rising": rising, "falling": falling, "risingOrFalling": [*rising, *falling]}
        if edge not in (*points, "none"):
            raise UnreadError(f"element Condition: conditionEdge {edge} is not read")
        delay = number(condition, "delay", 0.0)
        return [(max(a, 0.0) + delay, b + delay) for a, b in points.get(edge, spans) if b >= 0.0 and a < math.inf]

    def _true(self, condition: ET.Element) -> list[Span]:
        """Returns when the logical expression of a condition is true."""
        kind = condition.find("ByValueCondition/*")
        if kind is not None and kind.tag == "SimulationTimeCondition":
            return _compared(kind.get("rule"), number(kind, "value"))
        if kind is not None and kind.tag == "StoryboardElementStateCondition":
            return self._in_state(kind)
        if kind is not None and kind.tag == "ParameterCondition":
            value, other = self._values.get(kind.get("parameterRef", "")), kind.get("value")
            if kind.get("rule") in ("equalTo", "notEqualTo"):
                return [ALWAYS] if (value == other) == (kind.get("rule") == "equalTo") else []
        of_entities = condition.find("ByEntityCondition")
        if of_entities is not None:
            self._moving = True
            return self._holds(of_entities)
        raise UnreadError(f"element {condition.tag if kind is None else kind.tag} is not read")

    def _in_state(self, condition: ET.Element) -> list[Span]:
        """Returns when an element of the storyboard is in the state that a condition asks for."""
        element, state = self._referred(condition), condition.get("state")
        start, end = self.start(element), math.inf
        if state not in ("startTransition", "standbyState"):
            end = self.end(element)
        spans = {
            "standbyState": (self.start(self._parents[element]) if element.tag == "Event" else 0.0, start),
            "startTransition": (start, start),
            "runningState": (start, end),
            "endTransition": (end, end),
            "completeState": (end, math.inf),
        }
        if state not in spans:
            raise UnreadError(f"element {condition.tag}: state {state} is not read")
        return [spans[state]] if spans[state][0] < math.inf else []

    def _referred(self, condition: ET.Element) -> ET.Element:
        """Returns the element that a condition on states names, perhaps by the names of those around it as well."""
        kind, ref = condition.get("storyboardElementType", "").lower(), condition.get("storyboardElementRef", "")
        *around, name = ref.split("::")
        for element in self._by_name.get((kind, name), []):
            whole, outer = element, around[::-1]
            while outer and (whole := self._parents.get(whole)) is not None:  # type: ignore[assignment]
                outer = outer[1:] if whole.get("name") == outer[0] else outer
            if not outer:
                return element
        raise UnreadError(f"element {condition.tag}: there is no {kind} {ref}")


def action_in(action: ET.Element) -> ET.Element:
    """Returns the innermost element of an action that says what is done, such as TeleportAction."""
    inner = action
    while (inner is action or inner.tag in WRAPPERS) and len(inner):
        inner = inner[0]
    return inner


def _compared(rule: str | None, value: float) -> list[Span]:
    """Returns when the time compares with a value [s] as a rule says."""
    spans = {
        "greaterThan": (value, math.inf),
        "greaterOrEqual": (value, math.inf),
        "lessThan": (-math.inf, math.nextafter(value, -math.inf)),
        "lessOrEqual": (-math.inf, value),
        "equalTo": (value, value),
        "notEqualTo": ALWAYS,
    }
    if rule not in spans:
        raise UnreadError(f"element SimulationTimeCondition: rule {rule} is not read")
    return [spans[rule]]
