"""A model run eagerly by torch, for weights that neither the kernels nor a shipped graph can run."""

from __future__ import annotations

import torch

from litsim_predictor.inference.contract import AgentFutures, AgentInputs
from litsim_research.predictors.data.scenes import inputs_batch
from litsim_research.predictors.models.model import SceneModel
from litsim_research.predictors.models.weights import load_model
from litsim_sim.core.scene import IntArray


def load(model: str) -> EagerNetwork:
    """Returns the network of shipped weights or of a file of weights; the plug-in of ``litsim.networks``.

    Raises:
        InputError: its file cannot be used.
    """
    return EagerNetwork(load_model(model)[0], model)


class EagerNetwork:
    """Runs `model` on one scene at a time; `source` is the file of its weights, for errors."""

    def __init__(self, model: SceneModel, source: str) -> None:
        # Rounding depends on the number of threads, which compiled networks fix to one as well.
        torch.set_num_threads(1)
        self._model, self.source, self.sees_signals = model.eval(), source, model.sees_signals

    def __call__(self, inputs: AgentInputs, asked: IntArray, modes: int = 0) -> AgentFutures:  # noqa: ARG002 - of the protocol
        """See :class:`litsim_predictor.inference.contract.Network`."""
        with torch.inference_mode():
            prediction = self._model(inputs_batch([inputs]), "best", torch.as_tensor(asked))
        return AgentFutures(
            prediction.maneuver[0].softmax(dim=-1).numpy(),
            prediction.mean[0, :, 0].numpy(),
            prediction.scale[0, :, 0].numpy(),
            prediction.correlation[0, :, 0].numpy(),
        )
