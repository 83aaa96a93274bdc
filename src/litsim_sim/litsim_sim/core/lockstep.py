"""The lock-step protocol, without ROS: waiting for answers, stale answers, and repeated requests.

The bridge publishes a step and waits in a :class:`Gate` until the answer of the policy to it is in. A stage collects
its inputs in a :class:`Joiner` and answers each step once; asked for the same step again, it repeats its answer.
The bridge repeats the first step until every stage, the recorder included, has answered it, because messages of
a DDS graph can be lost until all readers and writers have matched; from then on delivery is reliable.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from sys import intern
from typing import Any

RECORDER_WINDOW = 50
"""Steps by which the bridge may be ahead of what the recorder has confirmed."""


def unanswered(summary: Mapping[str, Any]) -> list[str]:
    """Returns what makes a run invalid by the bridge's `summary`, in words: answers that were missed or unusable."""
    missed = sorted((summary.get("missed") or {}).items())
    invalid = (summary.get("ego_port") or {}).get("invalid")
    texts = [f"{count} answers missed on {topic}" for topic, count in missed if count]
    return [*texts, f"{invalid} answers of the ego could not be used"] if invalid else texts


@dataclass
class Gate:
    """Takes the answers that the bridge waits for on one topic, one to every step.

    Attributes:
        run_id: answers of other runs are dropped.
        stale: number of answers that came late, twice, or to another run. Answers to repeated requests for a step are
            not counted, however late they come.
        step: the step that was opened last; -1 before the first.
        newest: the newest answer, which is held if the one to the current step is missing; None before the first.
    """

    run_id: str
    stale: int = 0
    step: int = -1
    newest: Any = None
    _answered: int = -1  # step of the newest answer
    _asked: Counter[int] = field(default_factory=Counter)  # how often the current step and repeated ones were asked for
    _repeated: Counter[int] = field(default_factory=Counter)  # answers after the first, by step

    def open(self, step: int) -> None:
        """Begin `step`, to which an answer is required from now on."""
        self._asked = Counter({k: times for k, times in self._asked.items() if times > 1})
        self.step = step

    def ask(self) -> None:
        """Count a request for the current step, the first or a repeated one."""
        self._asked[self.step] += 1

    def offer(self, run_id: str, step: int, answer: Any) -> None:
        """Take an answer; a late one is counted as stale, but kept if it is the newest so far."""
        newer = run_id == self.run_id and self._answered < step <= self.step
        if newer:
            self._answered, self.newest = step, answer
        elif run_id == self.run_id and self._repeated[step] < self._asked[step] - 1:
            self._repeated[step] += 1
            return
        self.stale += not newer or step < self.step

    @property
    def missing(self) -> bool:
        """Whether the current step has no answer yet."""
        return self._answered != self.step


@dataclass
class Joiner:
    """Inputs that a stage needs before it can answer a step.

    Attributes:
        run_id: inputs of other runs are dropped.
        inputs: names of the inputs of every step; the first one is the trigger that asks for the step.
    """

    run_id: str
    inputs: tuple[str, ...]
    answered: int = -1
    _pending: dict[int, dict[str, Any]] = field(default_factory=dict)

    def offer(self, name: str, run_id: str, step: int, message: Any) -> dict[str, Any] | None:
        """Take an input; return all inputs of its step once they are complete."""
        if run_id != self.run_id or step <= self.answered:
            return None
        held = self._pending.setdefault(step, {})
        held[name] = message
        if len(held) < len(self.inputs):
            return None
        self._pending = {k: v for k, v in self._pending.items() if k > step}
        self.answered = step
        return held

    def too_late(self, name: str, run_id: str, step: int) -> bool:
        """Returns whether this input asks for a step of a run that has begun with another stage in this place."""
        asks = name == self.inputs[0] and run_id == self.run_id
        return asks and self.answered < 0 < step and 0 not in self._pending

    def asked_again(self, name: str, run_id: str, step: int) -> bool:
        """Returns whether this input asks again for the step that was answered last."""
        return name == self.inputs[0] and run_id == self.run_id and step == self.answered


def step_marks(marks: Mapping[str, float]) -> str:
    """Returns the marks of one step, clock times [s] by name, as the `text` of a timing message."""
    return " ".join(f"{name}={time:.6f}" for name, time in marks.items())


def marks_of(text: str) -> dict[str, float]:
    """Inverts :func:`step_marks`; parts of the text that are not marks are ignored."""
    marks = {}
    for part in text.split():
        name, _, value = part.partition("=")
        with suppress(ValueError):
            marks[intern(name)] = float(value)  # few names, of many steps
    return marks
