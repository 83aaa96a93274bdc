"""Choices among events."""

from hypothesis import given
from hypothesis import strategies as st

from litsim_data.mining.events import Event, EventKind
from litsim_data.mining.selection import MinedEvent, choose, hardest, spread

CUT_IN, MERGE = EventKind.CUT_IN, EventKind.MERGE


def found(ego: int, severity: float, kind: EventKind = CUT_IN, scenario: str = "a", step: int = 50) -> MinedEvent:
    return MinedEvent(scenario, Event(kind, ego, None, step, step, step, severity))


def severities(chosen: list[MinedEvent]) -> list[float]:
    return [each.event.severity for each in chosen]


def test_the_hardest_are_the_most_severe() -> None:
    assert severities(hardest([found(1, 0.2), found(2, 0.9), found(3, 0.5)], 2)) == [0.9, 0.5]


def test_a_spread_is_even_over_severity_and_not_over_what_is_frequent() -> None:
    many = [found(number, 0.1 + 0.001 * number) for number in range(50)] + [found(98, 0.5), found(99, 0.9)]
    assert severities(spread(many, 3)) == [0.9, 0.5, 0.1]


@given(st.lists(st.floats(0.0, 1.0), max_size=30), st.integers(1, 10))
def test_a_spread_takes_as_many_as_asked_once_each_with_both_ends(values: list[float], count: int) -> None:
    every = [found(number, value) for number, value in enumerate(values)]
    taken = spread(every, count)
    assert len({each.event.ego for each in taken}) == len(taken) == min(count, len(values))
    assert severities(taken)[:1] == sorted(values, reverse=True)[:1]
    if len(taken) > 1:
        assert min(severities(taken)) == min(values)


def test_an_ego_counts_once_for_a_kind_and_is_one_case() -> None:
    every = [found(1, 0.3), found(1, 0.8, step=90), found(2, 0.7), found(1, 0.4, MERGE), found(3, 0.2, MERGE)]
    cases = choose(every, {CUT_IN: 2, MERGE: 1})
    assert [(case.ego, case.kinds) for case in cases] == [(1, (MERGE, CUT_IN)), (2, (CUT_IN,))]
    first = cases[0].events
    assert [event.severity for event in first] == [0.4, 0.8, 0.3]  # why it was chosen, then the rest


def test_without_a_number_all_are_taken_and_kinds_that_are_not_asked_for_are_not() -> None:
    every = [found(1, 0.3), found(2, 0.7), found(3, 0.2, MERGE)]
    assert [case.ego for case in choose(every, {CUT_IN: None})] == [1, 2]


def test_equal_severities_are_chosen_in_their_order() -> None:
    every = [found(number, 0.5) for number in (4, 2, 9)]
    assert [each.event.ego for each in hardest(every, 2)] == [4, 2]
    assert [case.ego for case in choose(every, {CUT_IN: 2})] == [4, 2]
