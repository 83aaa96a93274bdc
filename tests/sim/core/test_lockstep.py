"""The lock-step rule: what counts as an answer, and what as an old one."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.lockstep import Gate, Joiner, marks_of, step_marks

RUN = "run-1"


@pytest.fixture
def joiner() -> Joiner:
    return Joiner(RUN, ("agents", "forecasts", "takeovers"))


# Gate


def test_a_late_answer_is_the_newest_there_is_but_answers_nothing() -> None:
    gate = Gate(RUN)
    gate.open(0)
    gate.offer(RUN, 0, "zero")
    gate.open(1)
    gate.open(2)
    assert gate.newest == "zero"
    gate.offer(RUN, 1, "one")
    assert (gate.newest, gate.missing) == ("one", True)
    gate.offer(RUN, 0, "zero again")
    assert (gate.newest, gate.stale) == ("one", 2)


offers = st.tuples(st.sampled_from([RUN, RUN, RUN, "other"]), st.integers(0, 5), st.integers())


@given(st.lists(st.lists(offers, max_size=6), min_size=1, max_size=6))
def test_a_gate_holds_the_first_answer_to_its_step_and_counts_all_others(steps: list[list[Any]]) -> None:
    gate, stale = Gate(RUN), 0
    for step, given_answers in enumerate(steps):
        gate.open(step)
        expected: list[int] = []
        for run, of, answer in given_answers:
            gate.offer(run, of, answer)
            if (run, of) == (RUN, step) and not expected:
                expected = [answer]
            else:
                stale += 1
        assert gate.missing is not bool(expected)
        assert not expected or gate.newest == expected[0]
        assert gate.stale == stale


# Joiner


def test_a_repeated_input_of_an_open_step_replaces_the_first(joiner: Joiner) -> None:
    joiner.offer("agents", RUN, 0, "first")
    assert joiner.offer("agents", RUN, 0, "second") is None
    joiner.offer("forecasts", RUN, 0, "f0")
    inputs = joiner.offer("takeovers", RUN, 0, "t0")
    assert inputs is not None
    assert inputs["agents"] == "second"


def test_inputs_of_another_run_are_dropped(joiner: Joiner) -> None:
    joiner.offer("agents", RUN, 0, "a0")
    joiner.offer("forecasts", RUN, 0, "f0")
    assert joiner.offer("takeovers", "run-0", 0, "t0") is None
    assert joiner.answered == -1
    assert joiner.offer("takeovers", RUN, 0, "t0") is not None


def test_a_later_step_that_is_complete_gives_up_the_earlier_ones(joiner: Joiner) -> None:
    joiner.offer("agents", RUN, 3, "a3")
    assert [joiner.offer(name, RUN, 4, name) for name in joiner.inputs][-1] is not None
    assert joiner.answered == 4
    assert joiner.offer("forecasts", RUN, 3, "f3") is None
    assert joiner.offer("takeovers", RUN, 3, "t3") is None
    assert joiner.answered == 4


def test_a_single_input_completes_its_step_at_once() -> None:
    joiner = Joiner(RUN, ("agents",))
    assert not joiner.too_late("agents", RUN, 0)
    assert not joiner.too_late("agents", "another run", 7)
    assert joiner.too_late("agents", RUN, 7)  # it was not there at the beginning
    assert joiner.offer("agents", RUN, 0, "a0") == {"agents": "a0"}
    assert joiner.offer("agents", RUN, 0, "a0") is None
    assert joiner.offer("agents", RUN, 1, "a1") == {"agents": "a1"}


def test_asked_again_is_the_trigger_of_the_step_that_was_answered_last(joiner: Joiner) -> None:
    assert not joiner.asked_again("agents", RUN, 0)
    for step in (0, 1):
        for name in joiner.inputs:
            joiner.offer(name, RUN, step, name)
    assert joiner.asked_again("agents", RUN, 1)
    assert not joiner.asked_again("agents", RUN, 0)
    assert not joiner.asked_again("agents", RUN, 2)
    assert not joiner.asked_again("forecasts", RUN, 1)
    assert not joiner.asked_again("agents", "run-0", 1)


@given(st.data())
def test_every_step_is_given_out_once_and_in_order_however_its_inputs_are_shuffled(data: st.DataObject) -> None:
    """Messages of one topic keep their order; those of several arrive interleaved, and some of them twice."""
    joiner, names = Joiner(RUN, ("agents", "forecasts")), ("agents", "forecasts")
    queues = {name: [step for step in range(6) for _ in range(data.draw(st.integers(1, 2)))] for name in names}
    given_out = []
    while any(queues.values()):
        name = data.draw(st.sampled_from([n for n in names if queues[n]]))
        step = queues[name].pop(0)
        inputs = joiner.offer(name, RUN, step, (name, step))
        if inputs is not None:
            assert inputs == {n: (n, step) for n in names}
            given_out.append(step)
    assert given_out == list(range(6))


def test_marks_survive_to_the_microsecond() -> None:
    marks = {"begin": 12345.6789012, "answered": 12345.7}
    assert marks_of(step_marks(marks)) == pytest.approx(marks, abs=1e-6, rel=0)


@pytest.mark.parametrize("text", ["", "no marks at all", "begin= answered", "begin=soon"])
def test_words_that_are_no_marks_are_passed_over(text: str) -> None:
    assert marks_of(text) == {}
    assert marks_of(f"{text} free=1.5") == {"free": 1.5}
