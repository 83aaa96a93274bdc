"""Contacts as stretches of time, and which of them the log excuses."""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import pytest

from litsim_eval.analysis.measures.collision import Contact, Impact, collisions, contacts
from litsim_eval.analysis.metrics import compute_metrics
from litsim_sim.core.scene import AgentTable, Kind
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.record.run import Run
from made_agents import takeover
from made_runs import make_run, table

Make = Callable[..., Any]
LAST = 100


@pytest.fixture
def scene() -> Callable[..., list[AgentTable]]:
    """Agents 1 (the ego, alone unless told), 2 and 3; a pair overlaps at the steps that are given for it."""

    def make(touching: Collection[int], pair: tuple[int, int] = (2, 3)) -> list[AgentTable]:
        return [
            table(
                step,
                *(
                    {"id": agent, "x": 0.0 if agent == pair[0] else 30.0 * agent, "y": 0.0}
                    if agent != pair[1]
                    else {"id": agent, "x": 3.0 if step in touching else 15.0, "y": 0.0}
                    for agent in (1, 2, 3)
                ),
            )
            for step in range(LAST + 1)
        ]

    return make


@pytest.fixture
def run(scene: Make) -> Callable[..., Run]:
    def make(now: Collection[int], logged: Collection[int], **values: Any) -> Run:
        pair = values.pop("pair", (2, 3))
        return make_run(scene(now, pair), scene(logged, pair), **({"history_steps": 5} | values))

    return make


def test_interruptions_of_a_second_are_part_of_a_contact(scene: Make) -> None:
    steps = {10, 11, 21, 40, 51}
    assert contacts(scene(steps), 0.1) == [Contact((2, 3), 10, 21), Contact((2, 3), 40, 40), Contact((2, 3), 51, 51)]


def test_a_contact_that_the_log_has_too_is_excused(run: Make) -> None:
    found = collisions(run(range(20, 40), range(22, 30)))
    assert found.in_log == (True,)
    assert found.excess == {}
    assert found.first == {(2, 3): 20}


def test_a_later_contact_of_the_same_pair_is_not(run: Make) -> None:
    """Two vehicles overlap in the queue of the log; 4 s later one is driven into the other."""
    one = run([*range(20, 30), *range(70, 75)], range(20, 30))
    found = collisions(one)
    assert found.contacts == (Contact((2, 3), 20, 29), Contact((2, 3), 70, 74))
    assert found.in_log == (True, False)
    assert found.excess == {(2, 3): 70}
    metrics = compute_metrics(one)["collision"]
    assert (metrics["pairs"], metrics["excess"], metrics["log_floor"]) == (1, 1, 1)
    assert metrics["contacts"] == [
        {"pair": [2, 3], "step": 20, "last_step": 29, "in_log": True},
        {"pair": [2, 3], "step": 70, "last_step": 74, "in_log": False},
    ]
    assert compute_metrics(one)["reactive"] is False


@pytest.mark.parametrize(("begin", "excused"), [(40, True), (41, False), (11, True), (10, False)])
def test_a_second_before_or_after_is_about_that_time(run: Make, begin: int, excused: bool) -> None:
    assert collisions(run([begin], range(21, 31))).in_log == (excused,)


def test_a_contact_of_the_log_in_the_history_excuses_one_that_goes_on(run: Make) -> None:
    assert collisions(run(range(9), range(4))).in_log == (True,)


def test_another_pair_s_contact_in_the_log_excuses_nothing(scene: Make) -> None:
    found = collisions(make_run(scene(range(20, 30)), scene(range(20, 30), (1, 3))))
    assert found.excess == {(2, 3): 20}


def test_a_log_that_lags_has_its_contacts_later(run: Make) -> None:
    released = takeover(3, state=TakeoverState.RELEASED, detected_step=12, time_shift=3.0)
    late = run(range(60, 65), range(25, 35))
    assert collisions(late).in_log == (False,)
    assert collisions(replace(late, takeovers={20: [released]})).in_log == (True,)
    assert collisions(replace(late, takeovers={80: [released]})).in_log == (False,), "the lag comes later"


def test_the_ego_is_judged_by_the_first_contact_that_the_log_has_not(run: Make) -> None:
    one = run([*range(20, 30), *range(70, 75)], range(20, 30), pair=(1, 2))
    (contact,) = collisions(one).ego
    assert (contact.agent, contact.step, contact.verdict) == (2, 70, Impact.FRONT)
    (contact,) = collisions(run(range(20, 30), range(20, 30), pair=(1, 2))).ego
    assert contact.step == 20, "of those that the log has, the first"


def test_contacts_by_kind_and_none_among_pedestrians() -> None:
    """The ego touches a truck and somebody on a bicycle; two pedestrians walk arm in arm."""
    others = [(2, 3.0, Kind.TRUCK), (3, -3.0, Kind.BICYCLE), (8, 50.0, Kind.PEDESTRIAN), (9, 50.2, Kind.PEDESTRIAN)]
    agents = [{"id": 1, "x": 0.0, "y": 0.0}, *({"id": i, "x": x, "y": 0.0, "kind": kind} for i, x, kind in others)]
    found = compute_metrics(make_run([table(step, *agents) for step in range(3)]))["collision"]
    assert found["pairs"] == 2 and [each["pair"] for each in found["contacts"]] == [[1, 2], [1, 3]]
    counted = {kind: count for kind, count in found["by_kind"].items() if count}
    assert counted == {"car": 2, "truck": 1, "bicycle": 1}
    assert found["by_kind"].keys() == {kind.name.lower() for kind in Kind}
