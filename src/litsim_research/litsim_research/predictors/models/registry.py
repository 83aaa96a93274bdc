"""Learned models by the name of their kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from litsim_predictor.inference.joint.parameters import JointParameters
from litsim_predictor.inference.weights import configured
from litsim_research.predictors.models.bat import Bat, BatParameters
from litsim_research.predictors.models.cs_lstm import CsLstm, CsLstmParameters
from litsim_research.predictors.models.joint import JointPredictor
from litsim_research.predictors.models.model import SceneModel
from litsim_sim.core.errors import InputError

KINDS: dict[str, tuple[type, Callable[[Any], SceneModel]]] = {
    "joint": (JointParameters, JointPredictor),
    "cs_lstm": (CsLstmParameters, CsLstm),
    "bat": (BatParameters, Bat),
}
"""Class of the configuration, and class of the model, by kind."""


def build(kind: str, parameters: dict[str, Any], where: str) -> SceneModel:
    """Returns an untrained model of this kind; `where` names the origin of `kind` and `parameters` in errors.

    Raises:
        InputError: the kind or a parameter is unknown, or a parameter is out of its bounds.
    """
    if kind not in KINDS:
        raise InputError(f"{where}: field model is {kind!r}, expected one of {', '.join(KINDS)}")
    config, model = KINDS[kind]
    return model(configured(config, parameters, where))
