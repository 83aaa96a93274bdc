"""Episodes driven by a policy, for training and validation: the track of each agent, and totals of events."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice

import numpy as np
import torch
from gymnasium.utils import seeding

from litsim_policy.ego.log import LogEgo
from litsim_research.policies.config import TrainConfig
from litsim_research.policies.episodes import Course, Episodes
from litsim_research.policies.network import GaussianPolicy, Sampler
from litsim_research.policies.ppo import Track
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.batched import kind
from litsim_sim.scenario.scenario import Scenario

EMPTY_EPISODES_MAX = 100  # episodes in a row without an agent to drive, after which training gives up
BATCH_MAX = 192  # most episodes that are stepped together
AT_FIRST = 12  # episodes of the first portion, as long as no iteration tells how many are enough
AT_ONCE = 384  # most episodes in one portion
MARGIN = 1.25  # on the expected number of episodes: a few more in one portion cost less than a second portion
COUNTED = ("collision", "off_road", "edge", "proximity", "hard_brake", "guard", "displacement", "jerk")
"""Fields of Penalties that are summed."""
SUMMED = ("transitions", "penalty", *COUNTED)
VALIDATION_SEED = 10_000_019  # seed of the first episode of every validation


@dataclass(frozen=True)
class Episode:
    """Result of an episode.

    Attributes:
        tracks: one for every period in which an agent was driven; may be empty.
        sums: totals of events and penalties, by name.
    """

    tracks: list[Track]
    sums: Mapping[str, float]


Driving = Callable[[GaussianPolicy, Sequence[int]], Iterator[Episode]]
"""Yields the episodes of seeds, at least one, in this order, driven by a policy in this process or in others, with the
same results. The policy must not change before the last episode has been yielded."""


def driving_here(course: Course, *, draws: bool) -> Driving:
    """Returns what drives episodes of `course` in this process; see :func:`drive`."""

    def episodes(policy: GaussianPolicy, seeds: Sequence[int]) -> Iterator[Episode]:
        for first in range(0, len(seeds), BATCH_MAX):
            yield from drive(course, policy, seeds[first : first + BATCH_MAX], draws=draws)

    return episodes


def drawn_episodes(
    driving: Driving, policy: GaussianPolicy, config: TrainConfig, history: Sequence[Mapping[str, float]]
) -> Iterator[Episode]:
    """Yield an iteration's episodes, until they have `config.transitions` agent-steps; see :func:`collect`.

    The policy must not change before the last episode has been yielded. The number of episodes needed is estimated from
    `history`, the entries of earlier iterations.

    Raises:
        InputError: no agent is driven in EMPTY_EPISODES_MAX episodes in a row.
    """
    sequences = (np.random.SeedSequence([config.seed, len(history), episode]) for episode in count())
    seeds = (int(sequence.generate_state(1)[0]) for sequence in sequences)
    missing, empty = float(config.transitions), 0
    while missing > 0.0:
        for episode in driving(policy, list(islice(seeds, planned(history, missing)))):
            missing -= episode.sums.get("transitions", 0.0)
            empty = 0 if episode.tracks else empty + 1
            if empty == EMPTY_EPISODES_MAX:
                raise InputError(
                    f"training: no agent is driven in {empty} episodes in a row, expected scenarios with vehicles "
                    f"within environment.sample_radius ({config.environment.sample_radius} m) of the ego, or in "
                    "conflict with it"
                )
            yield episode


def planned(history: Sequence[Mapping[str, float]], missing: float) -> int:
    """Number of episodes to drive next for `missing` agent-steps, by the mean yield of earlier iterations."""
    done = sum(entry["episodes"] for entry in history)
    if not done:
        return AT_FIRST
    mean = max(sum(entry["transitions"] for entry in history) / done, 1.0)
    return min(int(np.ceil(MARGIN * missing / mean)), AT_ONCE)


def collect(episodes: Iterable[Episode]) -> tuple[list[Track], dict[str, float]]:
    """Return the tracks of all agents in `episodes`, and rates of events and penalties by name.

    Collisions and off_road are events per 1000 agent-steps, collided_share is the share of episodes in which a driven
    agent collided, and the others, but for numbers of transitions and episodes, are means over agent-steps. Episodes
    with a driven agent are `driven_episodes`.
    """
    tracks: list[Track] = []
    sums: dict[str, float] = defaultdict(float)
    number = 0
    for number, episode in enumerate(episodes, 1):  # noqa: B007 - used after the loop, as their number
        tracks += episode.tracks
        for name, value in episode.sums.items():
            sums[name] += value
    count = max(sums["transitions"], 1.0)
    return tracks, {
        "transitions": sums["transitions"],
        "episodes": float(number),
        "driven_episodes": sums["driven_episodes"],
        "penalty": sums["penalty"] / count,
        "collisions": 1000.0 * sums["collision"] / count,
        "collided_share": sums["collided_episodes"] / number,
        "off_road": 1000.0 * sums["off_road"] / count,
        **{name: sums[name] / count for name in ("edge", "proximity", "hard_brake", "guard", "displacement", "jerk")},
    }


def drive(course: Course, policy: GaussianPolicy, seeds: Sequence[int], *, draws: bool) -> list[Episode]:
    """Drive the episodes of `seeds`; actions are drawn from `policy` if `draws`, otherwise its means.

    Episodes on scenarios of one kind are stepped together; each gives the same result as on its own.
    """
    driven: dict[int, Episode] = {}
    sampler = Sampler.of(policy)
    for group in by_kind(map(course.scenario_of, seeds)):
        starts = [course.start(seeding.np_random(seeds[number])[0]) for number in group]
        generators = [torch.Generator().manual_seed(seeds[number]) for number in group] if draws else None
        driven |= dict(zip(group, _drive_batch(Episodes(course, starts), sampler, generators), strict=True))
    return [driven[number] for number in range(len(seeds))]


def by_kind(scenarios: Iterable[Scenario]) -> list[list[int]]:
    """Positions in `scenarios`, grouped by their kind: each group can be stepped together."""
    groups: dict[Hashable, list[int]] = defaultdict(list)
    for number, scenario in enumerate(scenarios):
        groups[kind(scenario)].append(number)
    return list(groups.values())


def _drive_batch(episodes: Episodes, sampler: Sampler, generators: Sequence[torch.Generator] | None) -> list[Episode]:
    """Drive `episodes` to their ends; actions are drawn by one generator per episode, or are the means for None."""
    count, scene_of = len(episodes.running), episodes.batch.log.scene
    totals = np.zeros((len(SUMMED), count))
    tracks: list[list[Track]] = [[] for _ in range(count)]
    recorded = [isinstance(ego, LogEgo) for ego in episodes.egos]
    open_tracks: dict[int, list[tuple[np.ndarray, ...]]] = defaultdict(list)
    while episodes.running.any():
        before, scene = episodes.seen.copy(), scene_of[episodes.driven]
        raw, density = sampler.sample(before, None if generators is None else _noise(scene, generators))
        outcome = episodes.step(np.tanh(raw))
        for k, agent in enumerate(outcome.agents.tolist()):
            step = (before[k], raw[k], density[k], outcome.executed[k], outcome.penalty[k])
            open_tracks[agent].append(step)
            if not outcome.driven_on[k]:
                ended = bool(outcome.terminated[k])
                track = _track(open_tracks.pop(agent), outcome.following[k], terminated=ended)
                tracks[scene[k]].append(replace(track, recorded=recorded[scene[k]]))
        there = scene_of[outcome.present]
        weights = [(scene, np.ones(len(scene))), (scene, outcome.penalty)]
        weights += [(there, getattr(outcome.terms, name).astype(np.float64)) for name in COUNTED]
        totals += np.array([np.bincount(of, values, count) for of, values in weights])
    sums = [dict(zip(SUMMED, column, strict=True)) for column in totals.T.tolist()]
    for own in sums:
        own["collided_episodes"] = float(own["collision"] > 0.0)
        own["driven_episodes"] = float(own["transitions"] > 0.0)
    return [Episode(of_one, own) for of_one, own in zip(tracks, sums, strict=True)]


def _noise(scene: IntArray, generators: Sequence[torch.Generator]) -> FloatArray:
    """Standard normal numbers (m, 3), drawn by the generator of each agent's scene; `scene` (m,) is sorted."""
    counts = np.bincount(scene, minlength=len(generators)).tolist()
    drawn = [torch.randn((n, 3), generator=generators[k]) for k, n in enumerate(counts) if n]
    return torch.cat(drawn).double().numpy() if drawn else np.empty((0, 3))


def validate(driving: Driving, policy: GaussianPolicy, config: TrainConfig) -> dict[str, float]:
    """Drive the episodes of a validation, which are always the same.

    Returns:
        rates by name, and `validation_score`: the mean penalty of an agent-step, at most 0.

    Raises:
        InputError: no agent is driven in any episode.
    """
    rates = collect(driving(policy, range(VALIDATION_SEED, VALIDATION_SEED + config.validation_episodes)))[1]
    if not rates["transitions"]:
        raise InputError(
            f"training: no agent is driven in the {config.validation_episodes} episodes of validation, expected "
            "scenarios with vehicles near the ego or in conflict with it, or a larger validation_episodes"
        )
    wanted = ("penalty", "collisions", "off_road", "hard_brake", "guard", "collided_share", "driven_episodes")
    return {f"validation_{name}": rates[name] for name in wanted} | {"validation_score": rates["penalty"]}


def _track(steps: list[tuple[np.ndarray, ...]], following: np.ndarray, *, terminated: bool) -> Track:
    """The track of one agent, from its steps in :func:`_drive_batch` and the observation (size,) after the last."""
    observation, raw, density, executed, penalty = (np.array(column) for column in zip(*steps, strict=True))
    seen = np.concatenate([observation, following[None]])
    return Track(seen, raw, density, executed, penalty, terminated)
