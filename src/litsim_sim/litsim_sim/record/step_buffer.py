"""Buffer of the messages of a run before they are written to its bag: by step, confirmed, in order. Without ROS.

Messages of different topics arrive in any order and from several processes. For equal bags of equal runs, a step is
written only when none of its messages can be missing any more, in a given order of the topics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.core.topic_names import AGENTS, CLOCK, EGO_APPLIED, EGO_INPUTS, EGO_STATE

CONFIRM_EVERY = 10  # [steps] period of confirmations
LAG = 2  # [steps] by which writing lags, so that timings, which arrive late, are written with their step
OF_THE_BRIDGE = (CLOCK, AGENTS, EGO_STATE)  # present at every step, whichever answer is missing
AHEAD = 5  # [steps] by which messages of foreign publishers may be ahead of the agents received
REPEATS_MAX = 10  # repetitions of step 0 for which the recorder waits to hear an external ego
KEPT = 20  # most messages of one step that are kept on a topic with foreign publishers
NAMED = 3  # most steps that a message about gaps names


class StepBuffer:
    """Holds the messages of a run until their step is complete, then confirms the step, and writes it a little later.

    A step is complete once each of the run's per-step topics holds it, step 0 also only once an external ego has been
    heard, so that none of its answers is lost; if the bridge continues without an answer, once the bridge's own
    messages are there. An answer that arrives after its step was written is written on arrival. At most :data:`KEPT`
    messages of foreign publishers are kept per topic and step; if their stamps are far from the current step, they
    count for that: they must not delay anything.

    Attributes:
        newest: newest step whose agents have been received; -1 before the first.
    """

    def __init__(
        self,
        order: Sequence[str],
        per_step: Sequence[str],
        foreign: Sequence[str],
        total_steps: int,
        write: Callable[[str, bytes, int], None],
        confirm: Callable[[int], None],
    ) -> None:
        """Buffer the messages of a run.

        Args:
            order: names of all recorded topics, in the order in which the messages of one step are written.
            per_step: names of those that hold one message for each step of this run.
            foreign: names of those on which foreign nodes publish as well.
            total_steps: last step; a run may end earlier.
            write: called with topic, serialised message and step of every message that is due, steps ascending.
            confirm: called with the newest step up to which the recording is complete, every :data:`CONFIRM_EVERY`
                steps, at the first and the last, and whenever the bridge shows a step again.
        """
        self.newest = -1
        self._order, self._per_step, self._foreign = order, per_step, foreign
        self._last = total_steps
        self._write = write
        self._confirm = confirm
        self._pending: dict[int, dict[str, list[bytes]]] = {}
        self._next = 0  # step to be confirmed next
        self._written = 0  # step to be written next
        self._repeated = 0  # times that step 0 came in
        self._kept: Counter[tuple[str, int]] = Counter()
        self._missed: set[int] = set()  # steps that the bridge went on from without all answers
        self._absent: set[tuple[int, str]] = set()  # messages missing when their step was written
        self._first: dict[int, dict[str, int]] = {}  # by recent step and topic, the hash of the first message
        self._contradicted: dict[str, int] = {}  # first step to which a topic has two different answers

    @property
    def confirmed(self) -> int:
        """Newest step up to which the recording is complete; -1 before the first."""
        return self._next - 1

    @property
    def gaps(self) -> str:
        """Text that lists the gaps of the recording, and topics with two answers to a step; empty for none."""
        lacking: dict[str, list[int]] = {}
        for step, name in sorted(self._absent):
            if step not in self._missed or name in OF_THE_BRIDGE:
                lacking.setdefault(name, []).append(step)
        gaps = [
            f"{name} lacks {len(steps)} steps ({', '.join(map(str, steps[:NAMED]))}{', ...' * (len(steps) > NAMED)})"
            for name, steps in lacking.items()
        ]
        gaps += [
            f"{name} has two different messages for step {step}, so somebody else publishes there"
            for name, step in self._contradicted.items()
        ]
        return "; ".join(gaps)

    def take(self, name: str, step: int, data: bytes) -> None:
        """Hold a message of topic `name` until its step is written: that of its stamp, or 0 without one."""
        if name in self._foreign and name not in self._per_step:
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
        contradicted = self._contradicts(name, step, data)
        if held and name in self._per_step and not contradicted:  # the bridge asks again
            self._advance()
            self._repeat_confirmation()
        elif data not in held:
            self._pending.setdefault(step, {}).setdefault(name, []).append(data)
            self._advance()

    def go_on(self, step: int) -> None:
        """Note that the bridge has continued after `step` without all answers: these are not awaited, and not gaps."""
        self._missed.add(step)
        self._advance()

    def end_at(self, step: int) -> None:
        """Note that the run ends after `step`: it is confirmed as the last one, even if it was received before."""
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
        """Returns the step under which a foreign message is kept."""
        about_now = self.newest - RECORDER_WINDOW <= step <= self.newest + AHEAD
        return min(max(step if about_now else self.newest, 0), self._last)

    def _take_late(self, name: str, step: int, data: bytes) -> None:
        """Take a message to a step that has been written."""
        absent = (step, name) in self._absent
        if name not in self._per_step or absent or self._contradicts(name, step, data):
            self._absent.discard((step, name))
            self._write(name, data, step)
        else:
            self._repeat_confirmation()  # the bridge asks again

    def _contradicts(self, name: str, step: int, data: bytes) -> bool:
        """Note a message of a per-step topic; returns whether it differs from the first one for its recent step."""
        if name not in self._per_step or step < self._written - RECORDER_WINDOW:
            return False
        contradicts = self._first.setdefault(step, {}).setdefault(name, hash(data)) != hash(data)
        if contradicts:
            self._contradicted.setdefault(name, step)
        return contradicts

    def _complete(self, step: int) -> bool:
        """Returns whether all messages that complete a step are here; see the class's description."""
        held = self._pending.get(step, {})
        of_the_bridge = [name for name in OF_THE_BRIDGE if name in self._per_step]
        needed = of_the_bridge if step in self._missed else self._per_step
        awaits_ego = step == 0 and EGO_APPLIED in self._per_step and self._repeated <= REPEATS_MAX
        heard = not awaits_ego or any(name in held for name in EGO_INPUTS.values())
        return heard and all(name in held for name in needed)

    def _advance(self) -> None:
        """Confirm steps that are complete, and write those of which no message can be missing any more."""
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
        self._first.pop(step - RECORDER_WINDOW, None)
        self._absent |= {(step, name) for name in self._per_step if name not in held}
        for name in self._order:
            for data in sorted(held.get(name, [])):
                self._write(name, data, step)
