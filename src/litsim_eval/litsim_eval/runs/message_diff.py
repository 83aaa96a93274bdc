"""Comparison of two messages bit by bit: where they differ first, and by how much."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

AGENT_FIELDS = ("id", "agent")
"""Fields with ids of agents: in messages of parallel arrays, and in records of a list."""

LENGTH = "length of "

Value = str | float | int | bool | None
Apart = tuple[str, int | None, Value, Value]
"""Field, agent concerned if there is one, and the recorded and the computed value."""


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
    return [Difference(topic, step, *apart) for apart in _differences("", None, recorded, computed)]


def _differences(within: str, agent: int | None, recorded: Any, computed: Any) -> Iterator[Apart]:
    """Yields the fields that differ in two messages; their names begin with `within`, and `agent` is concerned."""
    ids, others = _ids(recorded), _ids(computed)
    if ids is not None and others is not None and ids != others:
        yield from _one_sided(f"{within}id", ids, others)  # the other arrays are parallel to the ids
        return
    for name in recorded.get_fields_and_field_types():
        field, a, b = within + name, getattr(recorded, name), getattr(computed, name)
        if hasattr(a, "get_fields_and_field_types"):
            yield from _differences(f"{field}.", agent, a, b)
        elif _of_messages(a) or _of_messages(b):
            yield from _records(field, agent, a, b)
        elif isinstance(a, str):
            yield from [] if a == b else [(field, agent, a, b)]
        else:
            yield from _values(field, agent, np.asarray(a), np.asarray(b), ids)


def _values(field: str, agent: int | None, a: np.ndarray, b: np.ndarray, ids: list[int] | None) -> Iterator[Apart]:
    """Yields the difference of two numbers, or the first and the largest of two arrays, maybe parallel to `ids`."""
    if a.shape != b.shape:
        yield f"{LENGTH}{field}", agent, len(a), len(b)
        return
    alone, width = not a.ndim, len(a) // len(ids) if a.ndim and ids else 0
    a, b = np.atleast_1d(a), np.atleast_1d(b.astype(a.dtype, copy=False))
    if a.tobytes() == b.tobytes():
        return
    apart = np.flatnonzero([x.tobytes() != y.tobytes() for x, y in zip(a, b, strict=True)])
    chosen = [int(apart[0])]
    if a.dtype.kind == "f":
        gaps = np.abs(a[apart].astype(np.float64) - b[apart].astype(np.float64))
        chosen.append(int(apart[int(np.argmax(np.nan_to_num(gaps)))]))
    for index in dict.fromkeys(chosen):
        concerned = ids[index // width] if ids and width else agent
        place = "" if alone or width == 1 else f"[{index % width if width else index}]"
        yield f"{field}{place}", concerned, a[index].item(), b[index].item()


def _records(field: str, agent: int | None, a: list[Any], b: list[Any]) -> Iterator[Apart]:
    """Yields differences between two lists of messages, matched by agent if they have one, else by index."""
    keys, others = ([int(getattr(message, AGENT_FIELDS[1], k)) for k, message in enumerate(both)] for both in (a, b))
    if keys != others:
        yield from _one_sided(field, keys, others)
        return
    named = hasattr(a[0], AGENT_FIELDS[1])
    for key, x, y in zip(keys, a, b, strict=True):
        yield from _differences(f"{field}." if named else f"{field}[{key}].", key if named else agent, x, y)


def _one_sided(field: str, a: list[int], b: list[int]) -> list[Apart]:
    """Returns differences of two unequal lists of agents: those in only one of them, or the order if there are none."""
    presence = {True: "present", False: "absent"}
    alone = sorted(set(a) ^ set(b))
    return [(field, agent, presence[agent in a], presence[agent in b]) for agent in alone] or [
        (f"order of {field}", None, str(a), str(b))
    ]


def _ids(message: Any) -> list[int] | None:
    values = getattr(message, AGENT_FIELDS[0], None)
    return None if values is None or np.ndim(values) != 1 else [int(value) for value in values]


def _of_messages(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and hasattr(value[0], "get_fields_and_field_types")


def _text(value: Value) -> str:
    return repr(value) if isinstance(value, float) else str(value)
