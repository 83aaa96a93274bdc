"""`train`: train policy C on recorded drivers, with a critic and PPO (paper, section III-C).

1. Scenarios: generated segments and real windows, on none of which results are reported.
2. Experts: observations and actions of the recorded drivers in them.
3. Warm start: behaviour cloning of these drivers, and of the way back to the path from displaced poses.
4. Iterations: drive episodes; train the critic on drivers and on the states and actions of these episodes; reward the
   policy by the critic, less penalties for collisions and the like; update it by PPO.

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
from tqdm import tqdm

from litsim_research.policies.checkpoint import BEST, CURVES, Training
from litsim_research.policies.config import TrainConfig
from litsim_research.policies.critic import driven_pairs, expert_pairs_of, update_critic
from litsim_research.policies.data import TrainingData, prepare
from litsim_research.policies.expert import expert_pairs
from litsim_research.policies.network import driving_network
from litsim_research.policies.ppo import Demonstrations
from litsim_research.policies.rollout import Driving, collect, drawn_episodes, validate
from litsim_research.policies.rollout_pool import rollouts
from litsim_research.policies.training_program import training_parser, training_program
from litsim_research.policies.warm_start import clone
from litsim_research.predictors.checkpoint import CHECKPOINT
from litsim_sim.cli.program import at_least_one, program
from litsim_sim.io.yaml_input import read_yaml


def run(config: TrainConfig, out: Path, *, resume: bool = False, progress: bool = True, processes: int = 1) -> Training:
    """Train, from the start or from the checkpoint in `out`; the number of `processes` does not change the weights.

    Raises:
        InputError: the data or the checkpoint cannot be used, or the training diverges.
    """
    out.mkdir(parents=True, exist_ok=True)
    data = prepare(config.data, out / "data")
    training = Training(config, data)
    if resume:
        training.read(out / CHECKPOINT)
    with rollouts(data, config, processes) as (driving, validation):
        _train(training, data, driving, validation, out, progress=progress)
    return training


def _train(
    training: Training, data: TrainingData, driving: Driving, validation: Driving, out: Path, *, progress: bool
) -> None:
    """Make the warm start, unless `training` is resumed; then the remaining iterations."""
    config = training.config
    random = np.random.default_rng([config.seed, 1])
    experts = expert_pairs(
        data.each_once, config.observation, config.expert, config.task, random, data.real, data.reported
    )
    recorded, shown = experts.demonstrations(config.expert.real_share)
    if not training.history:
        clone(training.policy, shown, config.warm_start, config.seed, shown.error)
    with tqdm(total=config.iterations, initial=len(training.history), unit="iteration", disable=not progress) as bar:
        for iteration in range(len(training.history), config.iterations):
            started = time.perf_counter()
            figures = _iterate(training, driving, recorded, shown, iteration)
            if iteration % config.validate_every == 0 or iteration == config.iterations - 1:
                figures |= validate(validation, training.policy, config)
            training.note(figures | {"seconds": time.perf_counter() - started}, out)
            bar.set_postfix({"penalty": f"{figures['penalty']:.3f}", "collisions/1000": f"{figures['collisions']:.2f}"})
            bar.update()


def _iterate(
    training: Training,
    driving: Driving,
    recorded: Demonstrations,
    shown: Demonstrations,
    iteration: int,
) -> dict[str, float]:
    """Make one iteration: drive episodes, train the critic on `recorded`, reward, and update the policy.

    The update also keeps the policy near the demonstrations `shown`.

    Returns:
        entry of the history: rates of :func:`litsim_research.policies.rollout.collect`, means of critic and update.

    Raises:
        InputError: the critic, the policy or its value network diverges.
    """
    config = training.config
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + iteration)
    tracks, counts = collect(drawn_episodes(driving, training.policy, config, training.history))
    driven = driven_pairs(tracks, config.observation)
    comparable = driven[np.repeat([track.recorded for track in tracks], [len(track) for track in tracks])]
    own = comparable if len(comparable) else driven
    expert = expert_pairs_of(recorded, len(own), training.policy.std(), config.observation, generator)
    critic = update_critic(training.critic, training.critic_optimiser, expert, own, config.critic, generator)
    logit = training.critic.reward(driven, config.critic.reward_limit).double().numpy()
    judged = config.critic_reward * (logit - logit.mean()) / max(logit.std(), 1.0)  # never amplified
    reward = judged + np.concatenate([track.penalty for track in tracks])
    critic["critic_reward"] = float(logit.mean())
    update = training.improve(tracks, reward, generator, shown)
    return counts | critic | update | {"deviation": float(torch.exp(training.policy.log_std.detach()).mean())}


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train policy``."""
    p = training_parser("train policy", __doc__, "configs/policies/critic.yaml")
    p.add_argument("--processes", type=at_least_one, default=2, help="processes for the episodes; default %(default)s")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train policy``."""
    arguments = parser().parse_args(argv)
    config = read_yaml(arguments.config, TrainConfig)
    with training_program(arguments):
        training = run(config, arguments.out, resume=arguments.resume, processes=arguments.processes)
    driving_network(training.policy)
    print(f"best validation score {training.best:.4f}: {arguments.out / BEST}; curves: {arguments.out / CURVES}")


if __name__ == "__main__":
    main()
