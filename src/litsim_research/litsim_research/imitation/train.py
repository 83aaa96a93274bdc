"""`train_imitation`: train the baselines `gail` and `rail` on recorded drivers, with a critic and PPO.

1. Scenarios: those of policy C, see :mod:`litsim_research.policies.data`.
2. Experts: observations and actions of all recorded drivers in them.
3. Warm start: behaviour cloning of these drivers, and of the way back to the path from displaced poses.
4. Iterations: drive traffic; train the critic on recorded and driven pairs; reward the policy by the critic, in RAIL
   less a penalty for faults; update it by PPO.

Every iteration draws from generators seeded by the run's seed and the iteration's number, so that a resumed run gives
the same weights. The folder `--out` gets checkpoint.pt, history.json, curves.png, last.safetensors and
best.safetensors.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from tqdm import tqdm

from litsim_policy.driving.features.traffic_observation import SIZE
from litsim_research.baselines.imitation_policy import BOUNDS
from litsim_research.imitation.config import ImitationTraining
from litsim_research.imitation.critic import update_wasserstein
from litsim_research.imitation.expert import traffic_pairs
from litsim_research.imitation.network import TrafficPolicy, perceptron, save
from litsim_research.imitation.rollout import collect, validate
from litsim_research.policies.checkpoint import BEST, CURVES, AdversarialTraining
from litsim_research.policies.data import TrainingData, prepare
from litsim_research.policies.plots import IMITATION_PANELS
from litsim_research.policies.ppo import Demonstrations, Track, tensor
from litsim_research.policies.training_program import training_parser, training_program
from litsim_research.policies.warm_start import clone
from litsim_research.predictors.checkpoint import CHECKPOINT
from litsim_sim.cli.program import program
from litsim_sim.io.yaml_input import read_yaml


class Imitation(AdversarialTraining):
    """A training of `gail` or `rail`; its history begins with an entry of the warm start.

    Attributes:
        replay: the policy's pairs of the last iterations, on which the critic is trained.
    """

    config: ImitationTraining
    policy: TrafficPolicy
    more = ("history", "best", "replay")
    panels = IMITATION_PANELS

    def __init__(self, config: ImitationTraining, data: TrainingData) -> None:
        super().__init__(data)
        torch.manual_seed(config.seed)
        self.config = config
        self.policy, self.value = TrafficPolicy(config.turning), perceptron(SIZE)
        self.critic = perceptron(SIZE + len(BOUNDS), config.critic.dropout)
        parameters = [*self.policy.parameters(), *self.value.parameters()]
        self.policy_optimiser = torch.optim.Adam(parameters, config.ppo.learning_rate)
        self.critic_optimiser = torch.optim.RMSprop(self.critic.parameters(), config.critic.learning_rate)
        self.replay: list[Tensor] = []

    @property
    def iterations(self) -> int:
        """Number of iterations done, without the warm start."""
        return len(self.history) - 1

    def save(self, path: Path) -> None:
        """See :meth:`.checkpoint.AdversarialTraining.save`."""
        save(self.policy, path, self.about)


def run(config: ImitationTraining, out: Path, *, resume: bool = False, progress: bool = True) -> Imitation:
    """Train, from the start or from the checkpoint in `out`.

    Raises:
        InputError: the data or the checkpoint cannot be used, or the training diverges.
    """
    out.mkdir(parents=True, exist_ok=True)
    data = prepare(config.data, out / "data")
    training = Imitation(config, data)
    if resume:
        training.read(out / CHECKPOINT)
    random = np.random.default_rng([config.seed, 1])
    experts = traffic_pairs(data.each_once, config.drivers, random, data.real, config.turning)
    recorded, shown = experts.demonstrations(config.drivers.real_share)
    if not training.history:
        clone(training.policy, shown, config.warm_start, config.seed, shown.surprise)
        _note(training, data, out, {}, last=False)
    done = training.iterations
    with tqdm(total=config.iterations, initial=done, unit="iteration", disable=not progress) as bar:
        for iteration in range(done, config.iterations):
            begin = time.perf_counter()
            figures = _iterate(training, data, recorded, iteration)
            figures["seconds"] = time.perf_counter() - begin
            _note(training, data, out, figures, last=iteration == config.iterations - 1)
            bar.set_postfix({name: f"{figures[name]:.3f}" for name in ("contact", "off_road", "error")})
            bar.update()
    return training


def _note(training: Imitation, data: TrainingData, out: Path, figures: dict[str, float], *, last: bool) -> None:
    """Add `figures`, an iteration's entry, to the history, with a validation if one is due, and write files.

    The warm start is validated for comparison, and never kept as the best, since no critic has influenced it.
    """
    before = len(training.history)
    if last or before % training.config.validate_every == 0:
        figures = figures | validate(data.validation, training.policy, training.config)
    training.note(figures, out, may_be_best=last or before > training.config.ppo.value_first)


def _iterate(training: Imitation, data: TrainingData, recorded: Demonstrations, iteration: int) -> dict[str, float]:
    """Make one iteration and return its entry of the history.

    Raises:
        InputError: the critic, the policy or its value network diverges.
    """
    config = training.config
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + iteration)
    tracks, figures = collect(data.train, training.policy, config, iteration)
    pairs = driven_pairs(tracks)
    training.replay = [*training.replay, pairs][-config.critic.replay :]
    driven = torch.cat(training.replay)
    distance = update_wasserstein(
        training.critic, training.critic_optimiser, recorded, driven, config.critic, generator
    )
    with torch.no_grad():
        passing = training.critic(pairs)[:, 0].double().numpy()
    penalty = np.concatenate([track.penalty for track in tracks])
    scaled = (passing - passing.mean()) / (passing.std() + 1e-6)
    update = training.improve(tracks, scaled + config.augmentation * penalty, generator)
    figures |= {"fault": float((-penalty).mean()), "critic_distance": distance}
    return figures | update | {"deviation": float(training.policy.std().detach().mean())}


def driven_pairs(tracks: list[Track]) -> Tensor:
    """Returns observations and executed actions side by side (m, SIZE + 2), as the critic sees them."""
    rows = [np.concatenate([track.observation[:-1], track.executed], axis=1) for track in tracks]
    return tensor(np.concatenate(rows))


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train imitation``."""
    return training_parser("train imitation", __doc__, "config/gail.yaml")


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train imitation``."""
    arguments = parser().parse_args(argv)
    config = read_yaml(arguments.config, ImitationTraining)
    with training_program(arguments):
        training = run(config, arguments.out, resume=arguments.resume)
    print(f"best validation score {training.best:.4f}: {arguments.out / BEST}; curves: {arguments.out / CURVES}")
