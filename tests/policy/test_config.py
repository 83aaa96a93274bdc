"""The YAML file of every node says what the node does without it, with the unit and the meaning of every value."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from litsim_sim.core import plugins
from litsim_sim.core.parameters import Config, ParameterOverrides
from litsim_sim.core.quantities import field_type, unit
from litsim_sim.core.stage_registry import stage_reader
from litsim_sim.scenario.run_info import driver_names

SOURCES = Path(__file__).parents[2] / "src"
ADDED = "litsim_research/config/plugins.yaml"
"""File of the parameters that plug-ins of litsim_research add to the nodes of the loop."""
FILES = {
    "bridge": "litsim_sim/config/bridge.yaml",
    "recorder": "litsim_sim/config/recorder.yaml",
    "predictor": "litsim_predictor/config/predictor.yaml",
    "conflict": "litsim_policy/config/conflict.yaml",
    "policy": "litsim_policy/config/policy.yaml",
    "ego_bat": "litsim_policy/config/ego_bat.yaml",
    "ego_idm": "litsim_policy/config/ego_idm.yaml",
    "ego_perturbed": "litsim_policy/config/ego_perturbed.yaml",
}
"""File of each stage that has parameters; of the ego's, by its driver."""
TRAININGS = (
    *SOURCES.glob("litsim_research/config/policy_c*.yaml"),
    *SOURCES.glob("litsim_research/config/simnet*.yaml"),
    *SOURCES.glob("litsim_research/config/?ail.yaml"),
    *SOURCES.glob("litsim_research/*/configs/*.yaml"),
)


class Units(ParameterOverrides):
    """Reads a stage's configurations and remembers the units of their fields."""

    def __init__(self, stage: str, values: dict[str, Any]) -> None:
        super().__init__(stage, values)
        self.units: dict[str, str] = {}

    def __call__(self, default: Config, prefix: str = "") -> Config:
        for field in fields(default):  # type: ignore[arg-type]
            if not is_dataclass(getattr(default, field.name)):
                self.units[prefix + field.name] = unit(field_type(type(default), field.name))
        return super().__call__(default, prefix)


def read_by(name: str, values: dict[str, Any]) -> Units:
    """What the stage registered as `name` makes of `values`."""
    stage, _, ego = name.partition("_")
    read = Units(name, values)
    stage_reader(stage, ego)(read)
    read.check()
    return read


def in_file(name: str) -> dict[str, Any]:
    """Parameters in the file of a stage, by flat names."""
    node = "ego" if name.startswith("ego_") else name
    added = yaml.safe_load((SOURCES / ADDED).read_text()).get(node, {"ros__parameters": {}})
    values = yaml.safe_load((SOURCES / FILES[name]).read_text())
    return flat(values[node]["ros__parameters"]) | flat(added["ros__parameters"])


def flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of nested mappings by names with dots."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return found


def test_every_stage_with_parameters_has_a_file() -> None:
    names = [*plugins.names(plugins.STAGES), *(f"ego_{name}" for name in driver_names())]
    assert {name for name in names if read_by(name, {}).values} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_file_holds_the_defaults(name: str) -> None:
    defaults = read_by(name, {}).values
    assert in_file(name) == {key: list(v) if isinstance(v, tuple) else v for key, v in defaults.items()}
    assert read_by(name, in_file(name)).values == defaults


@pytest.mark.parametrize("name", FILES)
def test_file_says_unit_and_meaning_beside_every_value(name: str) -> None:
    units = read_by(name, {}).units
    values = in_file(name)
    lines = [line for file in (FILES[name], ADDED) for line in (SOURCES / file).read_text().splitlines()]
    for parameter in values:
        written = (
            parameter if any(line.strip().startswith(f"{parameter}:") for line in lines) else parameter.split(".")[-1]
        )
        line = next(line for line in lines if line.strip().startswith(f"{written}:"))
        comment = line.partition(" # ")[2]
        assert comment, f"{parameter}: no comment"
        told = re.match(r"\[([^]]+)\]", comment)
        assert (told[1] if told else "") == units[parameter], f"{parameter}: {comment}"


@pytest.mark.parametrize("path", TRAININGS, ids=lambda path: path.stem)
def test_a_training_configuration_says_what_every_number_is(path: Path) -> None:
    numbers = [line for line in path.read_text().splitlines() if re.match(r" *\w+: *[-+.\d]", line)]
    assert numbers
    assert [line for line in numbers if not re.search(r"\d +# \S", line)] == []
