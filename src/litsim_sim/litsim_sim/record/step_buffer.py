"""The messages of a run on their way to its bag: collected by step, confirmed, written in order. Without ROS.

Messages of different topics arrive in any order and from several processes. Equal runs are to give equal bags, so a
step is written only when nothing of it can be missing any more, its messages in an order of the topics that is given.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.core.topic_names import AGENTS, CLOCK, EGO_APPLIED, EGO_STATE
from litsim_sim.ego_port.answer import INPUTS

CONFIRM_EVERY = 10  # steps
LAG = 2  # steps by which writing lags, so that timings, which come late, are written with their step
OF_THE_BRIDGE = (CLOCK, AGENTS, EGO_STATE)  # present at every step, whichever answer is missing
AHEAD = 5  # steps by which what others publish may be ahead of the agents that have come in
REPEATS_MAX = 10  # of step 0 for which an external ego is given time to be met by the recorder as well
KEPT = 20  # messages of one step that are kept on a topic that others publish on
NAMED = 3  # steps that a message about gaps names

Write = Callable[[str, bytes, int], None]
"""Writes a serialised message of a topic to the step that is given."""


@dataclass(frozen=True)
class BufferedRun:
    """What the buffer has to know of a run.

    Attributes:
        order: names of all recorded topics, in the order in which the messages of one step are written.
        per_step: names of those that hold one message for each step of this run.
        foreign: names of those on which others than LitSim publish as well.
        total_steps: the steps are numbered 0 .. `total_steps`, inclusive; a run may end before.
    """

    order: Sequence[str]
    per_step: Sequence[str]
    foreign: Sequence[str]
    total_steps: int


class StepBuffer:
    """Holds the messages of a run until their step is complete, then confirms the step, and writes it a little later.

    A step is complete once each of the run's per-step topics holds it, and step 0 once an external ego has been heard,
    so that none of its answers is lost; where the bridge goes on without an answer, once what the bridge itself
    publishes is there. An answer that comes after its step was written is written where it comes. Of the messages of
    other publishers than LitSim, :data:`KEPT` per topic and step are kept; if their stamps are not of about now, they
    count as of the current step: they must not hold up anything.

    Attributes:
        newest: newest step of which the agents have come in; -1 before the first.
    """

    def __init__(self, run: BufferedRun, write: Write, confirm: Callable[[int], None]) -> None:
        """Buffer the messages of `run`.

        Args:
            run: the run to record.
            write: is called for every message that is due, steps ascending.
            confirm: is called with the newest step up to which the record is complete, every :data:`CONFIRM_EVERY`
                steps, at the first and the last, and whenever the bridge shows a step again.
        """
        self.newest = -1
        self._run = run
        self._last = run.total_steps
        self._write = write
        self._confirm = confirm
        self._pending: dict[int, dict[str, list[bytes]]] = {}
        self._next = 0  # step to be confirmed next
        self._written = 0  # step to be written next
        self._repeated = 0  # times that step 0 came in
        self._kept: Counter[tuple[str, int]] = Counter()
        self._missed: set[int] = set()  # steps that the bridge went on from without all answers
        self._absent: set[tuple[int, str]] = set()  # messages missing when their step was written

    @property
    def confirmed(self) -> int:
        """Newest step up to which the record is complete; -1 before the first."""
        return self._next - 1

    @property
    def gaps(self) -> str:
        """In words, what the record lacks that it should hold; empty where it is whole."""
        lacking: dict[str, list[int]] = {}
        for step, name in sorted(self._absent):
            if step not in self._missed or name in OF_THE_BRIDGE:
                lacking.setdefault(name, []).append(step)
        return "; ".join(
            f"{name} lacks {len(steps)} steps ({', '.join(map(str, steps[:NAMED]))}{', ...' * (len(steps) > NAMED)})"
            for name, steps in lacking.items()
        )

    def take(self, name: str, step: int, data: bytes) -> None:
        """Hold a message of topic `name` until its step, that of its stamp, is written; 0 where it has no stamp."""
        if name in self._run.foreign and name not in self._run.per_step:
            step = self._placed(step)
            self._kept[name, step] += 1
            if self._kept[name, step] > KEPT:
                return
        elif name == AGENTS:
            self.newest = max(self.newest, min(step, self._last))
            self._repeated += step == 0
        if step > self._last:
            return  # of a foreign clock
        if step < self._written:
            self._take_late(name, step, data)
            return
        held = self._pending.get(step, {}).get(name, [])
        if held and name in self._run.per_step:  # the bridge asks again
            self._advance()
            self._repeat_confirmation()
        elif data not in held:
            self._pending.setdefault(step, {}).setdefault(name, []).append(data)
            self._advance()

    def go_on(self, step: int) -> None:
        """The bridge has gone on from `step` without all answers: they are not waited for, and no gap."""
        self._missed.add(step)
        self._advance()

    def end_at(self, step: int) -> None:
        """The run will be over after `step`: that is confirmed as the last one, even if it has come in already."""
        self._last = min(self._last, step)
        if self._next > self._last:
            self._repeat_confirmation()

    def end(self, *, amid_step: bool) -> None:
        """Write the buffered messages, complete or not; if the run ended `amid_step`, its last step counts no gaps."""
        for step in range(self._written, max(self._pending, default=-1) + 1):
            self._write_step(step)
        if amid_step:
            self._absent = {(step, name) for step, name in self._absent if step < self._next}

    def _placed(self, step: int) -> int:
        """The step under which a foreign message is kept."""
        about_now = self.newest - RECORDER_WINDOW <= step <= self.newest + AHEAD
        return min(max(step if about_now else self.newest, 0), self._last)

    def _take_late(self, name: str, step: int, data: bytes) -> None:
        """A message to a step that has been written."""
        if name not in self._run.per_step or (step, name) in self._absent:
            self._absent.discard((step, name))
            self._write(name, data, step)
        else:
            self._repeat_confirmation()  # the bridge asks again

    def _complete(self, step: int) -> bool:
        held = self._pending.get(step, {})
        needed = OF_THE_BRIDGE if step in self._missed else self._run.per_step
        met = step > 0 or EGO_APPLIED not in self._run.per_step or self._repeated > REPEATS_MAX
        return all(name in held for name in needed) and (met or any(name in held for name in INPUTS.values()))

    def _advance(self) -> None:
        """Confirm steps that are complete, and write those that nothing can be missing from any more."""
        before, newest = self._next, max(self._pending, default=0)
        while newest >= self._next and (
            self._complete(self._next) or newest - self._next > RECORDER_WINDOW // 2  # it will not come any more: a gap
        ):
            self._next += 1
        due = self._next // CONFIRM_EVERY > before // CONFIRM_EVERY or self._next in (1, self._last + 1)
        if self._next > before and due:
            self._repeat_confirmation()
        while self._written < self._next - LAG:
            self._write_step(self._written)
            self._written += 1

    def _repeat_confirmation(self) -> None:
        if self._next:
            self._confirm(self._next - 1)

    def _write_step(self, step: int) -> None:
        held = self._pending.pop(step, {})
        self._absent |= {(step, name) for name in self._run.per_step if name not in held}
        for name in self._run.order:
            for data in sorted(held.get(name, [])):
                self._write(name, data, step)
