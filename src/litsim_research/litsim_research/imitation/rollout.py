"""Traffic driven by a policy, for training and validation: the track of each agent, faults and errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from litsim_research.imitation.config import ImitationTraining
from litsim_research.imitation.episodes import TrafficEpisodes
from litsim_research.imitation.network import TrafficPolicy
from litsim_research.policies.draw import with_ego
from litsim_research.policies.ppo import Track, tensor
from litsim_research.policies.rollout import VALIDATION_SEED, by_kind
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario

ALL_AGENTS = 1000  # more than a scene has
EMPTY_SCENES_MAX = 100  # scenes in a row without an agent to drive, after which training gives up


@dataclass(frozen=True)
class Drive:
    """Result of some episodes.

    Attributes:
        tracks: one for every agent; the penalty is RAIL's, before its weight.
        faulty: number of agents that touched one that was not behind them, and of agents that left the road.
        errors: (k,) distances to the logged positions at the last step [m], of agents with a log that lasts until then.
    """

    tracks: list[Track]
    faulty: tuple[int, int]
    errors: FloatArray


def drive(
    scenes: Sequence[Scenario],
    policy: TrafficPolicy,
    count: int,
    radius: float,
    horizon: int,
    generator: torch.Generator | None,
) -> Drive:
    """Drive up to `count` agents of each of `scenes`, which are of one kind, for at most `horizon` steps.

    Actions are drawn by `generator`; None for the policy's means.
    """
    episodes = TrafficEpisodes(scenes, count, radius, policy.turning)
    ids, columns = [], []
    contacts, off = set(), set()
    error = np.empty(0)
    until = min(episodes.step_number + horizon, episodes.last_step)
    while episodes.step_number < until and len(episodes.agents):
        observed = episodes.seen
        raw, density = _drawn(policy, observed, generator)
        step = episodes.step(raw)
        ids.append(step.agents)
        columns.append((observed, raw, density, step.executed, -step.worst))
        contacts |= set(step.agents[step.contact].tolist())
        off |= set(step.agents[step.off_road >= 1.0].tolist())
        error = step.error
    if not ids:
        return Drive([], (0, 0), error)
    left = dict(zip(episodes.agents.tolist(), episodes.seen, strict=True))
    tracks = _tracks(np.concatenate(ids), [np.concatenate(column) for column in zip(*columns, strict=True)], left)
    return Drive(tracks, (len(contacts), len(off)), error[np.isfinite(error)])


def collect(
    scenarios: Sequence[Scenario], policy: TrafficPolicy, config: ImitationTraining, iteration: int
) -> tuple[list[Track], dict[str, float]]:
    """Drive scenes drawn from `scenarios` until there are `config.transitions` agent-steps.

    Returns:
        tracks, and rates by name (:func:`rates`).

    Raises:
        InputError: no agent is driven in EMPTY_SCENES_MAX scenes in a row.
    """
    random = np.random.default_rng([config.seed, 2, iteration])
    generator = torch.Generator().manual_seed(int(random.integers(2**62)))
    stage = iteration * len(config.agents) // config.iterations
    drives: list[Drive] = []
    missing, empty = config.transitions, 0
    while missing > 0:
        drawn = [with_ego(scenarios[int(random.integers(len(scenarios)))], random) for _ in range(config.together)]
        some = [
            drive(scenes, policy, config.agents[stage], config.radius, config.horizon, generator)
            for scenes in _groups(drawn)
        ]
        steps = sum(len(track) for driven in some for track in driven.tracks)
        missing, empty = missing - steps, 0 if steps else empty + len(drawn)
        if empty >= EMPTY_SCENES_MAX:
            raise _nobody_driven(f"{empty} scenes in a row", config)
        drives += some
    return [track for driven in drives for track in driven.tracks], rates(drives)


def validate(scenarios: Sequence[Scenario], policy: TrafficPolicy, config: ImitationTraining) -> dict[str, float]:
    """Drive all agents near the egos of a fixed set of scenes by the means of `policy`.

    Returns:
        rates by name, and `validation_score`, at most 0.

    Raises:
        InputError: no agent is driven in any scene.
    """
    random = np.random.default_rng(VALIDATION_SEED)
    drawn = [with_ego(scenarios[k % len(scenarios)], random) for k in range(config.validation_scenes)]
    drives = [drive(scenes, policy, ALL_AGENTS, config.radius, config.horizon, None) for scenes in _groups(drawn)]
    rated = rates(drives)
    if not rated["transitions"]:
        raise _nobody_driven(f"the {config.validation_scenes} scenes of validation", config)
    score = -(rated["contact"] + rated["off_road"] + config.error_weight * rated["error"])
    return {f"validation_{name}": rated[name] for name in ("contact", "off_road", "error")} | {
        "validation_score": score
    }


def rates(drives: Sequence[Drive]) -> dict[str, float]:
    """Returns, by name, agents, agent-steps, shares with a contact and off the road, and mean error at the end [m]."""
    tracks = [track for drive in drives for track in drive.tracks]
    contacts, off = (sum(drive.faulty[k] for drive in drives) for k in (0, 1))
    errors = np.concatenate([drive.errors for drive in drives]) if drives else np.empty(0)
    return {
        "transitions": float(sum(len(track) for track in tracks)),
        "agents": float(len(tracks)),
        "contact": contacts / max(len(tracks), 1),
        "off_road": off / max(len(tracks), 1),
        "error": float(errors.mean()) if len(errors) else 0.0,
    }


def _nobody_driven(where: str, config: ImitationTraining) -> InputError:
    """Returns the error of scenes, described by `where`, without an agent to drive."""
    return InputError(
        f"training: no agent is driven in {where}, expected scenarios with vehicles within radius "
        f"({config.radius:g} m) of the ego"
    )


def _groups(scenes: Sequence[Scenario]) -> list[list[Scenario]]:
    """Returns `scenes` in groups of one kind each."""
    return [[scenes[k] for k in group] for group in by_kind(scenes)]


def _drawn(policy: TrafficPolicy, seen: FloatArray, generator: torch.Generator | None) -> tuple[FloatArray, FloatArray]:
    """Returns actions (m, 2) for observations (m, SIZE), and the logarithms of their densities (m,)."""
    with torch.no_grad():
        observation = tensor(seen)
        raw = policy(observation)
        if generator is not None:
            raw = raw + policy.std() * torch.randn(raw.shape, generator=generator)
        return raw.double().numpy(), policy.log_probability(observation, raw).double().numpy()


def _tracks(agents: IntArray, columns: list[np.ndarray], left: dict[int, FloatArray]) -> list[Track]:
    """Returns one track for each agent, from the k agent-steps of all steps one after another.

    Args:
        agents: (k,) ids.
        columns: observations, actions, densities, executed motion and penalties, (k, ...) each.
        left: observations after the last step by id, of the agents that are still there.
    """
    order = np.argsort(agents, kind="stable")
    names, begin = np.unique(agents[order], return_index=True)
    tracks = []
    for agent, rows in zip(names.tolist(), np.split(order, begin[1:]), strict=True):
        observation, raw, density, executed, penalty = (column[rows] for column in columns)
        following = left.get(agent, observation[-1])
        observed = np.concatenate([observation, following[None]])
        tracks.append(Track(observed, raw, density, executed, penalty, terminated=False))
    return tracks
