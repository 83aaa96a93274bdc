"""The terms of PPO's loss, each where it alone decides: clipping from both sides, and the entropy."""

import math

import pytest
import torch

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.policies.network import GaussianPolicy, multilayer
from litsim_research.policies.ppo import Batch, PpoConfig, update_policy

SEEN = ObservationConfig(slots=2)


def moved(ratio: float, advantage: float, **config: float) -> tuple[float, float]:
    """How far one update moves the mean, and by how much it raises the log of the spread.

    The policy is `ratio` times as likely to act as it did as the one that drove.
    """
    torch.manual_seed(0)
    policy, value = GaussianPolicy(SEEN), multilayer(SEEN.size, 1)
    generator = torch.Generator().manual_seed(0)
    observation = torch.rand((64, SEEN.size), generator=generator)
    raw = policy.draw(observation, generator)
    density = policy.log_probability(observation, raw).detach()
    batch = Batch(observation, raw, density - math.log(ratio), torch.full((64,), advantage), torch.zeros(64))
    before = policy.mean.weight.detach().clone(), policy.log_std.detach().clone()
    optimiser = torch.optim.SGD([*policy.parameters(), *value.parameters()], 0.1)
    settings = {"batch": 64, "epochs": 1, "clip": 0.2, "ent_coef": 0.0, "vf_coef": 0.0} | config
    update_policy(policy, value, optimiser, batch, PpoConfig(**settings), generator)
    mean, log_std = policy.mean.weight.detach(), policy.log_std.detach()
    return float((mean - before[0]).norm()), float((log_std - before[1]).mean())


@pytest.mark.parametrize(
    ("ratio", "advantage", "moves"),
    [(1.5, 1.0, False), (1.5, -1.0, True), (0.5, -1.0, False), (0.5, 1.0, True), (1.1, 1.0, True), (0.9, -1.0, True)],
)
def test_what_has_gone_far_enough_the_right_way_goes_no_farther(ratio: float, advantage: float, *, moves: bool) -> None:
    distance, _ = moved(ratio, advantage)
    assert (distance > 1e-5) == moves


def test_entropy_is_rewarded() -> None:
    assert moved(1.5, 1.0, ent_coef=0.1)[1] > 1e-4
    assert moved(1.5, 1.0)[1] == pytest.approx(0.0, abs=1e-9)
