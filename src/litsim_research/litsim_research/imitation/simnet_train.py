"""`train_simnet`: train the baseline SimNet, by regression on the future poses of recorded agents.

1. Scenarios: those on which policy C is trained and validated.
2. Batches: some agents at some moments, half of them displaced, each with a raster and its poses in the next 1.2 s.
3. Loss: mean squared error of all outputs, each in its own unit; Adam with a cosine schedule of the learning rate.

Every batch draws from a generator seeded by the run's seed and the batch's number, so that a resumed run gives the same
weights. The folder `--out` gets checkpoint.pt, history.json, curves.png, and best.safetensors or best.onnx.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from tqdm import tqdm

from litsim_research.baselines.simnet.output import FUTURE
from litsim_research.imitation.simnet_data import Moments, PerturbationConfig, Samples
from litsim_research.imitation.simnet_network import SimNet, save
from litsim_research.policies.checkpoint import CURVES, HISTORY, write_history
from litsim_research.policies.data import DataConfig, TrainingData, described, prepare
from litsim_research.policies.plots import SIMNET_PANELS
from litsim_research.policies.ppo import refuse_divergence
from litsim_research.policies.training_program import training_parser, training_program
from litsim_research.predictors.checkpoint import CHECKPOINT, ResumableTraining
from litsim_research.predictors.device import check_device
from litsim_research.predictors.training.curves import plot_curves
from litsim_sim.cli.program import program
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.scenario import Scenario

SCALES = 256  # moments from which the mean and the spread of the outputs are estimated
MIDDLE, VALIDATION = 1, 2  # seeds of the draws for these, and for validation; batches have 0


class SimnetConfig(BaseModel):
    """A training run; the YAML file has these fields.

    Attributes:
        seed: of everything random.
        batches: updates of the network.
        moments, agents: number of moments in a batch, and most agents of each moment.
        learning_rate: of Adam initially; it falls to zero along a cosine.
        validate_every: batches between validations.
        validation_moments: moments in a validation.
        data: `real_weight` is the weight of an agent of a real window, relative to one of generated traffic.
        perturbation: displacement of the agents.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(0, ge=0, lt=2**32)
    batches: int = Field(10_000, gt=0)
    moments: int = Field(16, gt=0)
    agents: int = Field(8, gt=0)
    learning_rate: float = Field(1e-3, gt=0)
    validate_every: int = Field(500, gt=0)
    validation_moments: int = Field(128, gt=0)
    data: DataConfig
    perturbation: PerturbationConfig = PerturbationConfig()


class SimnetTraining(ResumableTraining):
    """The state of a training of SimNet on a `device` of torch, and its files; `history` is of the validations.

    Attributes:
        network: the network.
        done: number of batches done.
    """

    config: SimnetConfig
    parts, more, length = ("network", "optimiser"), ("history", "done"), "batches"

    def __init__(self, config: SimnetConfig, data: TrainingData, device: str = "cpu") -> None:
        self.data, self.history = described(data), []
        torch.manual_seed(config.seed)
        self.config, self.network, self.device = config, SimNet().to(device), device
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = torch.optim.Adam(self.network.parameters(), config.learning_rate)
        self.done = 0

    @property
    def best(self) -> float:
        """Lowest validation loss so far."""
        return min((entry["validation"] for entry in self.history), default=np.inf)

    def update(self, samples: Samples) -> float:
        """Make a step of the optimiser on one batch and return its loss."""
        rate = 0.5 * self.config.learning_rate * (1.0 + np.cos(np.pi * self.done / self.config.batches))
        for group in self.optimiser.param_groups:
            group["lr"] = float(rate)
        self.network.train()
        errors = self._errors(torch.from_numpy(samples.rasters), samples.futures)
        loss = ((errors / self.network.unit) ** 2).mean()
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        self.done += 1
        return float(loss.detach())

    @torch.no_grad()
    def validate(self, samples: Samples) -> dict[str, float]:
        """Loss, and errors of the first and last future pose [m], [rad]; `samples` are not used for training."""
        self.network.eval()
        part = self.config.moments * self.config.agents
        begins = range(0, len(samples.rasters), part)
        rasters, futures = torch.from_numpy(samples.rasters), samples.futures
        errors = torch.cat([self._errors(rasters[k : k + part], futures[k : k + part]) for k in begins])
        loss = float(((errors / self.network.unit) ** 2).mean())
        off = errors.reshape(-1, FUTURE, 3).cpu().numpy()
        return {
            "validation": loss,
            "ahead_first": float(np.sqrt((off[:, 0, 0] ** 2).mean())),
            "turn_first": float(np.sqrt((off[:, 0, 2] ** 2).mean())),
            "away_last": float(np.hypot(off[:, -1, 0], off[:, -1, 1]).mean()),
        }

    def _errors(self, rasters: Tensor, futures: FloatArray) -> Tensor:
        """Returns errors (b, OUTPUTS) of the network [m], [rad]."""
        outputs = self.network.physical(rasters.to(self.device))
        return outputs - torch.from_numpy(futures).float().to(self.device)

    def write(self, out: Path) -> None:
        """Write the weights if the last validation was the best, a checkpoint, the history and its curves.

        The checkpoint comes after the weights, so that a training that is resumed has those of its best validation.

        Raises:
            Unwritable: a file cannot be written; those before it are kept.
        """
        last = self.history[-1]
        if last["validation"] <= self.best:
            about = {"config": self.config.model_dump_json(), "figures": json.dumps(last)}
            save(self.network, self.weights(out), about)
        self.keep(out)
        write_history(self.history, out / HISTORY)
        plot_curves(self.history, out / CURVES, SIMNET_PANELS, along="batches", log=True)

    def weights(self, out: Path) -> Path:
        """File of the best weights in the folder `out`."""
        return out / "best.safetensors"


def run(
    config: SimnetConfig, out: Path, *, resume: bool = False, progress: bool = True, device: str = "cpu"
) -> SimnetTraining:
    """Train on a `device` of torch, from the start or from the checkpoint in `out`.

    Raises:
        InputError: the data or the checkpoint cannot be used, or the training diverges.
    """
    out.mkdir(parents=True, exist_ok=True)
    data = prepare(config.data, out / "data")
    training = SimnetTraining(config, data, device)
    train = Moments(*_counted(data.train), config.perturbation)
    held_out = Moments(*_counted(data.validation), config.perturbation)
    if resume:
        training.read(out / CHECKPOINT)
    else:
        some = train.draw(SCALES, config.agents, np.random.default_rng([config.seed, MIDDLE]), painted=False)
        training.network.scale_to(some.futures, some.units)
    validation = held_out.draw(
        config.validation_moments, config.agents, np.random.default_rng([config.seed, VALIDATION])
    )
    losses: list[float] = []
    begin = time.perf_counter()
    with tqdm(total=config.batches, initial=training.done, unit="batch", disable=not progress) as bar:
        while training.done < config.batches:
            random = np.random.default_rng([config.seed, 0, training.done])
            losses.append(training.update(train.draw(config.moments, config.agents, random)))
            bar.update()
            if training.done % config.validate_every == 0 or training.done == config.batches:
                refuse_divergence(training.network, "learning_rate", config.learning_rate)
                found = training.validate(validation)
                seconds = time.perf_counter() - begin
                training.history.append(
                    {"batches": training.done, "training": float(np.mean(losses)), **found, "seconds": seconds}
                )
                losses, begin = [], time.perf_counter()
                training.write(out)
                bar.set_postfix({"validation": f"{found['validation']:.4f}", "1.2 s": f"{found['away_last']:.2f} m"})
    return training


def _counted(scenarios: tuple[Scenario, ...]) -> tuple[list[Scenario], list[float]]:
    """Each of `scenarios` once, and how often it occurs."""
    once = {id(scenario): scenario for scenario in scenarios}
    return list(once.values()), [float(sum(id(given) == key for given in scenarios)) for key in once]


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_research train simnet``."""
    p = training_parser("train simnet", __doc__, "config/simnet.yaml")
    p.add_argument("--device", default="cpu", help="device of torch, such as cpu, cuda or cuda:1; default %(default)s")
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_research train simnet``."""
    arguments: Any = parser().parse_args(argv)
    check_device(arguments.device)
    config = read_yaml(arguments.config, SimnetConfig)
    with training_program(arguments):
        training = run(config, arguments.out, resume=arguments.resume, device=arguments.device)
    print(f"best validation loss {training.best:.4f}: {training.weights(arguments.out)}")


if __name__ == "__main__":
    main()
