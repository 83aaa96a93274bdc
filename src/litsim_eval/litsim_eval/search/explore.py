"""The search in one scenario: an optimiser proposes changes, failures that count are shrunk and grouped.

It is a generator of batches of proposals, which is sent what became of them: whoever runs it decides where and how many
at a time, and a search that was interrupted is repeated with the same answers.
"""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field, replace
from itertools import cycle, islice
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from litsim_eval.search.judging import Outcome
from litsim_eval.search.space import DISTANCE_MAX, NOTHING, SMALLEST, UNTIMED, Proposal, Space

if TYPE_CHECKING:
    from optuna.samplers import BaseSampler

BATCH = 4
"""Proposals at a time; the next ones build on what became of them."""
GROUPS_MAX = 10
"""Most groups of failures that are shrunk and shown."""
SHARE_DRAWN, DRAWN_FROM, DRAWN_TO = 0.2, 0.4, 0.8
"""Share of the budget for plain draws from the declared distribution, which give the rate, and between which shares of
the budget they are made."""
SHARE_SHRINKING = 0.3
"""Share of the budget, the last, in which shrinking comes first; before that it has half of each batch."""
SHRINK_TRIES = 10
"""Proposals nearer than a failure of which none may fail until that is taken for the nearest of its group."""
MOVED_S = 0.7  # [s] standard deviation by which shrinking moves when an agent acts
LESS = 0.02  # least gain in distance by shrinking
NEARER = (0.7, 0.98)
"""Share of the distance of what has failed within which the search goes on looking."""
NEARER_TRIES = 20
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
        group: what failures are grouped by, together with their cause: what happened.
        near: how near to a contact it came, from 0 to 1.
    """

    number: int
    how: str
    proposal: Proposal
    distance: float
    outcome: Outcome
    group: str = ""
    near: float = 0.0

    @property
    def key(self) -> tuple[str, str]:
        """The group of a failure."""
        return self.proposal.cause, self.group


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
        for run in sorted(self.tried, key=lambda run: (run.distance, run.number)):
            if run.outcome == Outcome.FAILED:
                nearest.setdefault(run.key, run)
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
        exploration: begins empty; its space may be replaced once the first run is made.
        runs: budget, all runs together.
        sampler: one of :data:`SAMPLERS`; `random` draws all proposals uniformly within the bounds, and shrinks nothing.
        seed: of the sampler and of the draws.
        screened: what is tried first.
        expired: whether the time is over, asked before each batch.
    """
    tried = exploration.tried
    tried += yield [("recorded", Proposal())]
    space = exploration.space  # by where all drove
    if tried[0].outcome != Outcome.PASSED or not space.parameters:
        return
    screened = [
        space.placed(proposal)
        for proposal in screened
        if proposal.act == NOTHING or proposal.agent in space.agents.get(proposal.act, ())
    ]
    proposer = _Proposer(exploration, runs, sampler, seed, screened)
    while len(tried) < runs and not expired():
        outcomes = yield proposer.batch(min(BATCH, runs - len(tried)))
        tried += outcomes
        proposer.tell(outcomes)


class _Proposer:
    """Proposes what to try next in an exploration.

    Args:
        screened: what is tried first.
    """

    def __init__(self, exploration: Exploration, runs: int, sampler: str, seed: int, screened: list[Proposal]) -> None:
        import optuna  # takes a second to load

        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        logging.getLogger("optuna").setLevel(logging.ERROR)
        self._exploration, self._runs, self._plain = exploration, runs, sampler == "random"
        self._optuna, self._study = optuna, optuna.create_study(sampler=_sampler(sampler, seed))
        self._random = np.random.default_rng([seed, exploration.space.scenario.ego_id])
        self._strata, self._screened = exploration.space.strata(), screened
        self._shrinkings: Counter[int] = Counter()  # by number of a failure, the proposals that are nearer than it

    def batch(self, size: int) -> Asked:
        """Returns `size` proposals."""
        if self._plain:
            return [("proposed", self._suggested()) for _ in range(size)]
        space, number = self._exploration.space, len(self._exploration.tried)
        progress = ((number + size) / self._runs - DRAWN_FROM) / (DRAWN_TO - DRAWN_FROM)
        due = round(SHARE_DRAWN * self._runs * min(1.0, max(0.0, progress)))
        due = min(size, due - sum(run.how == "drawn" for run in self._exploration.tried))
        asked: Asked = [("drawn", space.drawn(self._random)) for _ in range(due)]
        late = number >= (1.0 - SHARE_SHRINKING) * self._runs
        asked += self._shrunk(size - due if late else (size - due + 1) // 2)
        while len(asked) < size:
            if self._screened:
                asked.append(("screened", self._screened.pop(0)))
            else:
                asked.append(("proposed", self._proposed(by_optimiser=len(asked) % 2 == 1)))
        return asked

    def tell(self, outcomes: Sequence[Tried]) -> None:
        """Lets the optimiser learn."""
        for run in outcomes if not self._plain else ():
            trial = self._optuna.trial.FixedTrial(self._exploration.space.values_of(run.proposal))
            self._exploration.space.suggested(trial)
            self._study.add_trial(
                self._optuna.trial.create_trial(
                    params=trial.params, distributions=trial.distributions, value=_value(run)
                )
            )

    def _suggested(self) -> Proposal:
        """Returns a proposal of the optimiser; what is tried in its place is told later."""
        trial = self._study.ask()
        proposal = self._exploration.space.suggested(trial)
        self._study.tell(trial, state=self._optuna.trial.TrialState.FAIL)
        return proposal

    def _proposed(self, *, by_optimiser: bool) -> Proposal:
        """Returns a proposal that is nearer than what has failed by the same cause with the same agent."""
        space, random, limits = self._exploration.space, self._random, dict[tuple[str, int], float]()
        for run in self._exploration.tried:
            if run.outcome == Outcome.FAILED:
                key = run.proposal.cause, run.proposal.agent
                limits[key] = min(run.distance, limits.get(key, inf))
        for _ in range(NEARER_TRIES):
            proposal = self._suggested() if by_optimiser else space.clear(random, *next(self._strata))
            limit = random.uniform(*NEARER) * limits.get((proposal.cause, proposal.agent), inf)
            if (nearer := space.within(proposal, limit)) is not None:
                break
        return nearer or proposal

    def _shrunk(self, most: int) -> Asked:
        """Returns up to `most` proposals that are nearer than failures, of the nearest of each group in turn."""
        asked: Asked = []
        waiting = [nearest for nearest in self._exploration.failures if self._shrinkings[nearest.number] < SHRINK_TRIES]
        for failure in islice(cycle(waiting), most):
            tries = self._shrinkings[failure.number]
            self._shrinkings[failure.number] += 1
            if proposal := self._less(failure, tries):
                asked.append(("shrunk", proposal))
        return asked

    def _less(self, failure: Tried, tries: int) -> Proposal | None:
        """Returns a proposal that changes less than a failure, and fewer things; None where there is none."""
        space, random, whole = self._exploration.space, self._random, failure.proposal
        others = {name: z for name, z in whole.z.items() if name not in whole.main and abs(z) >= SMALLEST}
        if tries == 1 and others:
            return space.within(Proposal(z=others), failure.distance - LESS)
        left = {name: z for name, z in others.items() if tries and random.random() < 0.5}
        less = replace(whole, z={name: whole.z[name] for name in whole.main} | left)
        if len(left) == len(others):
            share = random.random() ** (1.0 / (1.0 + tries))  # finer the more has been tried
            less = replace(less, z={name: share * z * random.uniform(0.8, 1.0) for name, z in less.z.items()})
            if tries and whole.act not in UNTIMED:
                begin = whole.begin_s + random.normal(0.0, MOVED_S)
                less = space.placed(replace(less, begin_s=begin))
        return space.within(less, failure.distance - LESS)


def promising(exploration: Exploration, count: int) -> list[Proposal]:
    """Returns up to `count` different proposals that failed, or came near to it, best first."""
    ordered = sorted(exploration.tried[1:], key=lambda run: (_value(run), run.number))
    return [run.proposal for run in ordered[:count]]


def _value(tried: Tried) -> float:
    """Returns what the optimiser minimises: the distance, and more for a run that has not failed.

    That is less the nearer it came to a contact, so that small changes that nearly fail are worth as much as large ones
    that do.
    """
    if tried.outcome == Outcome.FAILED:
        return tried.distance
    near = tried.near if tried.outcome == Outcome.PASSED else 0.0
    return tried.distance + 1.0 + 2.0 * DISTANCE_MAX * (1.0 - near)


def _sampler(name: str, seed: int) -> BaseSampler:
    from optuna import samplers

    if name == "random":
        return samplers.RandomSampler(seed=seed)
    return samplers.TPESampler(seed=seed, n_startup_trials=10, multivariate=True, group=True)
