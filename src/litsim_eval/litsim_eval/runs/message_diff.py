"""Comparison of two messages bit by bit: where they differ first, and by how much."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

AGENT_FIELDS = ("id", "agent")
"""Fields with ids of agents: in messages of parallel arrays, and in records of a list."""

LENGTH = "length of "

Value = str | float | int | bool | None


@dataclass(frozen=True)
class Difference:
    """A difference between two messages of a step.

    Attributes:
        topic, step: of the messages.
        field: its name; of a record in a list, such as `takeovers.goal_pose.x`.
        agent: id of the agent concerned; None if there is none.
        recorded, computed: the values.
    """

    topic: str
    step: int
    field: str = ""
    agent: int | None = None
    recorded: Value = None
    computed: Value = None

    def of_field(self, name: str, recorded: Any, computed: Any, agent: int | None = None) -> Difference:
        """Returns a difference in the field `name` of what this one stands for."""
        return replace(self.within(name, agent), recorded=_plain(recorded), computed=_plain(computed))

    def within(self, name: str, agent: int | None = None) -> Difference:
        """Returns what stands for the field `name` of this one; the agent stays the same unless it is given."""
        field = f"{self.field}.{name}" if self.field else name
        return replace(self, field=field, agent=self.agent if agent is None else agent)

    @property
    def amount(self) -> float | None:
        """Absolute difference of two numbers."""
        if isinstance(self.recorded, int | float) and isinstance(self.computed, int | float):
            return abs(float(self.computed) - float(self.recorded))
        return None

    def __str__(self) -> str:
        about = "" if self.agent is None else f", agent {self.agent}"
        by = "" if not self.amount else f", off by {self.amount:.3g}"
        return (
            f"step {self.step}, {self.topic}{about}, field {self.field}: recorded {_text(self.recorded)}, "
            f"now {_text(self.computed)}{by}"
        )


@dataclass
class DiffSummary:
    """Summary of the differences between the messages of a run.

    Attributes:
        compared, different: numbers of pairs of messages.
        first: the first difference; within its message, the first that concerns an agent.
        largest: largest absolute difference of each numeric field that differs, by `topic field`.
    """

    compared: int = 0
    different: int = 0
    first: Difference | None = None
    largest: dict[str, float] = field(default_factory=dict)

    def add(self, topic: str, step: int, recorded: Any, computed: Any) -> None:
        """Compares two messages of a topic and step."""
        self.compared += 1
        apart = differences(topic, step, recorded, computed)
        if not apart:
            return
        self.different += 1
        self.first = self.first or next((difference for difference in apart if difference.agent is not None), apart[0])
        for difference in apart:
            if difference.amount is not None and not difference.field.startswith(LENGTH):
                name = f"{topic} {difference.field.split('[')[0]}"
                self.largest[name] = max(difference.amount, self.largest.get(name, 0.0))


def differences(topic: str, step: int, recorded: Any, computed: Any) -> list[Difference]:
    """Returns all fields that differ in two messages of one type; of an array, the first and the largest difference.

    Floats are compared by their bits: 0.0 and -0.0 differ, and a NaN equals itself.
    """
    return _differences(recorded, computed, Difference(topic, step))


def _differences(recorded: Any, computed: Any, place: Difference) -> list[Difference]:
    ids = tuple(_ids(message) for message in (recorded, computed))
    if ids[0] is not None and ids[1] is not None and not np.array_equal(ids[0], ids[1]):
        return _one_sided("id", ids[0].tolist(), ids[1].tolist(), place)  # the other arrays are parallel to the ids
    apart: list[Difference] = []
    for name in recorded.get_fields_and_field_types():
        a, b = getattr(recorded, name), getattr(computed, name)
        if hasattr(a, "get_fields_and_field_types"):
            apart += _differences(a, b, place.within(name))
        elif _of_messages(a) or _of_messages(b):
            apart += _records(name, a, b, place)
        elif isinstance(a, str):
            apart += [] if a == b else [place.of_field(name, a, b)]
        elif isinstance(a, list | array | np.ndarray | bytes):
            apart += _arrays(name, np.asarray(a), np.asarray(b), ids[0], place)
        elif np.asarray(a).tobytes() != np.asarray(b, np.asarray(a).dtype).tobytes():
            apart.append(place.of_field(name, a, b))
    return apart


def _arrays(name: str, a: np.ndarray, b: np.ndarray, ids: np.ndarray | None, place: Difference) -> list[Difference]:
    if len(a) != len(b):
        return [place.of_field(f"{LENGTH}{name}", len(a), len(b))]
    if a.dtype == b.dtype and a.tobytes() == b.tobytes():
        return []
    apart = np.flatnonzero([x.tobytes() != y.tobytes() for x, y in zip(a, b, strict=True)])
    width = len(a) // len(ids) if ids is not None and len(ids) else 0
    chosen = [int(apart[0])]
    if a.dtype.kind == "f":
        gaps = np.abs(a[apart].astype(np.float64) - b[apart].astype(np.float64))
        chosen.append(int(apart[int(np.argmax(np.nan_to_num(gaps)))]))
    differing = []
    for index in dict.fromkeys(chosen):
        agent = int(ids[index // width]) if ids is not None and width else None
        label = f"{name}[{index % width}]" if width > 1 else name if width else f"{name}[{index}]"
        differing.append(place.of_field(label, a[index], b[index], agent))
    return differing


def _records(name: str, a: list[Any], b: list[Any], place: Difference) -> list[Difference]:
    """Returns differences between two lists of messages, matched by agent if they have one, else by index."""
    keys_a, keys_b = _keys(a), _keys(b)
    if keys_a != keys_b:
        return _one_sided(name, keys_a, keys_b, place)
    named = bool(a) and hasattr(a[0], AGENT_FIELDS[1])
    apart = []
    for key, x, y in zip(keys_a, a, b, strict=True):
        apart += _differences(x, y, place.within(name, key) if named else place.within(f"{name}[{key}]"))
    return apart


def _keys(records: list[Any]) -> list[int]:
    return [int(getattr(record, AGENT_FIELDS[1], index)) for index, record in enumerate(records)]


def _one_sided(name: str, a: list[int], b: list[int], place: Difference) -> list[Difference]:
    """Returns differences of two unequal lists of agents: those in only one of them, or the order if there are none."""
    alone = sorted(set(a) ^ set(b))
    if not alone:
        return [place.of_field(f"order of {name}", str(a), str(b))]
    return [
        place.of_field(name, "present" if agent in a else "absent", "present" if agent in b else "absent", agent)
        for agent in alone
    ]


def _ids(message: Any) -> np.ndarray | None:
    values = getattr(message, AGENT_FIELDS[0], None)
    return None if values is None or np.ndim(values) != 1 else np.asarray(values)


def _of_messages(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and hasattr(value[0], "get_fields_and_field_types")


def _plain(value: Any) -> Value:
    return value.item() if isinstance(value, np.generic) else value


def _text(value: Value) -> str:
    return repr(value) if isinstance(value, float) else str(value)
