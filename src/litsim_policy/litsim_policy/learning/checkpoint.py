"""What a training is between two iterations, and the files that it leaves: it goes on from a checkpoint."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from pydantic import BaseModel

from litsim_policy.learning.config import TrainConfig
from litsim_policy.learning.critic import Critic
from litsim_policy.learning.network import GaussianPolicy, multilayer, save
from litsim_policy.learning.plots import PANELS, Lines, plot_curves
from litsim_sim.core.errors import InputError

CHECKPOINT, HISTORY, CURVES, LAST, BEST = (
    "checkpoint.pt",
    "history.json",
    "curves.png",
    "last.safetensors",
    "best.safetensors",
)


class AdversarialTraining:
    """A policy that learns against a critic: what changes from iteration to iteration, and the files that it leaves.

    A subclass makes the networks and optimisers, and says how the policy is saved.

    Attributes:
        config: of the training, with a seed.
        policy, value, critic: the networks that learn.
        policy_optimiser, critic_optimiser: of policy and value together, and of the critic.
        history: entries of what was measured.
        best: highest validation score so far.
        more: names of further attributes that a checkpoint holds.
        panels: of the picture of the curves.
    """

    config: Any
    policy: torch.nn.Module
    value: torch.nn.Module
    critic: torch.nn.Module
    policy_optimiser: torch.optim.Optimizer
    critic_optimiser: torch.optim.Optimizer
    more: ClassVar[tuple[str, ...]] = ()
    panels: ClassVar[Mapping[str, Lines]] = PANELS

    def __init__(self) -> None:
        self.history: list[dict[str, float]] = []
        self.best = -np.inf

    @property
    def iterations(self) -> int:
        """Iterations made."""
        return len(self.history)

    def save(self, path: Path) -> None:
        """Write the weights of the policy, with :attr:`about`."""
        raise NotImplementedError

    @property
    def _parts(self) -> dict[str, Any]:
        names = ("policy", "value", "critic", "policy_optimiser", "critic_optimiser")
        return {name: getattr(self, name) for name in names}

    def keep(self, out: Path) -> None:
        """Write a checkpoint, to go on from here."""
        more = {"history": self.history, "best": float(self.best)} | {name: getattr(self, name) for name in self.more}
        keep_state(out / CHECKPOINT, self.config, self._parts, more)

    def write(self, out: Path) -> None:
        """Write what is there so far to `out`: the history, its curves, and the weights of the last iteration."""
        (out / HISTORY).write_text(json.dumps(self.history, indent=1) + "\n")
        self.save(out / LAST)
        plot_curves(self.history, out / CURVES, self.panels)

    def read(self, path: Path) -> None:
        """Go on from a checkpoint.

        Raises:
            InputError: there is none, or it is of a run with another configuration.
        """
        state = read_state(path, self.config, self._parts)
        for name in ("history", "best", *self.more):
            setattr(self, name, state[name])

    @property
    def about(self) -> dict[str, str]:
        """Metadata of weights, which say where they come from: seed, iterations made and the whole configuration."""
        config = self.config.model_dump_json()
        return {"seed": str(self.config.seed), "iterations": str(self.iterations), "config": config}


class Training(AdversarialTraining):
    """A training of policy C; its history has one entry an iteration.

    Attributes:
        config: of the training.
        policy: the network that drives.
        critic: that tells it from recorded drivers.
    """

    config: TrainConfig
    policy: GaussianPolicy
    critic: Critic

    def __init__(self, config: TrainConfig) -> None:
        super().__init__()
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


def keep_state(path: Path, config: BaseModel, parts: Mapping[str, Any], more: Mapping[str, Any]) -> None:
    """Write the states of `parts` (networks and optimisers), and `more`, of a training by `config`."""
    described = json.dumps(config.model_dump(mode="json"))
    fresh = path.with_name(f"{path.name}.new")
    torch.save({name: part.state_dict() for name, part in parts.items()} | dict(more) | {"config": described}, fresh)
    fresh.replace(path)  # a run that is killed while it writes leaves the checkpoint before


def read_state(
    path: Path, config: BaseModel, parts: Mapping[str, Any], *, length: str = "iterations", device: str = "cpu"
) -> dict[str, Any]:
    """Bring `parts` to the states in the checkpoint `path`, read to a `device` of torch, and return all that is in it.

    Raises:
        InputError: there is none, or it is of a run with another configuration; only the field `length` may differ.
    """
    if not path.is_file():
        raise InputError(f"{path}: no checkpoint to resume from")
    try:
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    except Exception as error:
        raise InputError(f"{path}: not a readable checkpoint: {error}") from error
    then, now = json.loads(state["config"]), config.model_dump(mode="json")
    changed = [key for key in now if key != length and then.get(key) != now[key]]
    if changed:
        raise InputError(f"{path}: fields {', '.join(changed)} of the configuration have changed since")
    for name, part in parts.items():
        part.load_state_dict(state[name])
    return state
