"""The state of a training between two iterations, its checkpoints, and the files that it writes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch

from litsim_research.policies.config import TrainConfig
from litsim_research.policies.critic import Critic
from litsim_research.policies.data import TrainingData, described
from litsim_research.policies.network import GaussianPolicy, StochasticPolicy, multilayer, save
from litsim_research.policies.plots import PANELS
from litsim_research.policies.ppo import Demonstrations, Track, make_batch, update_policy
from litsim_research.predictors.checkpoint import ResumableTraining
from litsim_research.predictors.training.curves import Lines, plot_curves
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.files import write_text

HISTORY, CURVES, LAST, BEST = "history.json", "curves.png", "last.safetensors", "best.safetensors"


class AdversarialTraining(ResumableTraining):
    """The state of a policy's training against a critic, and its files.

    Subclasses make the networks and optimisers, and save the policy.

    Attributes:
        policy, value, critic: the networks.
        policy_optimiser, critic_optimiser: of policy and value together, and of the critic.
        best: highest validation score so far.
        panels: of the picture of the learning curves.
    """

    policy: StochasticPolicy
    value: torch.nn.Module
    critic: torch.nn.Module
    policy_optimiser: torch.optim.Optimizer
    critic_optimiser: torch.optim.Optimizer
    best = -np.inf
    parts = ("policy", "value", "critic", "policy_optimiser", "critic_optimiser")
    more: tuple[str, ...] = ("history", "best")
    panels: ClassVar[Mapping[str, Lines]] = PANELS

    def __init__(self, data: TrainingData) -> None:
        self.data, self.history = described(data), []

    @property
    def iterations(self) -> int:
        """Number of iterations done."""
        return len(self.history)

    def save(self, path: Path) -> None:
        """Write the weights of the policy, with :attr:`about` as metadata."""
        raise NotImplementedError

    def improve(
        self,
        tracks: list[Track],
        reward: FloatArray,
        generator: torch.Generator,
        shown: Demonstrations | None = None,
    ) -> dict[str, float]:
        """Update policy and value network by PPO; returns what :func:`.ppo.update_policy` does.

        Args:
            tracks: driven by the policy.
            reward: (m,) of all their steps, one track after another.
            generator: of the draws.
            shown: demonstrations that the policy is kept near to.

        Raises:
            InputError: the policy or the value network diverges.
        """
        ppo, ends = self.config.ppo, np.cumsum([len(track) for track in tracks])
        batch = make_batch(tracks, np.split(reward, ends[:-1]), self.value, ppo)
        value_only = self.iterations < ppo.value_first
        return update_policy(
            self.policy, self.value, self.policy_optimiser, batch, ppo, generator, shown, value_only=value_only
        )

    def note(self, figures: dict[str, float], out: Path, *, may_be_best: bool = True) -> None:
        """Add `figures` of an iteration to the history, and write a checkpoint to the folder `out`.

        If they are validated, also write the history, its curves and the weights, and if their `validation_score` is
        the highest so far and `may_be_best`, the weights as the best ones.

        Raises:
            Unwritable: a file cannot be written; what was there is kept.
        """
        self.history.append(figures)
        score = figures.get("validation_score")
        if score is not None and may_be_best and score > self.best:
            self.best = score
            self.save(out / BEST)
        self.keep(out)
        if score is not None:
            write_history(self.history, out / HISTORY)
            self.save(out / LAST)
            plot_curves(self.history, out / CURVES, self.panels)

    @property
    def about(self) -> dict[str, str]:
        """Metadata of the weights: seed, number of iterations, configuration, and SHA-256 of what the scenarios are."""
        config, data = self.config.model_dump_json(), hashlib.sha256(json.dumps(self.data).encode()).hexdigest()
        return {"seed": str(self.config.seed), "iterations": str(self.iterations), "config": config, "data": data}


class Training(AdversarialTraining):
    """A training of policy C."""

    config: TrainConfig
    policy: GaussianPolicy
    critic: Critic

    def __init__(self, config: TrainConfig, data: TrainingData) -> None:
        super().__init__(data)
        torch.manual_seed(config.seed)
        size = config.observation.size
        self.config = config
        self.policy, self.value, self.critic = GaussianPolicy(config.observation), multilayer(size, 1), Critic(size)
        parameters = [*self.policy.parameters(), *self.value.parameters()]
        self.policy_optimiser = torch.optim.Adam(parameters, config.ppo.learning_rate)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), config.critic.learning_rate)

    def save(self, path: Path) -> None:
        """See :meth:`AdversarialTraining.save`."""
        save(self.policy, path, self.about)


def write_history(history: list[dict[str, float]], path: Path) -> None:
    """Write the measured values of a training, one entry per iteration or validation.

    Raises:
        Unwritable: the file cannot be written; what was there is kept.
    """
    write_text(path, json.dumps(history, indent=1) + "\n")
