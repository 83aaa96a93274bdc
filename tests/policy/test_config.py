"""Files of parameters in YAML say what each value is, and those of the nodes what the node does without them."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from litsim_sim.core import plugins
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.plugins import stage_reader
from litsim_sim.core.stages import EGO
from litsim_sim.scenario.run_info import driver_names
from programs import program

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "src"
TRAININGS = (
    *SOURCES.glob("litsim_research/config/simnet*.yaml"),
    *SOURCES.glob("litsim_research/config/?ail.yaml"),
    *SOURCES.glob("litsim_research/*/configs/**/*.yaml"),
)
tool = program("tools/parameters.py")


def test_files_of_parameters_are_up_to_date() -> None:
    old = [path.name for path, text in tool.files().items() if not path.is_file() or path.read_text() != text]
    assert old == [], "run ./litsim exec python tools/parameters.py"


@pytest.mark.parametrize("name", [*plugins.names(plugins.STAGES), *(f"{EGO}_{name}" for name in driver_names())])
def test_the_files_of_a_stage_hold_its_parameters(name: str) -> None:
    """As ROS reads them: those of its own package, and those that plug-ins of others add."""
    stage, _, driver = name.partition("_")
    values: dict[str, Any] = {}
    for path in (*SOURCES.glob(f"*/config/{name}.yaml"), *SOURCES.glob("*/config/plugins.yaml")):
        values |= yaml.safe_load(path.read_text()).get(stage, {}).get("ros__parameters", {})
    default, given = (ParameterOverrides(stage, each) for each in ({}, values))
    for read in (default, given):
        stage_reader(stage, driver)(read)
    given.check()
    assert given.values == default.values and set(values) == set(default.values)


@pytest.mark.parametrize("path", TRAININGS, ids=lambda path: path.stem)
def test_a_training_configuration_says_what_every_number_is(path: Path) -> None:
    numbers = [line for line in path.read_text().splitlines() if re.match(r" *\w+: *[-+.\d]", line)]
    assert numbers
    assert [line for line in numbers if not re.search(r"\d +# \S", line)] == []
