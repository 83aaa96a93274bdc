"""Scores of forecasts: errors, likelihood, calibration and consistency, accumulated over batches of scenes.

Targets whose whole history and future are known are scored. The definitions are those of the literature:

- RMSE at 1 to 5 s: root of the mean squared distance of the most probable PREDICTED manoeuvre's mean from the truth
  (Deo and Trivedi, Convolutional Social Pooling, 2018).
- NLL: that of the truth under the mixture of all manoeuvres, ``-log sum_k p_k N(truth; mean_k, covariance_k)``, at each
  instant.
- ADE, minADE: mean distance over the future, of the most probable manoeuvre and of the best one.
- joint ADE: ADE in the best of :data:`SCENE_SAMPLES` samples of the scene, the same one for all its agents. It is a
  mean over agents like the others, so that minADE <= joint ADE <= ADE.
- calibration: share of truths inside the ellipses that contain 50 % and 90 % of the most probable manoeuvre's Gaussian.
- overlap rate: share of scored agents whose forecast box overlaps that of another agent of the scene at any instant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from litsim_predictor.inference.contract import AT_SECONDS, HORIZON, SECONDS
from litsim_predictor.inference.features import in_map
from litsim_research.predictors.data.batch import Prediction, SceneBatch, numbers
from litsim_research.predictors.evaluation.boxes import agents_that_overlap, path_headings
from litsim_research.predictors.models.model import mahalanobis_squared, negative_log_likelihood
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import BoolArray, FloatArray

SCENE_SAMPLES = 6
"""Number of samples of the joint ADE. In the first, all agents have their most probable manoeuvres; in the others, each
agent draws its own."""
ELLIPSES = {"50": -2.0 * math.log(0.5), "90": -2.0 * math.log(0.1)}
"""Squared Mahalanobis radii of the ellipses that contain 50 % and 90 % of a 2-D Gaussian (chi-squared quantiles)."""


@dataclass(frozen=True)
class Scores:
    """Scores over `samples` agents in `scenes` scenes; see the module.

    Attributes:
        rmse, nll_at: (5,) RMSE [m] and NLL [nats] at 1 to 5 s.
        nll: mean over all instants [nats].
        ade, min_ade, joint_ade: [m].
        calibration: shares over all instants, by ellipse.
        calibration_at: (5,) shares at 1 to 5 s, by ellipse.
        overlap_rate: overlap rate of the forecasts.
        overlap_rate_truth: that of the true futures, with headings derived from paths in the same way: the floor.
    """

    samples: int
    scenes: int
    rmse: FloatArray
    nll_at: FloatArray
    nll: float
    ade: float
    min_ade: float
    joint_ade: float
    calibration: dict[str, float]
    calibration_at: dict[str, FloatArray]
    overlap_rate: float
    overlap_rate_truth: float

    def to_json(self) -> dict[str, Any]:
        """Returns the scores as plain values for JSON; arrays (5,) as in :func:`by_second`."""
        at_seconds = {name: by_second(getattr(self, name)) for name in ("rmse", "nll_at")}
        inside = {name: by_second(shares) for name, shares in self.calibration_at.items()}
        return vars(self) | at_seconds | {"calibration_at": inside}


def by_second(values: FloatArray) -> dict[str, float]:
    """Returns the `values` (5,) at 1 to 5 s, by the names "1" to "5"."""
    return {str(second): float(value) for second, value in zip(SECONDS, values, strict=True)}


def scored_agents(batch: SceneBatch) -> Tensor:
    """Returns a mask (B, N) of the agents that are scored: targets whose whole history and future are known."""
    return batch.agent & batch.target & batch.observed.all(dim=-1) & batch.future_known.all(dim=-1)


def best_of(values: Tensor, maneuver: Tensor) -> Tensor:
    """Returns the values (B, N, ...) of the manoeuvres `maneuver` (B, N), from `values` (B, N, K, ...)."""
    scenes, agents = maneuver.shape
    index = (torch.arange(scenes, device=values.device)[:, None], torch.arange(agents, device=values.device)[None])
    return values[index[0], index[1], maneuver]


class ScoreBoard:
    """Accumulates scores over batches; samples of the joint ADE are drawn by a seed."""

    def __init__(self, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._samples = self._scenes = 0
        self._squared = np.zeros(HORIZON)
        self._nll = np.zeros(HORIZON)
        self._inside = {name: np.zeros(HORIZON) for name in ELLIPSES}
        self._ade = np.zeros(3)  # most probable, best, scene
        self._overlaps = np.zeros(2, np.int64)  # forecasts, truth

    def add(self, batch: SceneBatch, prediction: Prediction) -> None:
        """Score `prediction`, decoded for all manoeuvres, against the future in `batch`.

        Raises:
            InputError: the prediction is not finite.
        """
        scored = scored_agents(batch)
        count = int(scored.sum())
        if not count:
            return
        scene = scored.nonzero()[:, 0].cpu().numpy()
        logits = prediction.maneuver.double().log_softmax(dim=-1)
        best = logits.argmax(dim=-1)
        distance = (prediction.mean.double() - batch.future[:, :, None]).norm(dim=-1)[scored]  # (n, K, T)
        nll = negative_log_likelihood(prediction, batch.future)[scored].double()
        radius = best_of(mahalanobis_squared(prediction, batch.future), best)[scored]  # (n, T)
        mixture = -(logits[scored][..., None] - nll).logsumexp(dim=1)
        if not bool(prediction.mean[batch.agent].isfinite().all() and mixture.isfinite().all()):
            raise InputError("a forecast is not finite: expected finite means, deviations and manoeuvre logits")
        chosen = best[scored]
        of_best = distance[torch.arange(count, device=chosen.device), chosen]
        self._samples += count
        self._scenes += len(np.unique(scene))
        self._squared += numbers((of_best**2).sum(dim=0))
        self._nll += numbers(mixture.sum(dim=0))
        for name, limit in ELLIPSES.items():
            self._inside[name] += numbers((radius <= limit).sum(dim=0))
        ade = numbers(distance.mean(dim=-1))
        joint = self._joint_ade(ade, numbers(logits[scored].exp()), chosen.cpu().numpy(), scene)
        self._ade += [numbers(of_best.mean(dim=-1)).sum(), ade.min(axis=1).sum(), joint]
        self._overlaps += self._count_overlaps(batch, best_of(prediction.mean, best), scored.cpu().numpy())

    def scores(self) -> Scores:
        """Returns the scores over all batches added.

        Raises:
            InputError: nothing was scored.
        """
        n = self._samples
        if not n:
            raise InputError("no agent to score: expected some with 3 s of history and 5 s of future")
        ade, min_ade, joint_ade = (self._ade / n).tolist()
        overlap_rate, overlap_rate_truth = (self._overlaps / n).tolist()
        return Scores(
            samples=n,
            scenes=self._scenes,
            rmse=np.sqrt(self._squared[AT_SECONDS] / n),
            nll_at=self._nll[AT_SECONDS] / n,
            nll=float(self._nll.mean() / n),
            ade=ade,
            min_ade=min_ade,
            joint_ade=joint_ade,
            calibration={name: float(inside.mean() / n) for name, inside in self._inside.items()},
            calibration_at={name: inside[AT_SECONDS] / n for name, inside in self._inside.items()},
            overlap_rate=overlap_rate,
            overlap_rate_truth=overlap_rate_truth,
        )

    def _joint_ade(self, ade: FloatArray, probability: FloatArray, best: FloatArray, scene: FloatArray) -> float:
        """Returns the sum over agents of the ADE in the best sample of their scene.

        Args:
            ade, probability: (n, K) ADE [m] and probability of each manoeuvre of each agent.
            best: (n,) most probable manoeuvres.
            scene: (n,) numbers of the agents' scenes.
        """
        draw = self._rng.random((len(ade), SCENE_SAMPLES - 1))  # agent by agent: independent of the size of batches
        drawn = (draw[:, :, None] > probability.cumsum(axis=1)[:, None, :-1]).sum(axis=-1)
        of_sample = np.take_along_axis(ade, np.column_stack([best, drawn]), axis=1)
        _, number = np.unique(scene, return_inverse=True)
        total = np.zeros((number.max() + 1, SCENE_SAMPLES))
        np.add.at(total, number, of_sample)
        return float(total.min(axis=1).sum())

    @staticmethod
    def _count_overlaps(batch: SceneBatch, mean: Tensor, scored: BoolArray) -> list[int]:
        """Returns how many scored agents overlap another one, in the forecasts `mean` (B, N, T, 2) and in the truth.

        Both are counted for the agents and instants of which the true future is known.
        """
        valid = (batch.agent[..., None] & batch.future_known).cpu().numpy()
        frame = np.concatenate([numbers(batch.position), numbers(batch.heading)[..., None]], axis=-1)
        state = numbers(batch.state)
        counts = []
        for path in (numbers(mean), numbers(batch.future)):
            box = in_map(path, frame)
            yaw = frame[..., 2:] + path_headings(path, state[..., 3])
            hit = agents_that_overlap(box[..., 0], box[..., 1], yaw, (state[..., 0], state[..., 1]), valid)
            counts.append(int((hit & scored).sum()))
        return counts
