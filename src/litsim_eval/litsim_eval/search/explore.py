"""The search in one scenario: an optimiser proposes changes, failures that count are shrunk and grouped.

It is a generator of batches of proposals, which is sent what became of them: whoever runs it decides where and how many
at a time, and a search that was interrupted is repeated with the same answers.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Collection, Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from litsim_eval.search.judging import Outcome
from litsim_eval.search.space import DISTANCE_MAX, NOTHING, Proposal, Space
from litsim_sim.core.scene import STEP_S

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler

BATCH = 8
"""Proposals at a time; the optimiser learns of their outcomes together."""
GROUPS_MAX = 10
"""Most groups of failures that are shrunk and shown."""
SHARE_SHRINKING, SHARE_DRAWN = 0.3, 0.2
"""Shares of the budget: the last, in which shrinking comes first, and that of plain draws from the declared
distribution, which give the rate."""
SHARE_AT_ONCE = 0.4
"""Share of the runs so far up to which failures are shrunk as soon as they are found."""
SHRUNK_BY = (0.5, 0.75, 0.9)
"""Factors that are tried of all distances together; of single ones, the first."""
LATER_S = 0.5  # [s] by which shrinking moves when an agent acts
LESS = 0.02  # least gain in distance for which shrinking goes on
PASSED_VALUE = 2.0 * DISTANCE_MAX
"""What the optimiser is told of a run that has not failed, more if it is far from a contact; else the distance."""
SAMPLERS = ("tpe", "random")


@dataclass(frozen=True)
class Tried:
    """A run with changes, and what became of it.

    Attributes:
        number: counted from 0, in order; 0 is the scenario as recorded.
        how: `recorded`, `screened`, `drawn`, `proposed` or `shrunk`.
        proposal: the changes.
        distance: of these from reality.
        outcome: what became of it.
        case: id of its case.
        reason: why it has not passed, in one line.
        group: what failures are grouped by, together with the act: what happened.
        near: how near to a contact it came, from 0 to 1.
        digest: of the run.
    """

    number: int
    how: str
    proposal: Proposal
    distance: float
    outcome: Outcome
    case: str
    reason: str = ""
    group: str = ""
    near: float = 0.0
    digest: str = ""

    @property
    def key(self) -> tuple[str, str]:
        """The group of a failure."""
        return self.proposal.act, self.group


Asked = list[tuple[str, Proposal]]
"""Proposals, each with how it came about."""


@dataclass
class Exploration:
    """What a search in one scenario has tried so far."""

    space: Space
    tried: list[Tried] = field(default_factory=list)

    @property
    def failures(self) -> list[Tried]:
        """The nearest failure that counts of each group, the nearest first."""
        nearest: dict[tuple[str, str], Tried] = {}
        for each in sorted(self.tried, key=lambda each: (each.distance, each.number)):
            if each.outcome == Outcome.FAILED:
                nearest.setdefault(each.key, each)
        return list(nearest.values())[:GROUPS_MAX]


def explore(
    exploration: Exploration,
    runs: int,
    sampler: str,
    seed: int,
    screened: Sequence[Proposal] = (),
    expired: Callable[[], bool] = lambda: False,
) -> Generator[Asked, Sequence[Tried], None]:
    """Yields batches of proposals, and is sent what became of each; all are kept in `exploration`.

    Args:
        exploration: begins empty.
        runs: budget, all runs together.
        sampler: one of :data:`SAMPLERS`; `random` draws all proposals uniformly within the bounds, and shrinks nothing.
        seed: of the sampler and of the draws.
        screened: what is tried first.
        expired: whether the time is over, asked before each batch.
    """
    import optuna  # takes a second to load

    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    logging.getLogger("optuna").setLevel(logging.ERROR)
    tried, space = exploration.tried, exploration.space
    tried += yield [("recorded", Proposal())]
    if tried[0].outcome != Outcome.PASSED or not space.parameters:
        return
    study = optuna.create_study(sampler=_sampler(sampler, seed))
    random = np.random.default_rng([seed, space.scenario.ego_id])
    plain = sampler == "random"
    drawn, draws = 0 if plain else round(SHARE_DRAWN * runs), 0  # how many are to be drawn, and how many are
    budget = runs if plain else round((1.0 - SHARE_SHRINKING) * runs)
    shrunk: set[int] = set()
    while len(tried) < runs and not expired():
        waiting = [] if plain else [each for each in exploration.failures if each.number not in shrunk]
        shrinking = sum(each.how == "shrunk" for each in tried)
        late = len(tried) >= budget
        limit = runs if late else budget - (drawn - draws)  # with room for what is to be drawn
        if waiting and len(tried) < limit and (late or shrinking <= SHARE_AT_ONCE * len(tried)):
            yield from _shrink(exploration, waiting[0], limit, expired, shrunk)
            continue
        size = min(BATCH, runs - len(tried))
        first, screened = screened[:size], screened[size:]
        for proposal in first:
            study.enqueue_trial(space.values_of(proposal))
        rest = size - len(first)
        due = min(rest, round(drawn * min(1.0, (len(tried) + size) / budget)) - draws)
        for _ in range(due):
            study.enqueue_trial(space.drawn(random))
        if not plain:
            for _ in range((rest - due + 1) // 2):
                study.enqueue_trial(space.drawn(random, anywhere=True))
        draws += due
        trials = [study.ask() for _ in range(size)]
        how = ["screened"] * len(first) + ["drawn"] * due + ["proposed"] * (rest - due)
        outcomes = yield [(word, space.suggested(trial)) for word, trial in zip(how, trials, strict=True)]
        tried += outcomes
        nearest = {each.number for each in exploration.failures}
        for trial, outcome in zip(trials, outcomes, strict=True):
            study.tell(trial, _value(outcome, nearest))


def promising(exploration: Exploration, count: int) -> list[Proposal]:
    """Returns up to `count` different proposals that failed, or came near to it, best first."""
    nearest = {each.number for each in exploration.failures}
    ordered = sorted(exploration.tried[1:], key=lambda each: (_value(each, nearest), each.number))
    return [each.proposal for each in ordered[:count]]


def _shrink(
    exploration: Exploration, failure: Tried, runs: int, expired: Callable[[], bool], shrunk: set[int]
) -> Generator[Asked, Sequence[Tried], None]:
    """Yields proposals that change less than a failure, then less than the nearest of these that fails, and so on.

    The numbers of the failures that need no more shrinking are added to `shrunk`.
    """
    space, tried, best = exploration.space, exploration.tried, failure
    shrunk.add(best.number)
    while len(tried) < runs and not expired():
        candidates = _smaller(space, best.proposal)[: runs - len(tried)]
        if not candidates:
            return
        outcomes = yield [("shrunk", each) for each in candidates]
        tried += outcomes
        failed = [
            each
            for each in outcomes
            if each.outcome == Outcome.FAILED and _is_smaller(space, each.proposal, best.proposal)
        ]
        if not failed:
            return
        best = min(failed, key=lambda each: (each.distance, each.number))
        shrunk.add(best.number)


def _smaller(space: Space, proposal: Proposal) -> list[Proposal]:
    """Returns proposals that change less than another: one thing less, or everything, or one thing, by less."""
    changed = [name for name in space.distances(proposal) if name in proposal.z]
    fewer = [proposal.without(name) for name in changed] if len(changed) > 1 or proposal.act == NOTHING else []
    if proposal.act != NOTHING and not any(name.startswith(proposal.act) for name in changed):
        fewer.append(Proposal(z=proposal.z))
    less = [proposal.scaled(factor) for factor in SHRUNK_BY]
    less += [proposal.scaled(SHRUNK_BY[0], name) for name in changed] if len(changed) > 1 else []
    if proposal.begin_s:  # less may do at another time
        first, last = (step * STEP_S for step in space.steps)
        for later in (-LATER_S, LATER_S):
            begin = round(min(max(proposal.begin_s + later, first), last), 1)
            less.append(replace(proposal.scaled(SHRUNK_BY[1]), begin_s=begin))
    unique = {repr((each.act, each.begin_s, sorted(each.z.items()))): each for each in (*fewer, *less)}
    return [each for each in unique.values() if _is_smaller(space, each, proposal)]


def _is_smaller(space: Space, one: Proposal, other: Proposal) -> bool:
    """Returns whether a proposal is clearly nearer to reality than another, or changes less and is no farther."""
    nearer, fewer = space.distance(other) - space.distance(one), len(space.distances(one)) < len(space.distances(other))
    return nearer > LESS or (fewer and nearer >= 0.0)


def _value(tried: Tried, nearest: Collection[int]) -> float:
    """Returns what the optimiser minimises; `nearest` are the numbers of the nearest failures of all groups.

    Another failure of a group is worth nothing: shrinking brings that nearer, and the optimiser is to find more.
    """
    if tried.outcome == Outcome.FAILED and tried.number in nearest:
        return tried.distance
    near = tried.near if tried.outcome == Outcome.PASSED else 0.0
    return PASSED_VALUE * (2.0 - near) + 0.1 * tried.distance


def _sampler(name: str, seed: int) -> BaseSampler:
    from optuna import samplers

    if name == "random":
        return samplers.RandomSampler(seed=seed)
    return samplers.TPESampler(seed=seed, n_startup_trials=2 * BATCH, multivariate=True, group=True, constant_liar=True)
