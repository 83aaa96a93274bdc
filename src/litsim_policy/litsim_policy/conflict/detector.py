"""Conflict detection: which pairs of agents are compared, and which of them are predicted to overlap."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import chain
from operator import attrgetter

import numpy as np

from litsim_policy.conflict.broad_phase import may_overlap
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.futures import Futures
from litsim_policy.conflict.overlap import closing_overlaps, mixture_overlap_probability, quantile
from litsim_policy.conflict.predicted_motion import PredictedMotion
from litsim_sim.core.pair_geometry import behind_scene
from litsim_sim.core.scene import STEP_S, AgentArrays, BoolArray, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverReason
from litsim_sim.kernels.compiled import Bools, Ints2, kernel
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.log_overlaps import LogOverlaps

FOLLOWED = 0.8  # of the distance at which boxes in line touch: closer pairs do not follow each other


@dataclass(frozen=True)
class Conflict:
    """Predicted overlap of an agent on its log with another that is off its log.

    Attributes:
        agent: on its log.
        opponent: off its log, or the ego.
        time_to_conflict: [s] until the probability first reaches the threshold.
        pose: (3,) x, y, yaw of the agent then: the crossing point.
        overlap_probability: the largest within the horizon.
        urgent: whether both close fast; see `ConflictConfig.closing_time`.
        reason: CONFLICT for a predicted overlap, UNLIKELY for a log that a person would not follow behind the opponent.
    """

    agent: int
    opponent: int
    time_to_conflict: float
    pose: FloatArray
    overlap_probability: float
    urgent: bool = False
    reason: TakeoverReason = TakeoverReason.CONFLICT


def soonest(*conflicts: list[Conflict]) -> list[Conflict]:
    """Returns the first conflict of each agent in these lists, in the order of time."""
    first: dict[int, Conflict] = {}
    for conflict in sorted(chain(*conflicts), key=attrgetter("time_to_conflict")):
        first.setdefault(conflict.agent, conflict)
    return list(first.values())


class ConflictDetector:
    """Compares where the logs of agents lead with where agents off their logs are expected.

    Only agents in the region of interest of an agent off its log are compared. If two background agents overlap in the
    log itself, and the one off its log is at its logged position then, the overlap is exempt.

    Masks of agents are (n,), of all agents of a step; pairs (m, 2) are rows of the agents that its futures cover.

    Attributes:
        log, config: as given; those of the futures that are compared.
    """

    def __init__(self, log: Log, roi_m: float, config: ConflictConfig, log_overlaps: LogOverlaps | None = None) -> None:
        self.log, self.config, self._roi_m = log, config, roi_m
        self._log_overlaps = log_overlaps or LogOverlaps(log)

    def conflicts(self, futures: Futures, on_log: BoolArray, diverged: BoolArray) -> list[Conflict]:
        """Returns conflicts of agents `on_log` with agents `diverged` (masks), soonest first, one for each agent.

        An agent is not in conflict with one that merely follows it: the follower could have kept its distance, and the
        leader cannot prevent the collision by yielding.
        """
        threshold = self.config.probability_threshold
        pairs = self._within_reach(futures, self._pairs(futures, on_log, diverged, diverged), threshold)
        pairs = pairs[~followed(pairs, futures.covered.arrays)]
        if not len(pairs):
            return []
        probability = self._overlap_probability(futures, pairs, threshold)
        closing = self._closing(futures, pairs)
        np.maximum(probability, closing, out=probability)
        self._exempt(probability, futures, pairs, futures.expected)
        return self._first_of_each(futures, pairs, probability, closing)

    def conflicts_of_lagged(
        self, futures: Futures, diverged: BoolArray, lagged: BoolArray, barred: BoolArray
    ) -> tuple[list[Conflict], list[Conflict]]:
        """Returns conflicts of agents on `lagged` logs with those ahead, and with pedestrians and cyclists, on theirs.

        A log that lags does not know who is ahead by now, such as a vehicle that changes lane in front of the agent.
        Agents `diverged` have no such conflicts, and those `barred` none with agents ahead (masks).
        """
        walking = futures.table.obstacle
        mine = lagged & ~diverged & ~walking
        leaders = self._conflicts_with_leaders(futures, mine & ~barred, ~diverged & ~lagged)
        return leaders, self.conflicts(futures, mine, walking) if walking.any() else []

    def _conflicts_with_leaders(self, futures: Futures, lagged: BoolArray, ahead: BoolArray) -> list[Conflict]:
        """Conflicts of agents on `lagged` logs with agents `ahead` (masks) that they follow, as in :meth:`conflicts`.

        Both are expected where their logs lead, lags included.
        """
        pairs = self._pairs(futures, lagged, ahead, lagged, expected=False)
        pairs = pairs[followed(pairs[:, ::-1].copy(), futures.covered.arrays)]
        if not len(pairs):
            return []
        least = self.config.probability_threshold
        probability = mixture_overlap_probability(pairs, futures.by_log, futures.by_log, futures.sizes, least)
        self._exempt(probability, futures, pairs, futures.by_log)
        return self._first_of_each(futures, pairs, probability, np.zeros(probability.shape))

    def pairs(self, futures: Futures, agents: BoolArray, diverged: BoolArray) -> IntArray:
        """Returns the pairs (m, 2) of `agents` with agents `diverged` (masks) in the region of each other."""
        return self._pairs(futures, agents, diverged, agents)

    def drive_into_conflict(self, futures: Futures, pairs: IntArray) -> BoolArray:
        """Returns the mask (n,) of the first of `pairs`, also off their logs, whose own ways lead into a conflict.

        As in :meth:`conflicts`, they are in none with those that merely follow them.
        """
        in_conflict, least = np.zeros(len(futures.table), np.bool_), self.config.probability_clear
        if len(pairs):
            own = futures.expected  # of agents under control, the motion along their paths alone counts
            pairs = pairs[may_overlap(pairs, own, own, futures.boxes, max(0.0, -quantile(least)))]
            pairs = pairs[~followed(pairs, futures.covered.arrays)]
            probability = mixture_overlap_probability(pairs, own, own, futures.sizes, least, first=True)
            in_conflict[futures.rows[pairs[probability.any(axis=1), 0]]] = True
        return in_conflict

    def still_in_conflict(self, futures: Futures, pairs: IntArray) -> BoolArray:
        """Returns the mask (n,) of the first of `pairs` whose logs lead into a conflict with the second."""
        least = self.config.probability_clear
        pairs = self._within_reach(futures, pairs, least)
        in_conflict = np.zeros(len(futures.table), np.bool_)
        if not len(pairs):
            return in_conflict
        hit = np.zeros((2, len(futures.covered)), np.bool_)  # by a pair in no overlap in the log, by one that is
        for probability_of in (self._closing, partial(self._overlap_probability, least=least)):
            others = pairs[~(hit[0] | hit[1])[pairs[:, 0]]]
            if len(others):
                one_of_each = others[probability_of(futures, others, first=True).any(axis=1)]
                hit[self._overlap_in_log(futures, one_of_each).astype(np.int64), one_of_each[:, 0]] = True
        in_conflict[futures.rows[hit[0]]] = True
        again = pairs[hit[1][pairs[:, 0]]]  # that pair may be exempt, and another one not
        if len(again):
            probability = self._overlap_probability(futures, again, least)
            np.maximum(probability, self._closing(futures, again), out=probability)
            self._exempt(probability, futures, again, futures.expected)
            in_conflict[futures.rows[again[probability.any(axis=1), 0]]] = True
        return in_conflict

    def pair_probabilities(
        self, futures: Futures, on_log: BoolArray, diverged: BoolArray, least: float
    ) -> tuple[IntArray, FloatArray]:
        """Returns the pairs that are compared, and the probability (m, T) that each overlaps; nothing is exempt.

        Returns:
            pairs (m, 2), the first `on_log`, the second `diverged` (masks), and their probabilities; 0 where these do
            not reach `least`.
        """
        pairs = self._pairs(futures, on_log, diverged, diverged)
        return pairs, self._overlap_probability(futures, pairs, least)

    def _pairs(
        self, futures: Futures, of: BoolArray, others: BoolArray, centres: BoolArray, *, expected: bool = True
    ) -> IntArray:
        """Returns pairs of agents in the region of each other, the first of the mask `of`, the second of `others`.

        Their futures are made, and those of all agents in the mask `centres`; those of `others` where they are expected
        only if `expected`.
        """
        pairs = pairs_in_region(futures.table.arrays, of, others, self._roi_m, self.config.approach_time)
        covered = centres.copy()
        covered[pairs] = True
        futures.cover(covered, others if expected else np.zeros_like(others))
        return futures.place[pairs]

    def _within_reach(self, futures: Futures, pairs: IntArray, least: float) -> IntArray:
        """Returns the `pairs` that can overlap, with a probability of at least `least` or closing fast."""
        if not len(pairs):
            return pairs
        tail = max(0.0, -quantile(least))
        return pairs[may_overlap(pairs, futures.by_log, futures.expected, futures.boxes, tail)]

    def _overlap_probability(
        self, futures: Futures, pairs: IntArray, least: float, *, first: bool = False
    ) -> FloatArray:
        """Returns the probability (m, T) that the first of each pair, by its log, overlaps the expected second.

        Probabilities that do not reach `least` are 0; `first` as in :func:`.overlap.mixture_overlap_probability`.
        """
        return mixture_overlap_probability(pairs, futures.by_log, futures.expected, futures.sizes, least, first=first)

    def _closing(self, futures: Futures, pairs: IntArray, *, first: bool = False) -> FloatArray:
        """Returns an array (m, T): 1 where the first of each pair, by its log, hits the second, which continues.

        `first` as in :func:`.overlap.mixture_overlap_probability`.
        """
        motions = futures.by_log.states, futures.by_log.valid
        return closing_overlaps(pairs, motions, futures.boxes, first)

    def _exempt(self, probability: FloatArray, futures: Futures, pairs: IntArray, opponents: PredictedMotion) -> None:
        """Set probabilities (m, T) to 0, in place, where the log has the overlap of `pairs` as well.

        `opponents` are the motions of the second of each pair.
        """
        some = np.flatnonzero(probability.any(axis=1))
        for k in some[self._overlap_in_log(futures, pairs[some])]:
            i, j = pairs[k].tolist()
            now = futures.table.step + 1 + np.arange(probability.shape[1]) - futures.lag[i]
            a, b = futures.log_rows[pairs[k]].tolist()
            probability[k, self._log_overlaps.exempt(a, b, now, opponents.x[j], opponents.y[j])] = 0.0

    def _overlap_in_log(self, futures: Futures, pairs: IntArray) -> BoolArray:
        """Returns the mask (m,) of `pairs` that overlap at some step of the log, but not with the ego."""
        overlap: BoolArray = np.asarray(~futures.covered.of_ego[pairs].any(axis=1))
        overlap[overlap] = self._log_overlaps.any(futures.log_rows[pairs[overlap]])
        return overlap

    def _first_of_each(
        self, futures: Futures, pairs: IntArray, probability: FloatArray, closing: FloatArray
    ) -> list[Conflict]:
        """Returns the first conflict of each agent of `pairs`, by their `probability` (m, T), soonest first.

        Those for which `closing` (m, T) is 1 somewhere are urgent.
        """
        table, by_log = futures.covered, futures.by_log
        reached = probability >= self.config.probability_threshold
        hit: BoolArray = np.asarray(reached.any(axis=1))
        if not hit.any():
            return []
        first = np.argmax(reached, axis=1)
        conflicts: dict[int, Conflict] = {}
        order = np.lexsort((table.id[pairs[:, 1]], table.id[pairs[:, 0]], first))
        for k in order[hit[order]]:
            row, opponent, instant = int(pairs[k, 0]), int(pairs[k, 1]), int(first[k])
            agent = int(table.id[row])
            if agent not in conflicts:
                pose = np.array([by_log.x[row, instant], by_log.y[row, instant], by_log.yaw[row, instant]])
                largest = float(probability[k].max())
                urgent = bool((closing[k] * probability[k]).any())
                time = (instant + 1) * STEP_S
                conflicts[agent] = Conflict(agent, int(table.id[opponent]), time, pose, largest, urgent)
        return list(conflicts.values())


@kernel
def in_region(dx: float, dy: float, faster_x: float, faster_y: float, radius: float, time: float) -> bool:
    """Whether an agent is within `radius` [m], or will be within `time` [s] at its present rate of approach.

    Its position [m] and velocity [m/s] are relative to the observer.
    """
    square = dx * dx + dy * dy
    if square <= radius * radius:
        return True
    nearer = -(dx * faster_x + dy * faster_y) * time  # both sides of the comparison are multiplied by the distance
    return square - math.sqrt(square) * radius <= nearer


@kernel
def pairs_in_region(agents: AgentArrays, of: Bools, others: Bools, radius: float, time: float) -> Ints2:
    """Return pairs (m, 2) of positions in one scene, first of the mask `of` (n,), second of `others`.

    They are :func:`in_region` of each other; `radius` [m] and `time` [s] are those of the region.
    """
    x, y = agents.x, agents.y
    count, pairs = 0, np.empty((of.sum() * others.sum(), 2), np.int64)
    seconds, begin, behind, end = others.nonzero()[0], 0, 0, 0
    vx, vy = agents.speed * np.cos(agents.yaw), agents.speed * np.sin(agents.yaw)
    for i in range(len(x)):
        if i == end:
            end = behind_scene(agents.scene, i)
            begin, behind = behind, int(np.searchsorted(seconds, end))
        if of[i]:
            for j in seconds[begin:behind]:
                if i != j and in_region(x[j] - x[i], y[j] - y[i], vx[j] - vx[i], vy[j] - vy[i], radius, time):
                    pairs[count, 0], pairs[count, 1] = i, j
                    count += 1
    return pairs[:count].copy()


@kernel
def followed(pairs: Ints2, agents: AgentArrays) -> Bools:
    """Return for each of `pairs` (m, 2) whether the second follows the first.

    The first is ahead in the strip that the second sweeps straight on, with headings within a quarter turn: an oncoming
    agent is not a leader.
    """
    yaw, length, width = agents.yaw, agents.length, agents.width
    follows = np.empty(len(pairs), np.bool_)
    for k in range(len(pairs)):
        leader, follower = pairs[k, 0], pairs[k, 1]
        dx, dy = agents.x[leader] - agents.x[follower], agents.y[leader] - agents.y[follower]
        cos, sin = math.cos(yaw[follower]), math.sin(yaw[follower])
        ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
        clear = 0.5 * (length[leader] + length[follower])
        beside = 0.5 * (width[leader] + width[follower])
        same_way = math.cos(yaw[leader] - yaw[follower]) > 0.0
        follows[k] = same_way and ahead > FOLLOWED * clear and abs(left) < beside
    return follows
