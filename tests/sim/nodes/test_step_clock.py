"""Simulation time between steps: without gaps, never back, never past the next step."""

from itertools import pairwise
from math import inf

import pytest

from litsim_sim.core.scene import STEP_NS
from litsim_sim.nodes.step_clock import COARSE_NS, TICK_NS, StepClock


def clock(*, is_heard: bool = True, factor: float = 1.0) -> tuple[StepClock, list[int]]:
    times: list[int] = []
    return StepClock(times.append, lambda: is_heard, factor), times


def test_without_listeners_there_are_the_times_of_the_steps() -> None:
    made, times = clock(is_heard=False)
    for step in range(3):
        made.step(step, 0.1 * step)
        assert made.tick(0.1 * step + 0.05) == inf
    assert times == [0, STEP_NS, 2 * STEP_NS]


def test_a_step_that_waits_has_ticks_up_to_the_next_step() -> None:
    made, times = clock()
    made.step(0, 0.0)
    made.step(1, 6.0)
    del times[:]
    assert made.tick(6.0) == pytest.approx(0.01)
    for milliseconds in range(0, 300, 5):
        made.tick(6.0 + 1e-3 * milliseconds)
    assert times == list(range(STEP_NS + TICK_NS, 2 * STEP_NS + 1, TICK_NS))
    assert made.tick(7.0) == inf


def test_the_time_left_at_the_end_of_a_step_has_ticks_too() -> None:
    made, times = clock()
    for step in range(3):
        made.step(step, float(step))
    made.tick(2.045)
    made.step(3, 2.05)
    assert max(b - a for a, b in pairwise(times)) == COARSE_NS
    assert times == sorted(times)
    assert set(range(0, 4 * STEP_NS, STEP_NS)) <= set(times)


def test_the_time_of_a_step_that_is_answered_passes_before_the_next() -> None:
    made, times = clock()
    made.step(0, 0.0)
    made.step(1, 1.0)
    made.tick(1.015)
    made.finish()
    del times[:]
    made.step(2, 1.1)
    assert times == [2 * STEP_NS]  # the rest was published before


def test_time_passes_faster_by_a_factor() -> None:
    made, times = clock(factor=4.0)
    made.step(0, 0.0)
    made.step(1, 0.0)
    assert made.tick(0.01) == pytest.approx(0.0025)
    assert times[-1] == STEP_NS + 4 * TICK_NS


def test_step_0_creeps_to_step_1_and_is_repeated_where_it_is() -> None:
    made, times = clock()
    made.step(0, 0.0)
    for _ in range(20):
        made.creep()
        made.repeat()
    assert times == sorted(times)
    assert times[-1] == STEP_NS
    assert set(times) == set(range(0, STEP_NS + 1, TICK_NS))
