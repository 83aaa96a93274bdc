"""Traffic driven by the policy that learns: what every agent went through, and what happened."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from litsim_policy.learning.draw import with_ego
from litsim_policy.learning.imitation.config import ImitationTraining
from litsim_policy.learning.imitation.episodes import TrafficEpisodes
from litsim_policy.learning.imitation.network import TrafficPolicy
from litsim_policy.learning.ppo import Track, tensor
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray
from litsim_sim.scenario.joined import kind
from litsim_sim.scenario.scenario import Scenario

VALIDATION_SEED = 10_000_019
EVERYBODY = 1000  # agents of a scene: more than there are
EMPTY_SCENES_MAX = 100  # scenes in a row without anybody to drive, after which there is no point in going on


@dataclass(frozen=True)
class Drive:
    """What came of some episodes.

    Attributes:
        tracks: one for every agent; the penalty is RAIL's, before its weight.
        faulty: agents that touched somebody who was not behind them, and agents that left the road.
        errors: (k,) distances to the logs at the last step [m], of agents whose logs know of it.
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
    """Drive up to `count` agents of each of `scenes`, of one kind, for `horizon` steps at most.

    Actions are drawn by `generator`; None is by their means.
    """
    episodes = TrafficEpisodes(scenes, count, radius)
    ids, columns = [], []
    contacts, off = set(), set()
    error = np.empty(0)
    until = min(episodes.step_number + horizon, episodes.last_step)
    while episodes.step_number < until and len(episodes.agents):
        seen = episodes.seen
        raw, density = _drawn(policy, seen, generator)
        step = episodes.step(raw)
        ids.append(step.agents)
        columns.append((seen, raw, density, step.executed, -step.faults.worst))
        contacts |= set(step.agents[step.faults.contact].tolist())
        off |= set(step.agents[step.faults.off_road >= 1.0].tolist())
        error = step.error
    if not ids:
        return Drive([], (0, 0), error)
    left = dict(zip(episodes.agents.tolist(), episodes.seen, strict=True))
    tracks = _tracks(np.concatenate(ids), [np.concatenate(column) for column in zip(*columns, strict=True)], left)
    return Drive(tracks, (len(contacts), len(off)), error[np.isfinite(error)])


def collect(
    scenarios: Sequence[Scenario], policy: TrafficPolicy, config: ImitationTraining, iteration: int
) -> tuple[list[Track], dict[str, float]]:
    """Drive scenes that are drawn from `scenarios` until there are `config.transitions` agent-steps.

    Returns:
        tracks, and rates by name as :func:`rates` has them.

    Raises:
        InputError: in none of many scenes in a row was anybody driven.
    """
    random = np.random.default_rng([config.seed, 2, iteration])
    generator = torch.Generator().manual_seed(int(random.integers(2**62)))
    stage = iteration * len(config.agents) // config.iterations
    found: list[Drive] = []
    missing, empty = config.transitions, 0
    while missing > 0:
        drawn = [with_ego(scenarios[int(random.integers(len(scenarios)))], random) for _ in range(config.together)]
        some = [
            drive(scenes, policy, config.agents[stage], config.radius, config.horizon, generator)
            for scenes in _by_kind(drawn)
        ]
        steps = sum(len(track) for one in some for track in one.tracks)
        missing, empty = missing - steps, 0 if steps else empty + len(drawn)
        if empty >= EMPTY_SCENES_MAX:
            raise _nobody_driven(f"{empty} scenes in a row", config)
        found += some
    return [track for one in found for track in one.tracks], rates(found)


def validate(scenarios: Sequence[Scenario], policy: TrafficPolicy, config: ImitationTraining) -> dict[str, float]:
    """Drive scenes that are the same each time, with everybody driven by the means of `policy`.

    Returns:
        rates by name, and `validation_score`, at most 0.

    Raises:
        InputError: nobody is driven in any of them, so that there is nothing to score.
    """
    random = np.random.default_rng(VALIDATION_SEED)
    drawn = [with_ego(scenarios[k % len(scenarios)], random) for k in range(config.validation_scenes)]
    found = [drive(scenes, policy, EVERYBODY, config.radius, config.horizon, None) for scenes in _by_kind(drawn)]
    rated = rates(found)
    if not rated["transitions"]:
        raise _nobody_driven(f"the {config.validation_scenes} scenes of validation", config)
    score = -(rated["contact"] + rated["off_road"] + config.error_weight * rated["error"])
    return {f"validation_{name}": rated[name] for name in ("contact", "off_road", "error")} | {
        "validation_score": score
    }


def rates(drives: Sequence[Drive]) -> dict[str, float]:
    """Shares of agents that touched somebody and that left the road, mean error at the end [m], and agent-steps."""
    tracks = [track for one in drives for track in one.tracks]
    contacts, off = (sum(one.faulty[k] for one in drives) for k in (0, 1))
    errors = np.concatenate([one.errors for one in drives]) if drives else np.empty(0)
    return {
        "transitions": float(sum(len(track) for track in tracks)),
        "agents": float(len(tracks)),
        "contact": contacts / max(len(tracks), 1),
        "off_road": off / max(len(tracks), 1),
        "error": float(errors.mean()) if len(errors) else 0.0,
    }


def _nobody_driven(where: str, config: ImitationTraining) -> InputError:
    """The error of scenes, named by `where`, that have nobody to drive."""
    return InputError(
        f"training: nobody is driven in {where}, expected scenarios with vehicles within radius ({config.radius:g} m) "
        "of the ego"
    )


def _by_kind(scenes: Sequence[Scenario]) -> list[list[Scenario]]:
    """`scenes` in groups of one kind each."""
    groups: dict[Hashable, list[Scenario]] = defaultdict(list)
    for scene in scenes:
        groups[kind(scene)].append(scene)
    return list(groups.values())


def _drawn(policy: TrafficPolicy, seen: FloatArray, generator: torch.Generator | None) -> tuple[FloatArray, FloatArray]:
    """Actions (m, 2) for observations (m, SIZE), and the logarithms of their densities (m,)."""
    with torch.no_grad():
        observation = tensor(seen)
        raw = policy(observation)
        if generator is not None:
            raw = raw + policy.std() * torch.randn(raw.shape, generator=generator)
        return raw.double().numpy(), policy.log_probability(observation, raw).double().numpy()


def _tracks(agents: IntArray, columns: list[np.ndarray], left: dict[int, FloatArray]) -> list[Track]:
    """Tracks of the `agents` (k,) of all steps one after another.

    Args:
        agents: ids.
        columns: observations, actions, densities, what was executed and penalties, (k, ...) each.
        left: what those observe who are still there after the last step.
    """
    order = np.argsort(agents, kind="stable")
    names, begin = np.unique(agents[order], return_index=True)
    found = []
    for agent, rows in zip(names.tolist(), np.split(order, begin[1:]), strict=True):
        observation, raw, density, executed, penalty = (column[rows] for column in columns)
        following = left.get(agent, observation[-1])
        seen = np.concatenate([observation, following[None]])
        found.append(Track(seen, raw, density, executed, penalty, terminated=False))
    return found
