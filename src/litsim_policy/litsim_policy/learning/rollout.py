"""Episodes driven by a policy, for training and for validation: what every agent went through, and what happened."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, islice, pairwise
from typing import Protocol

import numpy as np
import torch
from gymnasium.utils import seeding

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.episodes import Course, Episodes
from litsim_policy.learning.network import GaussianPolicy, Sampler
from litsim_policy.learning.ppo import Track
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.joined import BITS, kind

EMPTY_EPISODES_MAX = 100  # episodes in a row without anybody to drive, after which there is no point in going on
TOGETHER = 48  # episodes that are stepped together at most
AT_FIRST = 12  # episodes that are driven where nobody knows how many are worth it
COUNTED = ("collision", "off_road", "edge", "proximity", "hard_brake", "guard")  # of penalties, what is summed up
VALIDATION_SEED = 10_000_019  # of the first episode of every validation


@dataclass(frozen=True)
class Episode:
    """What came of an episode.

    Attributes:
        tracks: one for every stretch that an agent was driven; empty where nobody was.
        sums: totals of what happened, by name.
    """

    tracks: list[Track]
    sums: Mapping[str, float]


class Driving(Protocol):
    """Drives episodes, in this process or in others; what comes of an episode is the same."""

    def episodes(
        self, policy: GaussianPolicy, seeds: Iterable[int], enough: float, *, draws: bool
    ) -> Iterator[Episode]:
        """The episodes of `seeds`, in this order, until they are over or nobody asks for the next one.

        Other processes begin with them at once, this one when it is asked for the first.

        Args:
            policy: which drives every agent in a slot; it must not change until the last of them.
            seeds: of the episodes.
            enough: agent-steps with which nobody will ask for the next one.
            draws: whether actions are drawn; otherwise they are the policy's means.
        """


@dataclass
class Foresight:
    """Guesses how many episodes are worth driving at once: those that nobody asks for in the end are driven in vain.

    Attributes:
        driven, squares: sums over episodes of their agent-steps, and of the squares of these.
        done: episodes so far.
    """

    driven: float = 0.0
    squares: float = 0.0
    done: int = 0

    def portion(self, missing: float, processes: int) -> int:
        """How many episodes to drive next, one at least.

        Mostly they are enough: their mean less one standard deviation is. An episode more beside others costs little;
        one that has to be driven on its own afterwards costs nearly as much as all of them.

        Args:
            missing: agent-steps that are still asked for.
            processes: that drive them.
        """
        most = TOGETHER * processes
        if not np.isfinite(missing):
            return most
        if not self.done:
            return AT_FIRST
        mean = max(self.driven / self.done, 1.0)
        spread = max(self.squares / self.done - mean**2, 0.0) ** 0.5
        expected = max(missing, 0.0) / mean
        return min(max(int(np.ceil(expected + spread / mean * expected**0.5)), 1), most)

    def note(self, episode: Episode) -> None:
        """Learn from an episode."""
        steps = episode.sums.get("transitions", 0.0)
        self.driven, self.squares, self.done = self.driven + steps, self.squares + steps**2, self.done + 1


class HereDriving:
    """Drives in this process."""

    def __init__(self, course: Course) -> None:
        self._course, self._foresight = course, Foresight()

    def episodes(
        self, policy: GaussianPolicy, seeds: Iterable[int], enough: float, *, draws: bool
    ) -> Iterator[Episode]:
        """See :class:`Driving`."""
        coming, missing = iter(seeds), enough
        while portion := list(islice(coming, self._foresight.portion(missing, 1))):
            for episode in drive(self._course, policy, portion, draws=draws):
                self._foresight.note(episode)
                missing -= episode.sums.get("transitions", 0.0)
                yield episode


def begin(driving: Driving, policy: GaussianPolicy, config: TrainConfig, iteration: int) -> Iterator[Episode]:
    """Begin to drive the episodes of an iteration, for :func:`collect`."""
    seeds = (_episode_seed(config.seed, iteration, episode) for episode in count())
    return driving.episodes(policy, seeds, config.transitions, draws=True)


def collect(episodes: Iterator[Episode], config: TrainConfig) -> tuple[list[Track], dict[str, float]]:
    """Take from `episodes` until they have `config.transitions` agent-steps.

    Returns:
        the tracks of all agents, and the rates of what happened by name (see :func:`_rates`).

    Raises:
        InputError: in none of many episodes in a row was anybody driven.
    """
    tracks: list[Track] = []
    sums: dict[str, float] = defaultdict(float)
    number = empty = 0
    for episode in episodes:
        tracks += episode.tracks
        _add(sums, episode.sums)
        number += 1
        empty = 0 if episode.tracks else empty + 1
        if sums["transitions"] >= config.transitions:
            break
        if empty == EMPTY_EPISODES_MAX:
            raise InputError(
                f"training: nobody is driven in {empty} episodes in a row, expected scenarios with vehicles within "
                f"environment.draft_radius ({config.environment.draft_radius} m) of the ego, or in conflict with it"
            )
    return tracks, _rates(sums, number)


def drive(course: Course, policy: GaussianPolicy, seeds: Sequence[int], *, draws: bool) -> list[Episode]:
    """Drive the episodes of `seeds`; `policy` draws its actions, or drives by their means.

    Those on scenarios of one kind are stepped together; each comes to the same as alone.
    """
    found: dict[int, Episode] = {}
    sampler = Sampler.of(policy)
    for group in by_kind(course, seeds):
        starts = [course.start(seeding.np_random(seeds[number])[0]) for number in group]
        generators = [torch.Generator().manual_seed(seeds[number]) for number in group] if draws else None
        found |= dict(zip(group, _drive_together(Episodes(course, starts), sampler, generators), strict=True))
    return [found[number] for number in range(len(seeds))]


def by_kind(course: Course, seeds: Sequence[int]) -> list[list[int]]:
    """The positions in `seeds` of the episodes that can be stepped together, those of each kind of scenario."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, seed in enumerate(seeds):
        groups[kind(course.scenario(seeding.np_random(seed)[0]))].append(number)
    return list(groups.values())


def _drive_together(
    episodes: Episodes, sampler: Sampler, generators: Sequence[torch.Generator] | None
) -> list[Episode]:
    """What comes of `episodes`, whose actions are drawn by a generator each; None is by their means."""
    count = len(episodes.running)
    sums: list[dict[str, float]] = [defaultdict(float) for _ in range(count)]
    tracks: list[list[Track]] = [[] for _ in range(count)]
    collided = np.zeros(count, np.bool_)
    open_tracks: dict[int, list[tuple[np.ndarray, ...]]] = defaultdict(list)
    while episodes.running.any():
        before, scene = episodes.seen.copy(), episodes.driven >> BITS
        raw, density = sampler.sample(before, None if generators is None else _noise(scene, generators))
        outcome = episodes.step(np.tanh(raw), sampler.network.mean(before))
        for k, agent in enumerate(outcome.agents.tolist()):
            step = (before[k], raw[k], density[k], outcome.executed[k], outcome.penalty[k], outcome.corrected[k])
            open_tracks[agent].append(step)
            if not outcome.driven_on[k]:
                ended = bool(outcome.terminated[k])
                tracks[scene[k]].append(_track(open_tracks.pop(agent), outcome.following[k], terminated=ended))
        counted = np.array([getattr(outcome.terms, name) for name in COUNTED], np.float64)
        there = _scenes(outcome.present >> BITS, count)
        for number, (begin, end) in enumerate(_scenes(scene, count)):
            if end > begin:
                own, present = sums[number], slice(*there[number])
                own["transitions"] += end - begin
                own["penalty"] += float(outcome.penalty[begin:end].sum())
                for name, total in zip(COUNTED, counted[:, present].sum(axis=1).tolist(), strict=True):
                    own[name] += total
                collided[number] |= outcome.terms.collision[present].any()
    for own, has_collided in zip(sums, collided.tolist(), strict=True):
        own["collided_episodes"] += float(has_collided)
    return [Episode(of_one, dict(own)) for of_one, own in zip(tracks, sums, strict=True)]


def _scenes(scene: IntArray, count: int) -> list[tuple[int, int]]:
    """The first row and the one behind the last of each of `count` scenes among agents of scenes (m,), which ascend."""
    return list(pairwise(scene.searchsorted(np.arange(count + 1)).tolist()))


def _noise(scene: IntArray, generators: Sequence[torch.Generator]) -> FloatArray:
    """Standard normal numbers (m, 3) for agents of scenes (m,), which ascend, drawn by the generator of each scene."""
    counts = np.bincount(scene, minlength=len(generators)).tolist()
    drawn = [torch.randn((n, 3), generator=generators[k]) for k, n in enumerate(counts) if n]
    return torch.cat(drawn).double().numpy() if drawn else np.empty((0, 3))


def validate(policy: GaussianPolicy, driving: Driving, config: TrainConfig) -> dict[str, float]:
    """Drive episodes that are the same each time by the means of the policy.

    Returns:
        rates by name, and `validation_score`: the mean penalty of an agent-step, at most 0.

    Raises:
        InputError: nobody is driven in any of them, so that there is nothing to score.
    """
    sums: dict[str, float] = defaultdict(float)
    seeds = range(VALIDATION_SEED, VALIDATION_SEED + config.validation_episodes)
    for episode in driving.episodes(policy, seeds, np.inf, draws=False):
        _add(sums, episode.sums)
    if not sums["transitions"]:
        raise InputError(
            f"training: nobody is driven in the {config.validation_episodes} episodes of validation, expected "
            "scenarios with vehicles near the ego or in conflict with it, or a larger validation_episodes"
        )
    rates = _rates(sums, config.validation_episodes)
    wanted = ("penalty", "collisions", "off_road", "hard_brake", "guard", "collided_share")
    found = {f"validation_{name}": rates[name] for name in wanted}
    return found | {"validation_score": rates["penalty"]}


def _episode_seed(seed: int, iteration: int, episode: int) -> int:
    return int(np.random.SeedSequence([seed, iteration, episode]).generate_state(1)[0])


def _add(sums: dict[str, float], others: Mapping[str, float]) -> None:
    for name, value in others.items():
        sums[name] += value


def _rates(sums: dict[str, float], episodes: int) -> dict[str, float]:
    """Rates by name from the totals of `episodes`.

    penalty, edge, proximity, hard_brake and guard are means over agent-steps; collisions and off_road are events per
    1000 agent-steps; collided_share is the share of episodes in which some driven agent collided.
    """
    count = max(sums["transitions"], 1.0)
    return {
        "transitions": sums["transitions"],
        "episodes": float(episodes),
        "penalty": sums["penalty"] / count,
        "collisions": 1000.0 * sums["collision"] / count,
        "collided_share": sums["collided_episodes"] / episodes,
        "off_road": 1000.0 * sums["off_road"] / count,
        "edge": sums["edge"] / count,
        "proximity": sums["proximity"] / count,
        "hard_brake": sums["hard_brake"] / count,
        "guard": sums["guard"] / count,
    }


def _track(steps: list[tuple[np.ndarray, ...]], following: np.ndarray, *, terminated: bool) -> Track:
    """The track of one agent, from its steps as :func:`drive` notes them and the observation (size,) after the last."""
    observation, raw, density, executed, penalty, corrected = (np.array(column) for column in zip(*steps, strict=True))
    seen = np.concatenate([observation, following[None]])
    return Track(seen, raw, density, executed, penalty, terminated, corrected)
