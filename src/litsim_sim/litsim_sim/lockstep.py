"""The lock-step rule, without ROS: who waits for what, which answers are stale, what is sent again.

The bridge publishes a step and waits in a :class:`Gate` until every required answer to it is in. A stage collects
its inputs in a :class:`Joiner` and answers each step once; asked for the same step again, it repeats its answer.
The bridge repeats the first step until every stage, the recorder included, has answered it, because messages of
a DDS graph can be lost until all readers and writers have matched; from then on delivery is reliable.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Gate:
    """Answers that the bridge waits for.

    Attributes:
        run_id: answers of other runs are dropped.
        required: names of the answers to every step.
        stale: answers dropped so far, by name.
    """

    run_id: str
    required: tuple[str, ...]
    stale: dict[str, int] = field(default_factory=dict)
    _step: int = -1
    _answers: dict[str, Any] = field(default_factory=dict)

    def open(self, step: int) -> None:
        """Wait for the answers to `step`."""
        self._step = step
        self._answers = {}

    def offer(self, name: str, run_id: str, step: int, answer: Any) -> None:
        """Take an answer; one of another run, another step, or a second one is stale."""
        if run_id != self.run_id or step != self._step or name in self._answers:
            self.stale[name] = self.stale.get(name, 0) + 1
        else:
            self._answers[name] = answer

    @property
    def step(self) -> int:
        """The step that was opened last; -1 before the first."""
        return self._step

    @property
    def missing(self) -> list[str]:
        """Names still waited for."""
        return [name for name in self.required if name not in self._answers]

    @property
    def answers(self) -> dict[str, Any]:
        """Answers so far."""
        return self._answers


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
        """Take an input; returns all inputs of its step once they are complete."""
        if run_id != self.run_id or step <= self.answered:
            return None
        held = self._pending.setdefault(step, {})
        held[name] = message
        if len(held) < len(self.inputs):
            return None
        self._pending = {k: v for k, v in self._pending.items() if k > step}
        self.answered = step
        return held

    def asked_again(self, name: str, run_id: str, step: int) -> bool:
        """Whether this input asks once more for the step that was answered last."""
        return name == self.inputs[0] and run_id == self.run_id and step == self.answered
