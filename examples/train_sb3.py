"""Trains a driver of the background with stable-baselines3, in `litsim/Takeover-v0`; without ROS and a workspace.

    python3.11 -m venv sb3 && sb3/bin/pip install ".[train]" stable-baselines3
    sb3/bin/python examples/train_sb3.py --steps 20000

prints the mean reward of an episode before and after, and how many of the episodes end in a collision or off the road.
"""

from __future__ import annotations

import argparse

import gymnasium
from stable_baselines3 import PPO

ENVIRONMENT = "litsim_research.gym:litsim/Takeover-v0"
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


def main() -> None:
    """Train, and test before and after."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--scenario", nargs="+", default=["demo"], help="names, or YAML files; default: demo")
    parser.add_argument("--steps", type=int, default=20_000, help="steps of the training; default: 20000")
    parser.add_argument("--episodes", type=int, default=30, help="episodes of each test; default: 30")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="keep the trained policy in this file")
    arguments = parser.parse_args()

    environment, test = (gymnasium.make(ENVIRONMENT, scenario=arguments.scenario) for _ in range(2))
    noise = {"log_std_init": -1.0}  # an action of 1 is full braking: a deviation of 1 would be no driving at all
    model = PPO("MlpPolicy", environment, n_steps=1024, gamma=0.97, policy_kwargs=noise, seed=arguments.seed)
    print(f"before: {tested(model, test, arguments.episodes)}", flush=True)
    model.learn(arguments.steps)
    print(f"after {model.num_timesteps} steps: {tested(model, test, arguments.episodes)}")
    if arguments.out:
        model.save(arguments.out)


if __name__ == "__main__":
    main()
