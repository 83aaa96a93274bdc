"""What a training of policy C is between two iterations, and the files that it leaves: it goes on from a checkpoint."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.critic import Critic
from litsim_policy.learning.network import GaussianPolicy, multilayer, save
from litsim_policy.learning.plots import plot_curves
from litsim_sim.core.errors import InputError

CHECKPOINT, HISTORY, CURVES, LAST, BEST = (
    "checkpoint.pt",
    "history.json",
    "curves.png",
    "last.safetensors",
    "best.safetensors",
)


class Training:
    """Everything of a training that changes from iteration to iteration: networks, optimisers, history.

    Attributes:
        config: of the training.
        policy, value, critic: the networks that learn.
        policy_optimiser, critic_optimiser: Adam of policy and value together, and of the critic.
        history: one entry an iteration, of what was measured in it.
        best: highest validation score so far.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        size = config.observation.size
        self.config = config
        self.policy, self.value, self.critic = GaussianPolicy(config.observation), multilayer(size, 1), Critic(size)
        parameters = [*self.policy.parameters(), *self.value.parameters()]
        self.policy_optimiser = torch.optim.Adam(parameters, config.ppo.learning_rate)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), config.critic.learning_rate)
        self.history: list[dict[str, float]] = []
        self.best = -np.inf

    @property
    def _parts(self) -> dict[str, Any]:
        names = ("policy", "value", "critic", "policy_optimiser", "critic_optimiser")
        return {name: getattr(self, name) for name in names}

    def keep(self, out: Path) -> None:
        """Write a checkpoint, to go on from here."""
        state = {name: part.state_dict() for name, part in self._parts.items()}
        described = json.dumps(self.config.model_dump(mode="json"))
        fresh = out / f"{CHECKPOINT}.new"
        torch.save({**state, "history": self.history, "best": float(self.best), "config": described}, fresh)
        fresh.replace(out / CHECKPOINT)  # a run that is killed while it writes leaves the checkpoint before

    def write(self, out: Path) -> None:
        """Write what is there so far to `out`: the history, its curves, and the weights of the last iteration."""
        (out / HISTORY).write_text(json.dumps(self.history, indent=1) + "\n")
        save(self.policy, out / LAST, self.about)
        plot_curves(self.history, out / CURVES)

    def read(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            InputError: there is none, or it is of a run with another configuration.
        """
        if not path.is_file():
            raise InputError(f"{path}: no checkpoint to resume from")
        try:
            state = torch.load(path, weights_only=True)
        except Exception as error:
            raise InputError(f"{path}: not a readable checkpoint: {error}") from error
        then, now = json.loads(state["config"]), self.config.model_dump(mode="json")
        changed = [key for key in now if key != "iterations" and then.get(key) != now[key]]
        if changed:
            raise InputError(f"{path}: fields {', '.join(changed)} of the configuration have changed since")
        for name, part in self._parts.items():
            part.load_state_dict(state[name])
        self.history, self.best = state["history"], state["best"]

    @property
    def about(self) -> dict[str, str]:
        """Metadata of weights, which say where they come from: seed, iterations made and the whole configuration."""
        config = self.config.model_dump_json()
        return {"seed": str(self.config.seed), "iterations": str(len(self.history)), "config": config}
