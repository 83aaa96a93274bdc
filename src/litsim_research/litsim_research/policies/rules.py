"""The warm start of a residual policy: what the rules do that it is to do without."""

from __future__ import annotations

import numpy as np
import torch
from tqdm import trange

from litsim_research.policies.config import TrainConfig
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import Demonstrations, tensor
from litsim_research.policies.rollout import Driving, begin, collect
from litsim_research.policies.warm_start import clone
from litsim_sim.core.scene import FloatArray


def learn_rules(policy: GaussianPolicy, driving: Driving, config: TrainConfig, *, progress: bool) -> None:
    """Fit `policy`, in place, to what the rules would do where it comes itself (DAgger, Ross 2011).

    In each of `config.rule_rounds` it drives, and learns from the agent-steps of all rounds so far: who has only seen
    the rules drive does not know what to do where these would never have come.

    Raises:
        InputError: no agent is driven in any episode, or the policy diverges.
    """
    rounds: list[dict[str, float]] = []
    observed: list[FloatArray] = []
    advised: list[FloatArray] = []
    for number in trange(config.rule_rounds, unit="round", disable=not progress):
        tracks, rates = collect(begin(driving, policy, config, rounds))
        rounds.append(rates)
        observed += [track.observation[:-1] for track in tracks]
        advised += [track.advice for track in tracks if track.advice is not None]
        advice = tensor(np.concatenate(advised))
        shown = Demonstrations(tensor(np.concatenate(observed)), advice, torch.ones(len(advice)))
        clone(policy, shown, config.warm_start, config.seed + number, shown.error)
