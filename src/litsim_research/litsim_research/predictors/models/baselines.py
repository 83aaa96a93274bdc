"""Kinematic models with the interface of the learned ones, so that the same evaluation applies to both."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from litsim_predictor.inference.contract import DT, HISTORY, HORIZON
from litsim_predictor.kinematic import RATE_DEAD_BAND, RATE_WINDOW, roll_out, spread
from litsim_research.predictors.data.batch import Prediction, SceneBatch, numbers
from litsim_research.predictors.models.model import Decode, SceneModel, constant_velocity
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, FloatArray

TIMES: FloatArray = DT * np.arange(1, HORIZON + 1, dtype=np.float64)


class ConstantVelocity(SceneModel):
    """Constant speed along the heading, as a single manoeuvre with the covariances of the `kinematic` predictor."""

    def forward(
        self,
        batch: SceneBatch,
        decode: Decode = "best",  # noqa: ARG002 - there is one manoeuvre only
        asked: Tensor | None = None,
    ) -> Prediction:
        """See :meth:`SceneModel.forward`; `asked` must be None."""
        assert asked is None
        mean, yaw = self._paths(batch)
        spreads = torch.as_tensor(spread(yaw, TIMES)).to(batch.state)
        return Prediction(
            maneuver=batch.state.new_zeros(*mean.shape[:2], 1),
            mean=mean[:, :, None],
            scale=spreads[:, :, None, :, :2],
            correlation=spreads[:, :, None, :, 2],
        )

    def _paths(self, batch: SceneBatch) -> tuple[Tensor, FloatArray]:
        """Returns positions (B, N, HORIZON, 2) [m] and headings (B, N, HORIZON) [rad], in the agent frames."""
        yaw = np.repeat(numbers(batch.state[..., 3])[..., None], HORIZON, axis=-1)
        return constant_velocity(batch.state), yaw


class ConstantTurnRate(ConstantVelocity):
    """The `kinematic` predictor: constant speed, and a decaying turn rate, initially its mean over the last second."""

    def _paths(self, batch: SceneBatch) -> tuple[Tensor, FloatArray]:
        yaw, speed = numbers(batch.state[..., 3]), numbers(batch.state[..., 2])
        headings, path = roll_out(yaw, speed, self._turn_rate(batch), TIMES)
        return torch.as_tensor(path).to(batch.state), headings

    def _turn_rate(self, batch: SceneBatch) -> FloatArray:
        """Returns turn rates (B, N) [rad/s]; zero for agents that have just appeared or hardly turn."""
        window = RATE_WINDOW * STEP_S
        steps = min(round(window / DT), HISTORY - 1)
        yaw, observed = numbers(batch.history[:, :, -steps - 1 :, 2]), batch.observed[:, :, -steps - 1 :].cpu().numpy()
        first = np.argmax(observed, axis=-1)
        start = np.take_along_axis(yaw, first[..., None], axis=-1)[..., 0]
        span = DT * (steps - first)
        rate = np.divide(wrap_angle(yaw[..., -1] - start), span, out=np.zeros(start.shape), where=span > 0.5 * window)
        return np.where(np.abs(rate) > RATE_DEAD_BAND, rate, 0.0)
