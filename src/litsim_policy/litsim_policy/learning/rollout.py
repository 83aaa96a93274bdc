"""Episodes driven by a policy, for training and for validation: what every agent went through, and what happened."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from typing import Protocol

import numpy as np
import torch

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.environment import NOBODY, PolicyEnvironment
from litsim_policy.learning.network import GaussianPolicy
from litsim_policy.learning.ppo import Track, tensor
from litsim_sim.core.errors import InputError

EMPTY_EPISODES_MAX = 100  # episodes in a row without anybody to drive, after which there is no point in going on
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

        Args:
            policy: which drives every agent in a slot.
            seeds: of the episodes.
            enough: agent-steps with which nobody will ask for the next one.
            draws: whether actions are drawn; otherwise they are the policy's means.
        """


class HereDriving:
    """Drives in this process."""

    def __init__(self, environment: PolicyEnvironment) -> None:
        self._environment = environment

    def episodes(
        self, policy: GaussianPolicy, seeds: Iterable[int], enough: float, *, draws: bool
    ) -> Iterator[Episode]:
        """See :class:`Driving`."""
        del enough
        return (drive(self._environment, policy, seed, draws=draws) for seed in seeds)


def collect(
    driving: Driving, policy: GaussianPolicy, config: TrainConfig, iteration: int
) -> tuple[list[Track], dict[str, float]]:
    """Drive whole episodes until they have `config.transitions` agent-steps.

    Returns:
        the tracks of all agents, and the rates of what happened by name (see :func:`_rates`).

    Raises:
        InputError: in none of many episodes in a row was anybody driven.
    """
    tracks: list[Track] = []
    sums: dict[str, float] = defaultdict(float)
    number = empty = 0
    seeds = (_episode_seed(config.seed, iteration, episode) for episode in count())
    for episode in driving.episodes(policy, seeds, config.transitions, draws=True):
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


def drive(environment: PolicyEnvironment, policy: GaussianPolicy, seed: int, *, draws: bool) -> Episode:
    """Drive the episode of `seed`; `policy` draws its actions, or drives by their means."""
    generator = torch.Generator().manual_seed(seed)
    sums: dict[str, float] = defaultdict(float)
    collided = False
    tracks: list[Track] = []
    open_tracks: dict[int, list[tuple[np.ndarray, ...]]] = defaultdict(list)
    observation, info = environment.reset(seed=seed)
    over = not (info["agents"] != NOBODY).any()
    while not over:
        present = info["agents"] != NOBODY
        seen = tensor(observation[present])
        if draws:
            raw, density = policy.sample(seen, generator)
        else:
            with torch.no_grad():
                raw = policy(seen)
                density = policy.log_probability(seen, raw)
        action = np.zeros(environment.action_space.shape or ())
        action[present] = torch.tanh(raw).double().numpy()
        before = observation[present]
        observation, _, terminated, truncated, info = environment.step(action)
        outcome = info["outcome"]
        for k, agent in enumerate(outcome.agents.tolist()):
            step = (before[k], raw[k].numpy(), density[k].numpy(), outcome.executed[k], outcome.penalty[k])
            open_tracks[agent].append(step)
            if not outcome.driven_on[k]:
                ended = bool(outcome.terminated[k])
                tracks.append(_track(open_tracks.pop(agent), outcome.following[k], terminated=ended))
        terms = outcome.terms
        sums["transitions"] += len(outcome.agents)
        sums["penalty"] += float(outcome.penalty.sum())
        for name in ("collision", "off_road", "edge", "proximity", "hard_brake", "guard"):
            sums[name] += float(getattr(terms, name).sum())
        collided = collided or bool(terms.collision.any())
        over = terminated or truncated or not (info["agents"] != NOBODY).any()
    sums["collided_episodes"] += float(collided)
    return Episode(tracks, dict(sums))


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
    observation, raw, density, executed, penalty = (np.array(column) for column in zip(*steps, strict=True))
    return Track(np.concatenate([observation, following[None]]), raw, density, executed, penalty, terminated)
