"""Learned models whose forecasts follow lanes that bend, as in a run."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from litsim_predictor.inference.lane_frames import LaneFrames, bend
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.models.model import Decode, SceneModel


class AlongLanes(SceneModel):
    """Predictions of `model`, bent along the batch's :mod:`~litsim_predictor.inference.lane_frames`."""

    def __init__(self, model: SceneModel) -> None:
        super().__init__()
        self.model, self.sees_signals = model, model.sees_signals

    def forward(self, batch: SceneBatch, decode: Decode = "best", asked: Tensor | None = None) -> Prediction:
        """See :meth:`SceneModel.forward`; `asked` must be None."""
        assert asked is None
        prediction: Prediction = self.model(batch, decode=decode)
        return _bent(prediction, batch.lane_frames) if len(batch.lane_frames) else prediction


def _bent(prediction: Prediction, lane_frames: LaneFrames) -> Prediction:
    """Returns `prediction` for agents (B, N), bent along `lane_frames`, whose rows are indices into (B * N,)."""
    parts = prediction.mean, prediction.scale, prediction.correlation
    changed = [tensor.flatten(0, 1).clone() for tensor in parts]  # (B * N, M, HORIZON, ...)
    straight = [tensor[lane_frames.row].cpu().numpy() for tensor in changed]
    for futures in range(prediction.mean.shape[2]):
        bent = bend(lane_frames.pose, *(array[:, futures] for array in straight))
        for tensor, values in zip(changed, bent, strict=True):
            tensor[lane_frames.row, futures] = torch.from_numpy(values).to(tensor)
    mean, scale, correlation = (tensor.view_as(part) for tensor, part in zip(changed, parts, strict=True))
    return replace(prediction, mean=mean, scale=scale, correlation=correlation)
