"""Likelihood of the log under the run, as in the Waymo Open Sim Agents Challenge of 2025 (Montali et al. 2023).

For every agent and feature, the run's values make a histogram, or for collisions, leaving the road and red lights a
Bernoulli distribution of whether the agent ever does so; the score is the likelihood of the logged values under it. The
challenge has 32 rollouts of each scene, a deterministic run is one. Nothing is copied from the challenge's code.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import HIGHER, Branch, Count, Measure, family
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.motion_features import SIM_AGENTS, Sampled
from litsim_eval.analysis.measures.realism import naturalness
from litsim_eval.analysis.measures.signals import log_passages, run_passages
from litsim_sim.core.scene import ByteArray, IntArray
from litsim_sim.record.run import Run

GROUPS = {
    "kinematic": ("linear_speed", "linear_acceleration", "angular_speed", "angular_acceleration"),
    "interaction": ("distance_to_nearest", "collision", "time_to_leader"),
    "map": ("distance_to_road_edge", "off_road", "traffic_light_violation"),
}
"""Features by what the challenge reports together."""

OF_AGENTS = ("collision", "off_road", "traffic_light_violation")
"""Features that are of an agent, not of its steps: whether it ever does so."""

SMOOTHING, SMOOTHING_OF_AGENTS = 0.1, 0.001  # pseudo-counts of a bin of a histogram, and of both outcomes (2025)


@dataclass(frozen=True)
class Acts:
    """Who did what, in a run or in its log.

    Attributes:
        collided: agents with a contact.
        ran_red: agents that passed a stop line at red; None without signals.
    """

    collided: Collection[int]
    ran_red: Collection[int] | None


@Branch
def sim_agents(run: Run) -> dict[str, Any] | None:
    """Returns the likelihood of the logs of the agents ever under control; None if there is nothing to judge."""
    hits, features = run.once(collisions), run.once(naturalness)
    acts, logged = (
        Acts(
            collided,
            None if run.signals is None else {passage.agent for passage in passed(run) or () if passage.at_red},
        )
        for collided, passed in (
            (hits.colliding, run_passages),
            ({agent for pair in hits.log for agent in pair}, log_passages),
        )
    )
    return log_likelihood((features.run, acts), (features.log, logged), hits.controlled)


def log_likelihood(
    run: tuple[Sampled, Acts], log: tuple[Sampled, Acts], agents: Collection[int]
) -> dict[str, Any] | None:
    """Returns the likelihood of the log of `agents` under their motion in the run; None if no log is sampled.

    Args:
        run, log: features of the agents at the same steps of the run and of its log, and what they did.
        agents: ids of those to be judged.

    Returns:
        Geometric means of the likelihoods of the logged values, by feature, and means of these by the weights of the
        challenge, renormalised over those that can be judged: of all, and of each of :data:`GROUPS`.
    """
    judged = np.intersect1d(log[0].ids, np.array(sorted(agents), np.int64))
    if not len(judged):
        return None
    features = {name: _of_steps(name, run[0], log[0], judged) for name in SIM_AGENTS if name not in OF_AGENTS}
    acts = _acts(run, log, judged)
    features |= {name: _of_agents(*acts[name]) if name in acts else None for name in OF_AGENTS}
    score = _weighted(features)
    assert score is not None  # speeds can always be judged
    groups = {group: _weighted({name: features[name] for name in names}) for group, names in GROUPS.items()}
    return {
        "score": score,
        "kinematic": groups["kinematic"],
        "interaction": groups["interaction"],
        "map": groups["map"],
        "features": features,
        "agents": len(judged),
    }


def _of_steps(name: str, run: Sampled, log: Sampled, agents: IntArray) -> float | None:
    """Returns the likelihood of the logged steps of `agents` (n,), each agent under its own histogram of the run."""
    here, there = run.sim_agents[name], log.sim_agents[name]
    if not len(there):
        return None
    bins = SIM_AGENTS[name].bins
    ours, theirs = np.isin(run.ids, agents), np.isin(log.ids, agents)
    counts = np.full((len(agents), bins), SMOOTHING)
    np.add.at(counts, (agents.searchsorted(run.ids[ours]), here[ours]), 1.0)
    probability = counts / counts.sum(axis=1, keepdims=True)
    return float(np.exp(np.log(probability[agents.searchsorted(log.ids[theirs]), there[theirs]]).mean()))


def _acts(
    run: tuple[Sampled, Acts], log: tuple[Sampled, Acts], agents: IntArray
) -> dict[str, tuple[ByteArray, ByteArray]]:
    """Returns whether each of `agents` (n,) ever did what :data:`OF_AGENTS` name, in the run and in the log (n,)."""
    did: list[dict[str, ByteArray]] = []
    for features, acts in (run, log):
        by: dict[str, Collection[int]] = {"collision": acts.collided}
        if len(features.sim_agents["off_road"]):
            by["off_road"] = features.ids[features.sim_agents["off_road"] == 1].tolist()
        if acts.ran_red is not None:
            by["traffic_light_violation"] = acts.ran_red
        did.append({name: np.isin(agents, sorted(who)).astype(np.uint8) for name, who in by.items()})
    return {name: (did[0][name], did[1][name]) for name in did[0] if name in did[1]}


def _of_agents(here: ByteArray, there: ByteArray) -> float:
    """Returns the likelihood of what agents did in the log, `there` (n,), given whether they did so in the run."""
    probability = (SMOOTHING_OF_AGENTS + (here == there)) / (1.0 + 2.0 * SMOOTHING_OF_AGENTS)
    return float(np.exp(np.log(probability).mean()))


def _weighted(features: Mapping[str, float | None]) -> float | None:
    """Returns the mean of the known `features` by the weights of the challenge; None if none is known."""
    given = {name: value for name, value in features.items() if value is not None}
    total = sum(SIM_AGENTS[name].weight for name in given)
    return sum(SIM_AGENTS[name].weight * value for name, value in given.items()) / total if given else None


MEASURES = family(
    "likelihood of the logs of the agents ever under control, given what they did in the run, as in the [Waymo Open "
    "Sim Agents Challenge](https://arxiv.org/abs/2305.12032) of 2025, with its ten features, weights, bins and "
    "smoothing: each agent's values in the run make a histogram, under which its logged values are judged",
    Measure("sim_agents.score", sim_agents, better=HIGHER),
    "the same by the challenge's groups and by feature (null without data: lanes, signals); number of agents",
    Measure("sim_agents.kinematic", sim_agents, better=HIGHER),
    Measure("sim_agents.interaction", sim_agents, better=HIGHER),
    Measure("sim_agents.map", sim_agents, better=HIGHER),
    Measure("sim_agents.features", sim_agents, better=HIGHER, keys=tuple(SIM_AGENTS)),
    Count("sim_agents.agents", sim_agents),
)
