"""The recorder's buffer: what is written when, under which step, what is confirmed, and what counts as a gap."""

import pytest

from litsim_sim.core.lockstep import RECORDER_WINDOW
from litsim_sim.record.step_buffer import AHEAD, CONFIRM_EVERY, KEPT, LAG, REPEATS_MAX, StepBuffer

CLOCK, AGENTS, STATE, CONTROLS, EGO = "/clock", "/litsim/agents", "/litsim/ego/state", "/litsim/controls", "/litsim/ego"
TIMING, TWIST, APPLIED, NEWS = "/litsim/timing", "/litsim/ego/twist", "/litsim/ego/applied", "/diagnostics"
BRIDGES = (CLOCK, AGENTS, STATE)
ORDER = (NEWS, *BRIDGES, CONTROLS, EGO, TWIST, APPLIED, TIMING)
LAST = 30


class Bag:
    """What came out of a buffer."""

    def __init__(self, per_step: tuple[str, ...] = (*BRIDGES, CONTROLS), last: int = LAST) -> None:
        self.written: list[tuple[int, str, bytes]] = []
        self.confirmed: list[int] = []
        self.buffer = StepBuffer(ORDER, per_step, (TWIST, NEWS), last, self.write, self.confirmed.append)

    def write(self, name: str, data: bytes, step: int) -> None:
        self.written.append((step, name, data))

    def show(self, step: int, *names: str) -> None:
        """A message on each of the topics, which says of what step it is."""
        for name in names or (*BRIDGES, CONTROLS):
            self.buffer.take(name, step, b"%d" % step)

    def steps_of(self, name: str) -> list[int]:
        return [step for step, topic, _ in self.written if topic == name]


def test_messages_of_a_step_are_written_in_the_order_of_the_topics() -> None:
    bag = Bag()
    for step in range(LAST + 1):
        bag.show(step, CONTROLS, STATE, AGENTS, CLOCK)
    bag.buffer.end(amid_step=False)
    expected = [(step, name, b"%d" % step) for step in range(LAST + 1) for name in (*BRIDGES, CONTROLS)]
    assert bag.written == expected
    assert bag.buffer.gaps == ""


def test_several_messages_of_a_topic_and_step_are_written_in_one_order_whenever_they_came() -> None:
    bags = []
    for order in ((b"a", b"b", b"a"), (b"b", b"a", b"b")):
        bag = Bag()
        for data in order:
            bag.buffer.take(TIMING, 0, data)
        bag.buffer.end(amid_step=True)
        bags.append(bag.written)
    assert bags == [[(0, TIMING, b"a"), (0, TIMING, b"b")]] * 2  # what came twice is written once


def test_writing_waits_for_the_late_topic_of_a_step() -> None:
    bag = Bag()
    for step in range(5):
        bag.show(step, *BRIDGES)
    assert (bag.written, bag.confirmed) == ([], [])
    bag.show(0, CONTROLS)
    assert (bag.written, bag.confirmed) == ([], [0])
    for step in range(1, 5):
        bag.show(step, CONTROLS)
    assert bag.steps_of(CONTROLS) == list(range(5 - LAG))  # timings may still find their step
    bag.show(4, TIMING)
    bag.show(2, TIMING)  # too late for its place, but not lost
    bag.buffer.end(amid_step=False)
    assert bag.steps_of(TIMING) == [2, 4]
    assert bag.buffer.gaps == ""


def test_steps_are_confirmed_now_and_then_and_at_both_ends() -> None:
    bag = Bag(last=34)
    for step in range(35):
        bag.show(step)
    assert bag.confirmed == [0, *range(CONFIRM_EVERY - 1, 34, CONFIRM_EVERY), 34]


def test_a_step_that_is_shown_again_is_confirmed_again_and_written_once() -> None:
    bag = Bag()
    for step in range(4):
        bag.show(step)
    assert bag.confirmed == [0]
    bag.show(3, AGENTS)  # still held
    bag.show(0, AGENTS)  # written already
    assert bag.confirmed == [0, 3, 3]
    bag.buffer.end(amid_step=False)
    assert bag.steps_of(AGENTS) == [0, 1, 2, 3]


def test_an_answer_that_never_comes_is_a_gap_once_the_run_is_far_ahead() -> None:
    bag = Bag(last=100)
    for step in range(80):
        bag.show(step, *(BRIDGES if step in (7, 9) else (*BRIDGES, CONTROLS)))
        if step == 7 + RECORDER_WINDOW // 2:
            assert max(bag.confirmed) < 7
    assert max(bag.confirmed) > 9
    assert bag.buffer.gaps == f"{CONTROLS} lacks 2 steps (7, 9)"
    bag.show(9, CONTROLS)  # later than anybody waits
    assert bag.buffer.gaps == f"{CONTROLS} lacks 1 steps (7)"
    assert bag.steps_of(CONTROLS)[-1] == 9
    bag.show(9, CONTROLS)
    assert bag.steps_of(CONTROLS).count(9) == 1


def test_gaps_name_every_topic_and_the_first_steps() -> None:
    bag = Bag()
    for step in range(11):
        bag.show(step, CLOCK, AGENTS, *((STATE,) if step % 2 else ()))
    bag.buffer.end(amid_step=False)
    assert bag.buffer.gaps == f"{CONTROLS} lacks 11 steps (0, 1, 2, ...); {STATE} lacks 6 steps (0, 2, 4, ...)"


def test_answers_that_the_bridge_went_on_without_are_no_gaps() -> None:
    bag = Bag()
    for step in range(6):
        bag.show(step, *(BRIDGES if step == 3 else (*BRIDGES, CONTROLS)))
    assert bag.steps_of(AGENTS) == [0]
    bag.buffer.go_on(3)
    assert bag.steps_of(AGENTS) == [0, 1, 2, 3]
    bag.buffer.end(amid_step=False)
    assert bag.buffer.gaps == ""


def test_what_the_bridge_itself_publishes_is_a_gap_even_where_it_went_on() -> None:
    bag = Bag()
    bag.show(0, CLOCK, AGENTS)
    bag.buffer.go_on(0)
    bag.buffer.end(amid_step=False)
    assert bag.buffer.gaps == f"{STATE} lacks 1 steps (0)"


@pytest.mark.parametrize(("amid", "gaps"), [(True, ""), (False, f"{CONTROLS} lacks 1 steps (5)")])
def test_a_run_that_fails_amid_a_step_does_not_lack_the_answers_to_it(amid: bool, gaps: str) -> None:
    bag = Bag()
    for step in range(5):
        bag.show(step)
    bag.show(5, *BRIDGES)
    bag.buffer.end(amid_step=amid)
    assert bag.steps_of(AGENTS) == list(range(6))
    assert bag.buffer.gaps == gaps


@pytest.mark.parametrize(
    ("stamp", "kept"),
    [
        (10, 10),
        (10 + AHEAD, 10 + AHEAD),
        (11 + AHEAD, 10),  # of another clock
        (10**9, 10),
        (-5, 0),
        (10 - RECORDER_WINDOW - 1, 10),
    ],
)
def test_foreign_messages_lie_at_their_stamp_or_now(stamp: int, kept: int) -> None:
    bag = Bag()
    for step in range(11):
        bag.show(step)
    bag.buffer.take(TWIST, stamp, b"x")
    bag.buffer.end(amid_step=True)
    assert bag.steps_of(TWIST) == [kept]


def test_foreign_messages_before_and_after_the_run_are_kept_at_its_ends() -> None:
    bag = Bag(last=5)
    bag.buffer.take(NEWS, 10**9, b"before")
    for step in range(6):
        bag.show(step)
    bag.buffer.take(NEWS, 9, b"after")
    bag.buffer.end(amid_step=False)
    assert [(step, data) for step, name, data in bag.written if name == NEWS] == [(0, b"before"), (5, b"after")]


def test_foreign_messages_are_bounded() -> None:
    bag = Bag()
    for number in range(10 * KEPT):
        bag.buffer.take(NEWS, 0, b"%d" % number)
    bag.buffer.end(amid_step=True)
    assert len(bag.written) == KEPT


def test_steps_beyond_the_run_are_dropped() -> None:
    bag = Bag()
    bag.show(0)
    bag.buffer.take(TIMING, LAST + 1, b"x")
    bag.buffer.take(AGENTS, 10**6, b"x")
    bag.buffer.end(amid_step=False)
    assert {step for step, *_ in bag.written} == {0}
    assert bag.buffer.newest == LAST


def test_step_0_waits_until_an_external_ego_is_heard() -> None:
    bag = Bag((*BRIDGES, APPLIED))
    bag.show(0, *BRIDGES, APPLIED)
    assert bag.confirmed == []
    bag.show(0, TWIST)
    assert bag.confirmed == [0]


def test_step_0_does_not_wait_for_ever_for_an_ego_that_the_recorder_does_not_hear() -> None:
    bag = Bag((*BRIDGES, APPLIED))
    for _ in range(REPEATS_MAX):
        bag.show(0, *BRIDGES, APPLIED)
    assert bag.confirmed == []
    bag.show(0, AGENTS)
    assert set(bag.confirmed) == {0}


@pytest.mark.parametrize("already", [False, True])
def test_an_earlier_end_is_confirmed_whenever_it_is_announced(already: bool) -> None:
    bag = Bag()
    for step in range(13):
        bag.show(step)
    if not already:
        bag.buffer.end_at(13)
    bag.show(13)
    if already:
        assert bag.confirmed[-1] < 13
        bag.buffer.end_at(13)
    assert bag.confirmed[-1] == 13
    bag.show(14)
    bag.buffer.end(amid_step=False)
    assert bag.steps_of(AGENTS) == list(range(14)), "nothing comes after the last step"
    assert bag.buffer.gaps == ""


@pytest.mark.parametrize("topic", [*BRIDGES, CONTROLS, EGO, APPLIED])
@pytest.mark.parametrize("steps_later", [0, LAG + 2])
def test_a_second_answer_to_a_step_that_differs_is_kept_and_named(topic: str, steps_later: int) -> None:
    """A stage repeats its own answer when the bridge asks again; a different one is somebody else's."""
    per_step = (*BRIDGES, CONTROLS, EGO if topic != APPLIED else APPLIED)
    bag = Bag(per_step)
    for step in range(LAST + 1):
        bag.show(step, *per_step, TWIST)
        bag.show(step, topic)
        if step == 7 + steps_later:
            bag.buffer.take(topic, 7, b"of an intruder")
    bag.buffer.end(amid_step=False)
    assert bag.steps_of(topic).count(7) == 2
    assert len(bag.steps_of(topic)) == LAST + 2
    assert bag.buffer.gaps == f"{topic} has two different messages for step 7, so somebody else publishes there"
