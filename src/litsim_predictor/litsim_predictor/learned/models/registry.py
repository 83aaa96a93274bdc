"""Learned models by the name of their kind."""

from __future__ import annotations

from typing import Any

from litsim_predictor.learned.models.bat import Bat
from litsim_predictor.learned.models.cs_lstm import CsLstm
from litsim_predictor.learned.models.joint import JointPredictor
from litsim_predictor.learned.models.model import SceneModel
from litsim_sim.core.errors import InputError

KINDS: dict[str, type[SceneModel]] = {"joint": JointPredictor, "cs_lstm": CsLstm, "bat": Bat}


def build(kind: str, parameters: dict[str, Any], where: str) -> SceneModel:
    """An untrained model; `where` names the file that asks for it in errors.

    Raises:
        InputError: unknown kind or parameters.
    """
    if kind not in KINDS:
        raise InputError(f"{where}: field model is {kind!r}, expected one of {', '.join(KINDS)}")
    try:
        return KINDS[kind](**parameters)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{where}: field parameters does not fit model {kind}: {error}") from error
