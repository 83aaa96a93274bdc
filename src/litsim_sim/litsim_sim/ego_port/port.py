"""The ego port, without ROS: selects the answers of a driving system that count, and makes commands of them.

The bridge opens a step, offers every message that arrives, and takes one command. Faults are counted and reported;
whether the run then ends or the last good answer is held is decided in one place.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

from litsim_sim.core.errors import printable, shown
from litsim_sim.core.latency import NONE, Delayed
from litsim_sim.core.scene import STEP_NS, STEP_S, AgentTable, EgoCommand
from litsim_sim.core.topic_names import AUTO, EGO_INPUTS, Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import Answer, problem
from litsim_sim.ego_port.tracking import EgoState, Reference, Trajectory, TwistTarget, follow_twist

COUNTS = ("answered", "late", "stale", "future", "surplus", "invalid", "refused", "joined")
REMARK_PERIOD = 10  # [steps] for which a remark of the same kind is not repeated


class Level(IntEnum):
    """Numbered as in ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Remark:
    """A message on a step for ``/diagnostics``."""

    step: int
    level: Level
    text: str


class AnswerInvalid(Exception):
    """The answer to a step cannot be used, and the run must end."""


class EgoPort:
    """Takes the answers of the ego's driver, one for every step.

    The first message decides which interface is in use, if none was chosen, unless it names another run. An answer to
    the current step counts once. One to an earlier step is stale, unless it is the newest so far: then it is late, and
    held from then on. One to a later step is dropped.

    Attributes:
        interface: interface in use; None before the first message.
        by_first: whether the first message decides the interface, as none was chosen.
        counts: numbers of messages under the names of :data:`COUNTS`: `answered`; `late`, to an earlier step, and held
            from then on; `stale`, to an earlier step or of another run; `future`, to a later step; `surplus`, more to a
            step than asked for; `invalid`; `refused`, of another interface. And `joined`, the number of publishers that
            the bridge has found in mid-run, as of a stack that was started again.
        remarks: remarks to be published; the publisher clears the list.
        answered: newest step that was answered, by a valid answer or not; -1 before the first.
        heard: whether any message has been received.
        unfit: text on the last message that was no answer to the current step; empty for none.
    """

    def __init__(
        self,
        run_id: str,
        vehicle: VehicleModel,
        interface: str = AUTO,
        *,
        stop_on_invalid: bool = True,
        latency: str = NONE,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Take the answers of a run; they count later by `latency`, of which `clock` measures one that is measured."""
        self.interface = None if interface == AUTO else Interface(interface)
        self.by_first = interface == AUTO
        self.counts: Counter[str] = Counter()
        self.remarks: list[Remark] = []
        self.answered = -1
        self.heard = False
        self.unfit = ""
        self._run_id = run_id
        self._vehicle = vehicle
        self._stop_on_invalid = stop_on_invalid
        self._step = -1
        self._asked = 0  # times for the current step
        self._offered = 0  # answers to it
        self._owed: dict[int, int] = {}  # answers that may come yet to steps asked for again
        self._ego: EgoState | None = None
        self._driven = False
        self._invalid = ""  # text that says which answer cannot be used, and why, if the run must end for that
        self._answers = Delayed[EgoCommand | TwistTarget | Reference](latency)
        self._clock = clock
        self._opened: dict[int, float] = {}  # clock times [s] at which steps were opened that are not answered
        self._remarked: dict[str, int] = {}

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics on which an answer may be received."""
        return tuple(EGO_INPUTS.values()) if self.interface is None else (EGO_INPUTS[self.interface],)

    @property
    def missing(self) -> bool:
        """Whether the current step has no answer yet."""
        return self.answered < self._step

    @property
    def behind(self) -> int:
        """Number of answers to the previous step, asked for repeatedly, that may come before one to the current."""
        return self._owed.get(self._step - 1, 0) if self.missing else 0

    def open(self, step: int, ego: EgoState | None, *, driven: bool) -> None:
        """Wait for the answer to `step`; `ego` is None if it is not on the road.

        Unless it is `driven`, the answer does not count: before the history is over, or once the ego has left.
        """
        if self._asked > max(1, self._offered):
            self._owed[self._step] = self._asked - self._offered
        self._step, self._ego, self._driven = step, ego, driven and ego is not None
        self._asked, self._offered, self._invalid, self.unfit = 0, 0, "", ""
        self._opened[step] = self._clock()

    def ask(self) -> None:
        """Note that the current step is published, first or again: one more answer to it is then no surplus."""
        self._asked += 1

    def offer(self, answer: Answer) -> None:
        """Take a message."""
        if self._step < 0:
            return
        self.heard = True
        if answer.run_id not in (None, self._run_id):
            text = f"an answer to run {shown(answer.run_id)}, at step {self._step}, is stale"
            self._count("stale", Level.WARN, f"{EGO_INPUTS[answer.interface]}: {text}")
            return
        if self.interface is None:
            self.interface = answer.interface
            self._remark("interface", Level.OK, f"the ego is driven over {EGO_INPUTS[answer.interface]}")
        if answer.interface != self.interface:
            self._count("refused", Level.ERROR, f"{EGO_INPUTS[answer.interface]}: ignored, {self.topics[0]} is in use")
            return
        step = self._step_of(answer)
        if step is not None and step <= self.answered and self._owed.get(step, 0) > 0:
            self._owed[step] -= 1
        elif step is None or (step < self._step and step <= self.answered):
            self._count("stale", Level.WARN, f"{self.topics[0]}: {self._described(answer)} is stale")
        elif step > self._step:
            self._count("future", Level.WARN, f"{self.topics[0]}: {self._described(answer)} is of the future")
        elif step == self.answered:
            if self._offered < self._asked:
                self._offered += 1
            else:
                self._count("surplus", Level.WARN, f"{self.topics[0]}: more answers to step {step} than asked for")
        else:
            self._accept(step, answer)

    def take(self) -> EgoCommand:
        """Returns the command for the current step, by the newest answer that counts.

        Raises:
            AnswerInvalid: the answer cannot be used, and the run must end.
        """
        if self._invalid and self._stop_on_invalid:
            raise AnswerInvalid(self._invalid)
        held = self._answers.in_force(self._step)
        if isinstance(held, EgoCommand):
            return replace(held, step=self._step)
        if held is None or self._ego is None or not self._driven:
            return EgoCommand(self._step)
        if isinstance(held, Reference):
            return EgoCommand(self._step, *held.command(self._ego, self._vehicle))
        return EgoCommand(self._step, *follow_twist(held, self._ego, self._vehicle))

    def _accept(self, step: int, answer: Answer) -> None:
        """Take the first answer to a step, the current or a missed one."""
        self.answered = step
        opened = self._opened.get(step, self._opened[self._step])
        self._opened = {later: begin for later, begin in self._opened.items() if later > step}
        if step < self._step:
            self._count(
                "late", Level.WARN, f"{self.topics[0]}: {self._described(answer)} is late by {self._step - step} steps"
            )
        else:
            self._offered += 1
        wrong, target = problem(answer), answer.target
        too_late = step < self._step and not wrong  # then what is wrong may be that the ego has moved on
        reference = None
        if not wrong and isinstance(target, Trajectory) and self._ego is not None:
            reference = Reference(target, self._ego)
            fault = reference.problem(self._ego, self._vehicle)
            reference = None if fault else reference
            wrong = fault if self._driven else ""  # in the history, it may be empty
        if wrong:
            self._count("invalid", Level.ERROR, f"{self.topics[0]}: {self._described(answer)} cannot be used: {wrong}")
            if not too_late:
                self._invalid = printable(f"the answer to step {step} on {self.topics[0]} cannot be used: {wrong}")
            return
        self.counts["answered"] += 1
        held = reference if isinstance(target, Trajectory) else target
        if held is not None:
            self._answers.put(step, held, self._clock() - opened, self._step)

    def _step_of(self, answer: Answer) -> int | None:
        """Returns the step that is answered; None if it is between two past steps."""
        if answer.step_answered is not None:
            return answer.step_answered
        return None if answer.stamp_ns < self._step * STEP_NS else self._step + 1

    def _described(self, answer: Answer) -> str:
        """Returns a description of a message."""
        if answer.step is not None:
            return f"the answer to step {answer.step}, at step {self._step},"
        return f"the message stamped {answer.stamp_ns * 1e-9:.3f} s, at {self._step * STEP_S:.1f} s,"

    def _count(self, kind: str, level: Level, text: str) -> None:
        self.counts[kind] += 1
        text = printable(text)
        self.unfit = text if self.missing else self.unfit
        self._remark(kind, level, f"{text} ({self.counts[kind]} so far)")

    def _remark(self, kind: str, level: Level, text: str) -> None:
        """Note a remark, unless one of its kind was noted less than REMARK_PERIOD steps ago."""
        last = self._remarked.get(kind)
        if last is None or self._step >= last + REMARK_PERIOD:
            self._remarked[kind] = self._step
            self.remarks.append(Remark(self._step, level, text))


def ego_state(table: AgentTable, ego_id: int) -> EgoState | None:
    """Returns the state of the ego; None if it is not on the road."""
    row = table.row(ego_id)
    if row < 0:
        return None
    values = (float(getattr(table, name)[row]) for name in ("x", "y", "yaw", "speed", "length"))
    return EgoState(table.step * STEP_S, *values)
