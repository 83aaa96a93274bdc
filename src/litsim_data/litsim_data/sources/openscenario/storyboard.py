"""When the elements of an OpenSCENARIO storyboard start and end, by triggers that depend on times alone.

A trigger holds where all conditions of one of its groups do. A condition holds at intervals of time; its edge makes
points in time of these, and its delay shifts them. Conditions on entities would need what is not simulated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from xml.etree import ElementTree as ET

from litsim_data.sources.openscenario.xml import UnreadError, number

Span = tuple[float, float]
"""First and last time [s] at which a condition holds."""
ALWAYS: Span = (-math.inf, math.inf)
WRAPPERS = {"PrivateAction", "GlobalAction", "LongitudinalAction", "LateralAction", "RoutingAction", "EntityAction"}
"""Elements that stand around an action and say only of what kind it is."""


class Storyboard:
    """The storyboard of a scenario.

    Args:
        root: the root element of the scenario.
        end_of: returns when an action that starts at a time [s] ends [s]; it raises UnreadError if that is not known.
    """

    def __init__(self, root: ET.Element, end_of: Callable[[ET.Element, float], float]) -> None:
        self._end_of = end_of
        self._parents = {part: whole for whole in root.iter() for part in whole}
        self._by_name: dict[tuple[str, str], list[ET.Element]] = {}
        for element in root.iter():
            self._by_name.setdefault((element.tag.lower(), element.get("name", "")), []).append(element)
        self._values = {
            one.get("name", ""): one.get("value", "")
            for one in root.findall("ParameterDeclarations/ParameterDeclaration")
        }
        self._times: dict[tuple[str, ET.Element], float | None] = {}
        """Start and end of elements [s], once computed; None during the computation."""

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
        trigger = element.find("StopTrigger")
        return math.inf if trigger is None or not len(trigger) else self._triggered(trigger, 0.0)

    def around(self, element: ET.Element) -> ET.Element:
        """Returns the element that directly holds another one."""
        return self._parents[element]

    def cut_off(self, event: ET.Element) -> float:
        """Returns when the StopTrigger of the act around an event ends it [s]; infinite if never.

        Raises:
            UnreadError: what the trigger waits for is not read.
        """
        act = self._act(event)
        return math.inf if act is None else self.stop(act)

    def _remembered(self, what: str, element: ET.Element, compute: Callable[[], float]) -> float:
        key = (what, element)
        if key not in self._times:
            self._times[key] = None
            try:
                self._times[key] = compute()
            except (UnreadError, RecursionError) as error:
                del self._times[key]
                raise UnreadError(str(error)) from error
        time = self._times[key]
        if time is None:
            raise UnreadError(f"element {element.tag} {element.get('name')} waits for itself")
        return time

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

    def _act(self, element: ET.Element) -> ET.Element | None:
        """Returns the act around an element; None of acts themselves."""
        while (whole := self._parents.get(element)) is not None:
            if whole.tag == "Act":
                return whole
            element = whole
        return None

    def _end(self, element: ET.Element) -> float:
        start = self.start(element)
        if element.tag == "Action" and start < math.inf:
            return self._end_of(element, start)
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
        inner = kind if kind is not None else condition.find("ByEntityCondition/EntityCondition/*")
        raise UnreadError(f"element {condition.tag if inner is None else inner.tag} is not read")

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
