"""How many steps of vehicles the environments make in a second of one core.

    ./litsim exec python benchmarks/environments/step_rate.py [--scenario demo]

Vehicles go on along their lanes with drawn accelerations. Prints a table in Markdown: the rate of each environment, by
the time that the processor has worked, beginnings of runs included, of the best of three rounds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from litsim_sim.cli.program import program

NAME = "litsim_research.gym:litsim/{}"
ROUNDS = 3
VECTORS = ((8, 8), (64, 8), (64, 16), (128, 16))
"""Numbers of vehicles, and of vehicles in each run."""
RADIUS = 80.0  # [m] from the ego within which they are, so that there are sixteen


def single(name: str, scenario: str) -> Callable[[int], int]:
    """Returns what makes a number of steps in an environment for one vehicle, and returns this number."""
    environment, random = gymnasium.make(NAME.format(name), scenario=scenario), np.random.default_rng(0)
    environment.reset(seed=0)

    def run(steps: int) -> int:
        for _ in range(steps):
            _, _, terminated, truncated, _ = environment.step(_actions(random, environment.action_space.shape))
            if terminated or truncated:
                environment.reset()
        return steps

    return run


def together(vehicles: int, in_each: int, scenario: str) -> Callable[[int], int]:
    """Returns what makes a number of steps of the vectorised environment, and returns the number of all vehicles'."""
    options: dict[str, Any] = {"scenario": scenario, "vehicles": in_each, "radius": RADIUS}
    environment, random = gymnasium.make_vec(NAME.format("Takeover-v0"), vehicles, **options), np.random.default_rng(0)
    environment.reset(seed=0)

    def run(steps: int) -> int:
        for _ in range(steps):
            environment.step(_actions(random, environment.action_space.shape))
        return steps * vehicles

    return run


def rate(run: Callable[[int], int], steps: int) -> float:
    """Returns the steps of vehicles per second of the processor, the best of ROUNDS."""
    rates = []
    for _ in range(ROUNDS):
        begin = time.process_time()
        rates.append(run(steps) / (time.process_time() - begin))
    return max(rates)


def _actions(random: np.random.Generator, shape: tuple[int, ...] | None) -> np.ndarray:
    assert shape is not None
    actions = np.zeros(shape, np.float32)
    actions[..., 0] = random.normal(0.0, 0.2, shape[:-1]).clip(-1.0, 1.0)
    return actions


@program
def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--scenario", default="demo", help="default: demo")
    scenario = parser.parse_args().scenario
    rates = {f"`{name}`, one": rate(single(name, scenario), 200) for name in ("Takeover-v0", "Ego-v0")}
    for vehicles, in_each in VECTORS:
        label = f"`Takeover-v0`, {vehicles} vehicles, {in_each} in each run"
        rates[label] = rate(together(vehicles, in_each, scenario), 150)
    print("| environment | steps of vehicles per second of one core |\n|---|---:|")
    for label, value in rates.items():
        print(f"| {label} | {value:.0f} |")
    return 0


if __name__ == "__main__":
    main()
