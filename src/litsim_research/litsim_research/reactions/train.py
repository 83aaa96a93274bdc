"""`train reactions`: the density of people's changes of speed, from the car-following pairs of I-80 in LITSIM_DATA.

The networks are fitted to the tuning part of the recorded followers, each from another seed; a tenth of these followers
tells how well. No follower of the reported part is read, and no other file: in those, the acceleration of leaders is
mostly noise, from which a network learns that it does not matter.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from litsim_data.encounters.following import FollowingTrack, pairs
from litsim_policy.motion.speed_change import FORMAT, GAUSSIANS, HIDDEN, INPUTS, LAYERS, LOG_SPREAD_MAX, LOG_SPREAD_MIN
from litsim_research.predictors.checkpoint import save_weights
from litsim_research.reactions.samples import Samples, samples_of
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import at_least_one, program
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import DATA_VARIABLE

STEPS, BATCH, RATE, DECAY = 1500, 1024, 6e-3, 1e-3  # of AdamW with one cycle of the learning rate
HELD_BACK = 0.1  # share of the tuning followers that are not fitted to
WEIGHTS = "speed_change.safetensors"


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train reactions``."""
    p = Parser(prog="train reactions", description=__doc__)
    p.add_argument("--out", type=Path, required=True, metavar="FOLDER", help=f"folder of {WEIGHTS}")
    p.add_argument("--networks", type=at_least_one, default=4, metavar="N", help="number of networks (default: 4)")
    p.add_argument("--steps", type=at_least_one, default=STEPS, metavar="N", help=f"of each (default: {STEPS})")
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of the first network (default: 0)")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train reactions``."""
    arguments = parser().parse_args(argv)
    data = os.environ.get(DATA_VARIABLE)
    if not data:
        raise InputError(f"train reactions: needs recorded car following: set {DATA_VARIABLE} to the folder of ngsim/")
    tracks = [track for track in pairs(Path(data).expanduser()) if track.split == "tuning"]
    fitted, held_back = parted(tracks)
    train, test = samples_of(fitted), samples_of(held_back)
    print(f"{len(train)} samples of {len(fitted)} tracks; held back: {len(test)} of {len(held_back)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    networks = []
    for seed in range(arguments.seed, arguments.seed + arguments.networks):
        networks.append(fit(train, arguments.steps, seed))
        print(f"seed {seed}: negative log-likelihood {mean_loss(networks[-1:], test):.4f} held back", flush=True)
    print(f"together: {mean_loss(networks, test):.4f}; one Gaussian: {gaussian_loss(train, test):.4f}")
    save(networks, arguments.out / WEIGHTS, {"seed": str(arguments.seed), "steps": str(arguments.steps)})
    print(arguments.out / WEIGHTS)


def parted(tracks: list[FollowingTrack]) -> tuple[list[FollowingTrack], list[FollowingTrack]]:
    """Returns the tracks to fit to, and those of HELD_BACK of the followers."""
    drivers = sorted({(track.site, track.period, track.follower) for track in tracks})
    random = np.random.default_rng(0)
    apart = {driver for driver in drivers if random.random() < HELD_BACK}
    parts: tuple[list[FollowingTrack], list[FollowingTrack]] = [], []
    for track in tracks:
        parts[(track.site, track.period, track.follower) in apart].append(track)
    return parts


def fit(samples: Samples, steps: int, seed: int) -> nn.Sequential:
    """Returns a network fitted to `samples` by maximum likelihood."""
    torch.manual_seed(seed)
    random = np.random.default_rng(seed)
    features, change = _tensors(samples)
    network = nn.Sequential(
        nn.Linear(INPUTS, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, HIDDEN), nn.Tanh(), nn.Linear(HIDDEN, 3 * GAUSSIANS)
    )
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    for _ in range(steps):
        batch = torch.from_numpy(random.integers(len(change), size=BATCH))
        optimizer.zero_grad()
        (-log_density(network(features[batch]), change[batch]).mean()).backward()
        optimizer.step()
        schedule.step()
    return network


def log_density(mixture: Tensor, change: Tensor) -> Tensor:
    """Returns log-densities (n,) of changes (n,) [m/s] by mixtures (n, 3 GAUSSIANS): logits, means, log-spreads."""
    logit, mean, spread = mixture.split(GAUSSIANS, 1)
    spread = spread.clamp(LOG_SPREAD_MIN, LOG_SPREAD_MAX)
    score = (change[:, None] - mean) / spread.exp()
    constant = 0.5 * np.log(2.0 * np.pi)
    return torch.logsumexp(torch.log_softmax(logit, 1) - spread - 0.5 * score**2 - constant, 1)


def mean_loss(networks: list[nn.Sequential], samples: Samples) -> float:
    """Returns the mean negative log-likelihood of `samples` by the mean density of `networks`."""
    features, change = _tensors(samples)
    with torch.no_grad():
        densities = torch.stack([log_density(network(features), change) for network in networks])
    return -float((torch.logsumexp(densities, 0) - np.log(len(networks))).mean())


def gaussian_loss(train: Samples, test: Samples) -> float:
    """Returns the mean negative log-likelihood of `test` by one Gaussian of all changes in `train`."""
    mean, spread = train.change.mean(), train.change.std()
    return float((0.5 * ((test.change - mean) / spread) ** 2 + np.log(spread) + 0.5 * np.log(2.0 * np.pi)).mean())


def save(networks: list[nn.Sequential], path: Path, about: dict[str, str]) -> None:
    """Write `networks` as :mod:`litsim_policy.motion.speed_change` reads them, with `about` on their origin."""
    tensors: dict[str, Tensor] = {}
    states = [network.state_dict() for network in networks]
    for layer, number in zip(LAYERS, (0, 2, 4), strict=True):
        tensors[f"{layer}.weight"] = torch.stack([state[f"{number}.weight"].T for state in states])
        tensors[f"{layer}.bias"] = torch.stack([state[f"{number}.bias"] for state in states])
    save_weights(tensors, {"format": FORMAT, **about}, path)


def _tensors(samples: Samples) -> tuple[Tensor, Tensor]:
    """Returns features and changes in single precision."""
    return torch.from_numpy(samples.features).float(), torch.from_numpy(samples.change).float()
