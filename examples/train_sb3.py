"""Trains a driver of the background or of the ego with stable-baselines3; without ROS and a workspace.

    python3.11 -m venv sb3 && sb3/bin/pip install ".[train]" stable-baselines3
    sb3/bin/python examples/train_sb3.py --steps 20000 --onnx agents.onnx
    sb3/bin/python examples/train_sb3.py --environment Ego-v0 --onnx ego.onnx

prints the mean reward of an episode before and after, and how many of the episodes end in a collision or off the road.
What it exports drives in runs and campaigns: docs/training.md.
"""

from __future__ import annotations

import argparse
import warnings

import gymnasium
import torch
from stable_baselines3 import PPO

ENVIRONMENTS = ("Takeover-v0", "Ego-v0")
TEST_SEED = 1_000_000  # the first of the episodes that are tested on, beyond those that are trained on


def tested(model: PPO, environment: gymnasium.Env, episodes: int) -> str:
    """Drive `episodes` by the mean of the policy."""
    rewards, failures = 0.0, 0
    for episode in range(episodes):
        observation, _ = environment.reset(seed=TEST_SEED + episode)
        over = False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, _ = environment.step(action)
            rewards, failures, over = rewards + float(reward), failures + terminated, terminated or truncated
    return f"mean reward {rewards / episodes:.1f}, {failures} of {episodes} end in a collision or off the road"


class Mean(torch.nn.Module):
    """The mean action of a policy, for export."""

    def __init__(self, model: PPO) -> None:
        super().__init__()
        self.policy = model.policy.cpu().eval()

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Returns actions (m, actions) for observations (m, observed)."""
        actions: torch.Tensor = self.policy(observation, deterministic=True)[0]
        return actions


def export(model: PPO, path: str) -> None:
    """Write the policy to an ONNX file."""
    seen = torch.zeros(1, *model.observation_space.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the exporter that needs no package but onnx
        torch.onnx.export(Mean(model), (seen,), path, dynamo=False)


def main() -> None:
    """Train, and test before and after."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--environment", choices=ENVIRONMENTS, default=ENVIRONMENTS[0], help="default: %(default)s")
    parser.add_argument("--scenario", nargs="+", default=["demo"], help="names, or YAML files; default: demo")
    parser.add_argument("--steps", type=int, default=20_000, help="steps of the training; default: 20000")
    parser.add_argument("--episodes", type=int, default=30, help="episodes of each test; default: 30")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="keep the trained policy in this file")
    parser.add_argument("--onnx", help="export it to this ONNX file, for policy.weights or ego.weights")
    arguments = parser.parse_args()

    name = f"litsim_research.gym:litsim/{arguments.environment}"
    environment, test = (gymnasium.make(name, scenario=arguments.scenario) for _ in range(2))
    noise = {"log_std_init": -1.0}  # an action of 1 is full braking: a deviation of 1 would be no driving at all
    model = PPO("MlpPolicy", environment, n_steps=1024, gamma=0.97, policy_kwargs=noise, seed=arguments.seed)
    print(f"before: {tested(model, test, arguments.episodes)}", flush=True)
    model.learn(arguments.steps)
    print(f"after {model.num_timesteps} steps: {tested(model, test, arguments.episodes)}")
    if arguments.out:
        model.save(arguments.out)
    if arguments.onnx:
        export(model, arguments.onnx)


if __name__ == "__main__":
    main()
