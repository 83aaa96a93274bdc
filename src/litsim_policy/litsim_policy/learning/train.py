"""`train`: policy C from recorded drivers, by a critic and PPO (paper, section III-C). Read it from top to bottom.

1. Scenarios: generated segments and real windows, none of which results are reported on.
2. Experts: observations and actions of the recorded drivers in them.
3. Warm start: the policy learns to do as they did, and to come back to its path when it is displaced.
4. Iterations: drive episodes; teach the critic to tell drivers from policy; reward the policy for passing as a driver,
   punish it for collisions and the like; PPO.

Every iteration draws from generators seeded by the run's seed and its number, so a run that is resumed goes on as if it
had not been interrupted. `--out` gets checkpoint.pt, history.json, curves.png, last.safetensors and best.safetensors.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from tqdm import tqdm

from litsim_policy.driving.observation import ObservationConfig
from litsim_policy.learning.critic import Critic, CriticConfig, update_critic
from litsim_policy.learning.data import DataConfig, prepare
from litsim_policy.learning.environment import NOBODY, EnvironmentConfig, PolicyEnvironment
from litsim_policy.learning.expert import ExpertConfig, ExpertPairs, expert_pairs
from litsim_policy.learning.network import GaussianPolicy, driving_network, multilayer, save
from litsim_policy.learning.plots import plot_curves
from litsim_policy.learning.ppo import (
    Demonstrations,
    PpoConfig,
    Track,
    executed_pairs,
    make_batch,
    tensor,
    update_policy,
)
from litsim_policy.learning.reward import PenaltyConfig
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_yaml

CHECKPOINT, HISTORY, CURVES, LAST, BEST = (
    "checkpoint.pt",
    "history.json",
    "curves.png",
    "last.safetensors",
    "best.safetensors",
)


class WarmStart(BaseModel):
    """Behaviour cloning before the first iteration; no epochs leave it out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    epochs: int = Field(30, ge=0)
    batch: int = Field(256, gt=0)
    learning_rate: float = Field(1e-3, gt=0)


class TrainConfig(BaseModel):
    """A training run; the YAML file has these fields, and those of the parts in sections of their names.

    Attributes:
        seed: of everything random.
        iterations: updates of the policy.
        transitions: agent-steps that an iteration collects at least.
        critic_reward: weight of the critic's reward, which is brought to mean 0 and standard deviation 1.
        validate_every: iterations between validations.
        validation_episodes: episodes of one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: int = Field(0, ge=0)
    iterations: int = Field(200, gt=0)
    transitions: int = Field(3072, gt=0)
    critic_reward: float = Field(0.3, ge=0)
    validate_every: int = Field(20, gt=0)
    validation_episodes: int = Field(20, gt=0)
    data: DataConfig
    observation: ObservationConfig = ObservationConfig()
    environment: EnvironmentConfig = EnvironmentConfig()
    penalty: PenaltyConfig = PenaltyConfig()
    expert: ExpertConfig = ExpertConfig()
    warm_start: WarmStart = WarmStart()  # type: ignore[call-arg]
    critic: CriticConfig = CriticConfig()
    ppo: PpoConfig = PpoConfig()


class Training:
    """Networks, optimisers and history of a run."""

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
        """History, curves and weights."""
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
        """Where weights come from, for their metadata."""
        config = self.config.model_dump_json()
        return {"seed": str(self.config.seed), "iterations": str(len(self.history)), "config": config}


def run(config: TrainConfig, out: Path, *, resume: bool = False, progress: bool = True) -> Training:
    """Train, from the start or from the checkpoint in `out`.

    Raises:
        InputError: the data or the checkpoint cannot be used.
    """
    out.mkdir(parents=True, exist_ok=True)
    data = prepare(config.data, out / "data")
    training = Training(config)
    if resume:
        training.read(out / CHECKPOINT)
    parts = (config.environment, config.observation, config.penalty)
    environment, validation = PolicyEnvironment(data.train, *parts), PolicyEnvironment(data.validation, *parts)
    random = np.random.default_rng([config.seed, 1])
    each_once = list({scenario.name: scenario for scenario in data.train}.values())
    experts = expert_pairs(each_once, config.observation, config.expert, random)
    expert = tensor(np.concatenate([experts.observation, experts.action], axis=1))
    shown = demonstrations(experts)
    if not training.history:
        _warm_start(training.policy, shown, config)
    with tqdm(total=config.iterations, initial=len(training.history), unit="iteration", disable=not progress) as bar:
        for iteration in range(len(training.history), config.iterations):
            begin = time.perf_counter()
            found = _iterate(training, environment, expert, shown, iteration)
            last = iteration == config.iterations - 1
            if iteration % config.validate_every == 0 or last:
                found |= validate(training.policy, validation, config)
            training.history.append(found | {"seconds": time.perf_counter() - begin})
            if found.get("validation_score", -np.inf) > training.best:
                training.best = found["validation_score"]
                save(training.policy, out / BEST, training.about)
            training.keep(out)
            if iteration % config.validate_every == 0 or last:
                training.write(out)
            bar.set_postfix({"penalty": f"{found['penalty']:.3f}", "collisions/1000": f"{found['collisions']:.2f}"})
            bar.update()
    return training


def _iterate(
    training: Training,
    environment: PolicyEnvironment,
    expert: Tensor,
    shown: Demonstrations,
    iteration: int,
) -> dict[str, float]:
    """Drive, teach the critic, reward, update the policy; returns what was seen."""
    config = training.config
    generator = torch.Generator().manual_seed(config.seed * 1_000_003 + iteration)
    tracks, counts = collect(environment, training.policy, config, iteration, generator)
    pairs = executed_pairs(tracks)
    critic = update_critic(training.critic, training.critic_optimiser, expert, pairs, config.critic, generator)
    human = training.critic.reward(pairs, config.critic.reward_limit).double().numpy()
    scaled = config.critic_reward * (human - human.mean()) / (human.std() + 1e-6)
    ends = np.cumsum([len(track) for track in tracks])
    rewards = [part + track.penalty for part, track in zip(np.split(scaled, ends[:-1]), tracks, strict=True)]
    batch = make_batch(tracks, rewards, training.value, config.ppo)
    step = update_policy(
        training.policy,
        training.value,
        training.policy_optimiser,
        batch,
        config.ppo,
        generator,
        shown,
        value_only=iteration < config.ppo.value_first,
    )
    return counts | {
        "critic_reward": float(human.mean()),
        "critic_accuracy": critic.accuracy,
        "critic_loss": critic.loss,
        "value_loss": step.value_loss,
        "divergence": step.divergence,
        "clipped": step.clipped,
        "deviation": float(torch.exp(training.policy.log_std.detach()).mean()),
    }


def collect(
    environment: PolicyEnvironment,
    policy: GaussianPolicy,
    config: TrainConfig,
    iteration: int,
    generator: torch.Generator,
) -> tuple[list[Track], dict[str, float]]:
    """Whole episodes until there are enough transitions: the tracks of all agents, and how often what happened."""
    tracks: list[Track] = []
    sums: dict[str, float] = defaultdict(float)
    episode = 0
    while sums["transitions"] < config.transitions:
        seed = int(np.random.SeedSequence([config.seed, iteration, episode]).generate_state(1)[0])
        tracks += drive(environment, policy, seed, sums, generator)
        episode += 1
    return tracks, _rates(sums, episode)


def drive(
    environment: PolicyEnvironment,
    policy: GaussianPolicy,
    seed: int,
    sums: dict[str, float],
    generator: torch.Generator | None,
) -> list[Track]:
    """One episode; what happens is added to `sums`. Without a generator the policy drives by its mean."""
    tracks: list[Track] = []
    open_tracks: dict[int, list[tuple[np.ndarray, ...]]] = defaultdict(list)
    observation, info = environment.reset(seed=seed)
    over = not (info["agents"] != NOBODY).any()
    while not over:
        present = info["agents"] != NOBODY
        seen = tensor(observation[present])
        if generator is None:
            with torch.no_grad():
                raw = policy(seen)
                density = policy.log_probability(seen, raw)
        else:
            raw, density = policy.sample(seen, generator)
        action = np.zeros(environment.action_space.shape or ())
        action[present] = torch.tanh(raw).double().numpy()
        before = observation[present]
        observation, _, terminated, truncated, info = environment.step(action)
        outcome = info["outcome"]
        for k, agent in enumerate(outcome.agents.tolist()):
            step = (before[k], raw[k].numpy(), density[k].numpy(), outcome.executed[k], outcome.penalty[k])
            open_tracks[agent].append(step)
            if not outcome.driven_on[k]:
                ended = bool(outcome.terminated[k])
                tracks.append(_track(open_tracks.pop(agent), outcome.following[k], terminated=ended))
        terms = outcome.terms
        sums["transitions"] += len(outcome.agents)
        sums["penalty"] += float(outcome.penalty.sum())
        for name in ("collision", "off_road", "edge", "proximity", "hard_brake", "guard"):
            sums[name] += float(getattr(terms, name).sum())
        over = terminated or truncated or not (info["agents"] != NOBODY).any()
    return tracks


def validate(policy: GaussianPolicy, environment: PolicyEnvironment, config: TrainConfig) -> dict[str, float]:
    """Episodes that are the same each time, driven by the mean; the score is the mean penalty of an agent-step."""
    sums: dict[str, float] = defaultdict(float)
    for episode in range(config.validation_episodes):
        drive(environment, policy, 10_000_019 + episode, sums, None)
    rates = _rates(sums, config.validation_episodes)
    wanted = ("penalty", "collisions", "off_road", "hard_brake", "guard", "collided_share")
    found = {f"validation_{name}": rates[name] for name in wanted}
    return found | {"validation_score": rates["penalty"]}


def _rates(sums: dict[str, float], episodes: int) -> dict[str, float]:
    """Per agent-step, events per 1000 of them, and the share of episodes that ended in a collision."""
    count = max(sums["transitions"], 1.0)
    return {
        "transitions": sums["transitions"],
        "episodes": float(episodes),
        "penalty": sums["penalty"] / count,
        "collisions": 1000.0 * sums["collision"] / count,
        "collided_share": sums["collision"] / episodes,
        "off_road": 1000.0 * sums["off_road"] / count,
        "edge": sums["edge"] / count,
        "proximity": sums["proximity"] / count,
        "hard_brake": sums["hard_brake"] / count,
        "guard": sums["guard"] / count,
    }


def _track(steps: list[tuple[np.ndarray, ...]], following: np.ndarray, *, terminated: bool) -> Track:
    observation, raw, density, executed, penalty = (np.array(column) for column in zip(*steps, strict=True))
    return Track(np.concatenate([observation, following[None]]), raw, density, executed, penalty, terminated)


def demonstrations(experts: ExpertPairs) -> Demonstrations:
    """What drivers did, and how displaced vehicles come back to their paths."""
    return Demonstrations(
        tensor(np.concatenate([experts.observation, experts.displaced])),
        tensor(np.concatenate([experts.action, experts.correction])),
    )


def _warm_start(policy: GaussianPolicy, shown: Demonstrations, config: TrainConfig) -> None:
    """Behaviour cloning of the mean action."""
    generator = torch.Generator().manual_seed(config.seed)
    optimiser = torch.optim.Adam(policy.parameters(), config.warm_start.learning_rate)
    for _ in range(config.warm_start.epochs):
        for chosen in torch.randperm(len(shown.action), generator=generator).split(config.warm_start.batch):
            loss = shown.error(policy, chosen)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_policy train``."""
    p = argparse.ArgumentParser(prog="train", description=(__doc__ or "").splitlines()[0])
    p.add_argument("--config", type=Path, required=True, help="YAML file, such as config/policy_c.yaml")
    p.add_argument("--out", type=Path, required=True, help="folder of the results")
    p.add_argument("--resume", action="store_true", help="go on from the checkpoint in --out")
    p.add_argument("--threads", type=int, default=1, help="of torch; default %(default)s")
    return p


def main() -> None:
    """Entry point of ``ros2 run litsim_policy train``."""
    arguments = parser().parse_args()
    torch.set_num_threads(arguments.threads)
    try:
        config = read_yaml(arguments.config, TrainConfig)
        training = run(config, arguments.out, resume=arguments.resume)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print(f"\ninterrupted; to go on: --resume with --out {arguments.out}", file=sys.stderr)
        sys.exit(130)
    driving_network(training.policy)
    print(f"best validation score {training.best:.4f}: {arguments.out / BEST}; curves: {arguments.out / CURVES}")


if __name__ == "__main__":
    main()
