"""The loader of YAML from users: numbers are those that people and JSON write."""

from __future__ import annotations

import json
from typing import Any

import pytest
import yaml

from litsim_sim.core.yaml_loader import YamlLoader


def load(text: str) -> Any:
    return yaml.load(text, YamlLoader)


@pytest.mark.parametrize("text", ["1e12", "1E3", "-2e-05", "+1.5e3", "2.e1", ".5e1", "1.0e+3"])
def test_a_number_with_an_exponent_is_a_number(text: str) -> None:
    assert load(text) == float(text)


@pytest.mark.parametrize("value", [1e-05, 1e16, -3e-300, 0.1, 7, 1.5e300])
def test_numbers_of_json_are_numbers(value: float) -> None:
    assert load(json.dumps({"a": [value]})) == {"a": [value]}


@pytest.mark.parametrize("text", ["12_0", "1_0.5", "e5", "1e", "1e5m", "-e1", ".e1", "1e5_0"])
def test_names_that_look_like_numbers_are_text(text: str) -> None:
    assert load(text) == text
