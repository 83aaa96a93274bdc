"""Training of any learned predictor from one configuration; it is seeded, and can be resumed after every epoch."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import tqdm

from litsim_predictor.inference import SHIPPED
from litsim_predictor.inference.contract import AT_SECONDS, MANEUVERS, SECONDS
from litsim_predictor.inference.weights import Provenance, weights_path
from litsim_research.predictors.checkpoint import ResumableTraining
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.data.scenes import scene_batches, training_batches
from litsim_research.predictors.data.sources import digest_of, files_of
from litsim_research.predictors.evaluation.scores import best_of
from litsim_research.predictors.models.along_lanes import AlongLanes
from litsim_research.predictors.models.model import SceneModel, negative_log_likelihood
from litsim_research.predictors.models.registry import build
from litsim_research.predictors.models.weights import load_model, save_model
from litsim_research.predictors.training.config import TrainingConfig
from litsim_research.predictors.training.curves import PANELS, plot_curves
from litsim_research.predictors.training.data import Locator, load_parts, targets_of
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text

GRADIENT_LIMIT = 10.0
VALIDATION_STRIDE = 10  # frames between scenes
CURVES, HISTORY_FILE, WEIGHTS = "curves.png", "training.json", "weights.safetensors"


class Training(ResumableTraining):
    """One training, whose weights, checkpoint, curves and history are written to one folder.

    Args:
        config: configuration of the training.
        folder: existing folder to which everything is written.
        locate: see :class:`Locator`.
        command: command line that repeats the training, for the provenance.
        device: name of the torch device.
        workers: number of processes that make batches ahead, on which the result does not depend.
    """

    config: TrainingConfig
    more, length = ("history", "best", "random_state"), ""

    def __init__(
        self, config: TrainingConfig, folder: Path, locate: Locator, command: str, device: str, workers: int = 0
    ) -> None:
        self.config, self._folder, self._command, self.device = config, folder, command, device
        self.parts = ("model", "optimizer", "averaged") if config.averaging else ("model", "optimizer")
        self._workers = workers
        torch.manual_seed(config.seed)
        self.model = self._first_model(locate).to(device)
        self.averaged = (
            AveragedModel(self.model, multi_avg_fn=get_ema_multi_avg_fn(config.averaging)) if config.averaging else None
        )
        self._random = np.random.default_rng(config.seed)
        self.optimizer = torch.optim.AdamW(
            self.model.parameters(), config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self._parts = load_parts(config, locate)
        teacher_paths = [weights_path(name) if name in SHIPPED else locate(name) for name in config.teachers]
        self._teachers = [load_model(str(path))[0].to(device) for path in teacher_paths]
        names = [name for source in config.data for name in files_of(source)] + [config.start] * bool(config.start)
        self.data = {name: digest_of(locate(name)) for name in names}
        self.data |= {name: digest_of(path) for name, path in zip(config.teachers, teacher_paths, strict=True)}
        self._manifest = {"files": self.data, "rows": targets_of(self._parts)}
        self.history = []
        self.best: dict[str, float] = {}

    def run(self) -> None:
        """Train for the remaining epochs; after Ctrl-C the files of the completed epochs can be used and resumed from.

        Raises:
            InputError: the training diverges, or no vehicle for validation has a complete history and future.
        """
        bar = tqdm(total=self.config.epochs, initial=len(self.history), unit="epoch")
        with bar, suppress(KeyboardInterrupt):
            while len(self.history) < self.config.epochs:
                figures = self._epoch(len(self.history))
                if not np.isfinite(figures["val_nll"]):
                    raise InputError(
                        f"training configuration: field learning_rate is {self.config.learning_rate:g}, with which "
                        f"the likelihood is not finite after epoch {len(self.history) + 1}; expected a smaller one"
                    )
                self.history.append(figures)
                if not self.best or figures["val_nll"] <= self.best["val_nll"]:
                    self.best = figures
                    save_model(self._result, self._provenance(), self._folder / WEIGHTS)
                self._save()
                bar.update()
                bar.set_postfix({"val m": f"{figures['val_error']:.2f}", "5 s": f"{figures['val_rmse_5']:.2f}"})

    @property
    def random_state(self) -> dict[str, Any]:
        """States of all generators of random numbers."""
        gpu = torch.cuda.get_rng_state_all() if self.device.startswith("cuda") else []
        return {"numpy": json.dumps(self._random.bit_generator.state), "torch": torch.get_rng_state(), "gpu": gpu}

    @random_state.setter
    def random_state(self, state: dict[str, Any]) -> None:
        self._random.bit_generator.state = json.loads(state["numpy"])
        torch.set_rng_state(state["torch"].cpu())
        if self.device.startswith("cuda"):
            torch.cuda.set_rng_state_all([numbers.cpu() for numbers in state["gpu"]])

    def _first_model(self, locate: Locator) -> SceneModel:
        """Returns the model before the first epoch: with random weights, or with those of the file `start`."""
        config = self.config
        if not config.start:
            return build(config.model, config.parameters, "training configuration")
        model, made = load_model(str(locate(config.start)))
        if (made.model, made.parameters) != (config.model, config.parameters):
            raise InputError(
                f"{config.start}: weights of model {made.model} {made.parameters}, expected {config.model} "
                f"{config.parameters} as in the training configuration"
            )
        return model

    @property
    def _result(self) -> SceneModel:
        """The model that is validated and saved: the trained one, or the one with the EMA of its weights."""
        return self.model if self.averaged is None else cast(SceneModel, self.averaged.module)

    def _epoch(self, epoch: int) -> dict[str, float]:
        """Train for `epoch`, counted from 0; returns its means over the training part, and those of the validation."""
        config = self.config
        rate = self._learning_rate(epoch)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.model.train()
        self.model.forcing = max(0.0, 1.0 - epoch / config.forcing_epochs) if config.forcing_epochs else 0.0
        sums, count = torch.zeros(3, dtype=torch.float64, device=self.device), 0  # read once: a GPU need not wait
        batches = training_batches(
            self._parts["train"],
            config.agents_per_batch,
            config.stride,
            config.augmentation,
            self._random,
            self._workers,
        )
        for batch in tqdm(batches, desc=f"epoch {epoch + 1}", unit="batch", leave=False):
            *losses, distillation = self._losses(batch.to(self.device))
            nll, error, maneuver = losses
            warm = epoch < config.warm_epochs
            loss = error if warm else nll + config.error_weight * error
            loss = loss + config.maneuver_weight * maneuver + config.teacher_weight * distillation
            self.optimizer.zero_grad(set_to_none=True)
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), GRADIENT_LIMIT)
            self.optimizer.step()
            if self.averaged is not None:
                self.averaged.update_parameters(self.model)
            agents = int(batch.target.sum())
            sums += agents * torch.stack(losses).detach().double()
            count += agents
        nll_mean, error_mean, maneuver_mean = (sums / max(count, 1)).tolist()
        figures = {"nll": nll_mean, "rmse": error_mean**0.5, "maneuver": maneuver_mean, "learning_rate": rate}
        return {"epoch": epoch + 1, "agents": count} | figures | self._validate()

    def _learning_rate(self, epoch: int) -> float:
        """Returns the learning rate of `epoch`, counted from 0: a cosine over all epochs, or divided by 10 in steps."""
        config = self.config
        if config.divided_every:
            return config.learning_rate * 0.1 ** (epoch // config.divided_every)
        return config.learning_rate * 0.5 * (1.0 + float(np.cos(np.pi * epoch / config.epochs)))

    def _losses(self, batch: SceneBatch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Returns negative log-likelihood, squared error [m2], cross-entropy of manoeuvres, and distillation loss [m2].

        The first two are means over the known future steps of the targets, the third over the targets with a complete
        future, and the last over all steps of the targets decoded with their most probable manoeuvre.
        """
        predicted = torch.rand(batch.maneuver.shape, device=self.device) < self.config.predicted_share
        prediction = self.model(batch, torch.where(predicted, -1, batch.maneuver))
        valid = (batch.future_known & batch.target[..., None])[:, :, None]
        nll = negative_log_likelihood(prediction, batch.future)[valid].mean()
        error = ((prediction.mean - batch.future[:, :, None]) ** 2).sum(dim=-1)[valid].mean()
        named = batch.target & (batch.maneuver >= 0)
        logits, truth = prediction.maneuver[named], batch.maneuver[named]
        maneuver = torch.nn.functional.cross_entropy(logits, truth, reduction="sum") / max(len(truth), 1)
        return nll, error, maneuver, self._distillation(batch, prediction.mean[:, :, 0], predicted & batch.target)

    def _distillation(self, batch: SceneBatch, mean: Tensor, compared: Tensor) -> Tensor:
        """Returns the mean squared distance [m2] of `mean` (B, N, HORIZON, 2) from the mean of the teachers' forecasts.

        The mask `compared` (B, N) selects the agents; 0 without teachers or without such agents.
        """
        if not self._teachers:
            return mean.new_zeros(())
        with torch.no_grad():
            teachers_mean = sum(teacher(batch).mean[:, :, 0] for teacher in self._teachers) / len(self._teachers)
        squared = ((mean - teachers_mean) ** 2).sum(dim=-1)[compared]
        return squared.sum() / max(squared.numel(), 1)

    @torch.no_grad()
    def _validate(self) -> dict[str, float]:
        """Returns RMSE by second [m], its mean, NLL [nats] and share of correct manoeuvres on the validation part.

        Agents with a complete history and future are scored: errors with their most probable manoeuvre, NLL with all.
        """
        model = AlongLanes(self._result.eval())
        squared, nll, right, count = torch.zeros(len(SECONDS)), 0.0, 0, 0
        validation = [tracks for tracks, _ in self._parts["val"]]
        for batch in scene_batches(validation, stride=VALIDATION_STRIDE):
            moved = batch.to(self.device)
            prediction = model(moved, decode="all")
            logits = prediction.maneuver.log_softmax(dim=-1)
            best = logits.argmax(dim=-1)
            error = ((best_of(prediction.mean, best) - moved.future) ** 2).sum(dim=-1)[moved.target]
            squared += error[:, AT_SECONDS].sum(dim=0).cpu()
            of_each = negative_log_likelihood(prediction, moved.future)  # (B, N, K, T)
            nll -= float((logits[..., None] - of_each).logsumexp(dim=2)[moved.target].mean(dim=1).sum())
            right += int((best == moved.maneuver)[moved.target].sum())
            count += int(moved.target.sum())
        if not count:
            raise InputError("training configuration: field data: no vehicle for validation is seen for 8 s")
        rmse = (squared / count).sqrt().tolist()
        figures = {f"val_rmse_{second}": value for second, value in zip(SECONDS, rmse, strict=True)}
        return figures | {"val_error": float(np.mean(rmse)), "val_nll": nll / count, "val_maneuver": right / count}

    def _provenance(self) -> Provenance:
        config = self.config
        return Provenance(
            model=config.model,
            parameters=config.parameters,
            command=self._command,
            training=config.model_dump(mode="json"),
            manifest=self._manifest,
            figures=self.best,
        )

    def _save(self) -> None:
        """Write the checkpoint, the history and the learning curves."""
        self.keep(self._folder)
        summary = {"best": self.best, "manifest": self._manifest, "epochs": self.history, "maneuvers": list(MANEUVERS)}
        write_text(self._folder / HISTORY_FILE, json.dumps(summary, indent=1) + "\n")
        plot_curves(self.history, self._folder / CURVES, PANELS, along="epoch")
