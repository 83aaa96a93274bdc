"""The YAML file of every node says what the node does without it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from litsim_policy.conflict.detection import ConflictConfig
from litsim_policy.conflict.takeover import TakeoverConfig
from litsim_policy.driving.handback import HandbackConfig
from litsim_policy.driving.policy_c import PolicyCConfig
from litsim_policy.driving.yield_policy import YieldConfig
from litsim_policy.ego.bat import BatConfig
from litsim_policy.ego.idm import CAREFUL
from litsim_policy.ego.perturbed import PerturbedConfig
from litsim_predictor.models import PredictorConfig

SOURCES = Path(__file__).parents[2] / "src"


def flat(config: Any, prefix: str = "") -> dict[str, Any]:
    """Fields as parameter names, nested ones with a dot, tuples as lists."""
    found = {}
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            found |= flat(value, f"{prefix}{field.name}.")
        else:
            found[prefix + field.name] = list(value) if isinstance(value, tuple) else value
    return found


@pytest.mark.parametrize(
    ("file", "node", "expected"),
    [
        ("litsim_policy/config/conflict.yaml", "conflict", flat(ConflictConfig()) | flat(TakeoverConfig())),
        (
            "litsim_policy/config/policy.yaml",
            "policy",
            flat(YieldConfig()) | flat(HandbackConfig(), "handback.") | flat(PolicyCConfig()),
        ),
        ("litsim_policy/config/ego_bat.yaml", "ego", flat(BatConfig())),
        ("litsim_policy/config/ego_idm.yaml", "ego", flat(CAREFUL)),
        ("litsim_policy/config/ego_perturbed.yaml", "ego", flat(PerturbedConfig())),
        (
            "litsim_predictor/config/predictor.yaml",
            "predictor",
            flat(PredictorConfig()),
        ),
    ],
)
def test_file_holds_the_defaults(file: str, node: str, expected: dict[str, Any]) -> None:
    assert yaml.safe_load((SOURCES / file).read_text()) == {node: {"ros__parameters": expected}}
