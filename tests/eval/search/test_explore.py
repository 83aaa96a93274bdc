"""A search in one scenario, with made outcomes: failures are found, shrunk, grouped, and nearer than by chance."""

from collections.abc import Callable
from statistics import median

import pytest

from litsim_eval.search.explore import BATCH, Exploration, Tried, explore, promising
from litsim_eval.search.judging import Outcome
from litsim_eval.search.people import People
from litsim_eval.search.space import NOTHING, Proposal, Space

pytest.importorskip("optuna", reason="Optuna is not installed (requirements/search.txt)")

EGO, LEADER, BESIDE = 1, 2, 3
Rule = Callable[[Proposal], Outcome]


@pytest.fixture(scope="module")
def space(make_scenario, track, lane_centres) -> Space:
    tracks = (track(EGO, x=100.0), track(LEADER, x=140.0), track(BESIDE, x=125.0, y=lane_centres[2]))
    return Space.of(make_scenario(*tracks), People.load())


def searched(space: Space, rule: Rule, runs: int = 120, sampler: str = "tpe", seed: int = 0) -> Exploration:
    """Returns a finished search whose outcomes are those of `rule`."""
    exploration = Exploration(space)
    searching = explore(exploration, runs, sampler, seed)
    asked = next(searching)
    while True:
        tried = []
        for number, (how, proposal) in enumerate(asked, len(exploration.tried)):
            outcome = rule(proposal)
            group = "contact" if outcome == Outcome.FAILED else ""
            near = min(1.0, 0.1 * sum(map(abs, proposal.z.values())))
            distance = space.distance(proposal)
            tried.append(Tried(number, how, proposal, distance, outcome, group, near))
        assert len(tried) <= BATCH
        try:
            asked = searching.send(tried)
        except StopIteration:
            return exploration


def brakes_hard(proposal: Proposal) -> Outcome:
    """A weakness: fails if the leader brakes at a distance of 2 or more, early on."""
    hard = (
        proposal.act == "brake" and proposal.agent == LEADER and abs(proposal.z.get("brake.deceleration", 0.0)) >= 2.0
    )
    return Outcome.FAILED if hard and proposal.begin_s < 2.5 else Outcome.PASSED


def test_agents_that_may_act_are_those_in_the_right_place(space: Space) -> None:
    assert {act: set(agents) for act, agents in space.agents.items()} == {
        "brake": {LEADER},
        "cut_in": {BESIDE},
        "cut_out": {LEADER},
        "pace": {LEADER, BESIDE},
    }
    assert not any(each.declared for each in space.parameters.values())


def test_what_is_declared_varies_where_it_is_named(space: Space) -> None:
    named = Space.of(space.scenario, space.people, ["delay", "start.left"])
    assert set(named.parameters) == {"delay.later_s", "start.left"} and not named.agents
    proposal = Proposal(z={"delay.later_s": 2.4, "start.left": 0.01})
    (change,) = named.changes(proposal)
    assert change.model_dump() == {"kind": "delay", "later_s": 0.2}
    assert named.distance(proposal) == pytest.approx(2.0)  # of what it is rounded to


def test_finds_the_nearest_failure_and_leaves_out_what_it_does_not_need(space: Space) -> None:
    exploration = searched(space, brakes_hard)
    (failure,) = exploration.failures
    assert failure.proposal.act == "brake" and failure.proposal.agent == LEADER
    assert 2.0 <= failure.distance < 2.8
    assert set(space.distances(failure.proposal)) <= {"brake.deceleration", "brake.duration_s", "brake.occurs"}
    assert len(exploration.tried) <= 120
    assert [each.number for each in exploration.tried] == list(range(len(exploration.tried)))


def test_is_nearer_than_random_search_with_the_same_budget(space: Space) -> None:
    def nearest(sampler: str, seed: int) -> float:
        exploration = searched(space, brakes_hard, runs=80, sampler=sampler, seed=seed)
        return min((each.distance for each in exploration.tried if each.outcome == Outcome.FAILED), default=9.0)

    ours, chance = ([nearest(sampler, seed) for seed in range(5)] for sampler in ("tpe", "random"))
    assert median(ours) <= median(chance)


def test_different_failures_are_groups(space: Space) -> None:
    def two(proposal: Proposal) -> Outcome:
        off = abs(proposal.z.get("start.left", 0.0)) > 1.0 and proposal.act == NOTHING
        return Outcome.FAILED if off else brakes_hard(proposal)

    failures = searched(space, two).failures
    assert {each.proposal.act for each in failures} == {NOTHING, "brake"}
    assert [each.distance for each in failures] == sorted(each.distance for each in failures)


def test_what_is_forced_or_not_judged_is_no_failure(space: Space) -> None:
    exploration = searched(space, lambda p: Outcome.FORCED if p.act == "cut_in" else Outcome.PASSED, runs=40)
    assert not exploration.failures and len(exploration.tried) == 40
    errors = searched(space, lambda p: Outcome.ERROR if p.act == "brake" else Outcome.PASSED, runs=40)
    assert not errors.failures and len(errors.tried) == 40


def test_a_scenario_that_fails_as_recorded_is_run_once(space: Space) -> None:
    exploration = searched(space, lambda _: Outcome.FAILED)
    assert len(exploration.tried) == 1 and exploration.failures[0].distance == 0.0


def test_what_a_screen_found_is_tried_first(space: Space) -> None:
    screen = searched(space, brakes_hard, runs=60)
    best = promising(screen, BATCH)
    assert best[0] == screen.failures[0].proposal
    exploration = Exploration(space)
    searching = explore(exploration, 20, "tpe", 1, best)
    next(searching)
    asked = searching.send([Tried(0, "recorded", Proposal(), 0.0, Outcome.PASSED)])
    assert [how for how, _ in asked] == ["screened"] * BATCH
    for proposal, (_, again) in zip(best, asked, strict=True):
        assert space.changes(again) == space.changes(proposal)


def test_the_same_seed_asks_for_the_same(space: Space) -> None:
    first, again, other = (searched(space, brakes_hard, runs=40, seed=seed).tried for seed in (3, 3, 4))
    assert first == again != other


def test_time_that_is_over_ends_it(space: Space) -> None:
    exploration = Exploration(space)
    searching = explore(exploration, 100, "tpe", 0, expired=lambda: len(exploration.tried) > BATCH)
    asked = next(searching)
    asked = searching.send([Tried(0, "recorded", asked[0][1], 0.0, Outcome.PASSED)])
    with pytest.raises(StopIteration):
        searching.send([Tried(k, how, each, 1.0, Outcome.PASSED) for k, (how, each) in enumerate(asked, 1)])


def test_draws_are_of_the_declared_distribution(space: Space) -> None:
    exploration = searched(space, lambda _: Outcome.PASSED, runs=200)
    drawn = [each.proposal for each in exploration.tried if each.how == "drawn"]
    assert len(drawn) == 40
    far = [abs(z) for proposal in drawn for z in proposal.z.values()]
    assert 0.4 < median(far) < 1.0  # of a half-normal distribution 0.67
