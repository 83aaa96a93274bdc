"""The loader of YAML from users: numbers are those that people and JSON write."""

import json
from typing import Any

import pytest
import yaml

from litsim_sim.core import yaml_loader
from litsim_sim.core.yaml_loader import NODES_MAX, YamlLoader, load_yaml


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


@pytest.mark.parametrize(
    "text", ["!!timestamp x", "!!bool x", '!!int ""', "!!float x", "2026-13-40", "!!timestamp {a: 1}", "!!binary é"]
)
def test_a_value_that_its_tag_does_not_have_is_told_with_its_line(text: str) -> None:
    with pytest.raises(yaml.YAMLError, match=r"line 2, column 4"):
        load_yaml(f"b: 1\na: {text}")


NINE_TIMES = "[" + ", ".join(["*{}"] * 9) + "]"


def test_aliases_that_expand_are_refused() -> None:
    """Ten lines of nine aliases each would be three billion values."""
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i + 1}: &a{i + 1} {NINE_TIMES.replace('{}', f'a{i}')}" for i in range(10)]
    with pytest.raises(yaml.YAMLError, match=f"more than {NODES_MAX} values, those of aliases counted at each use"):
        load_yaml("\n".join(lines))
    assert load_yaml("\n".join(lines[:4]))["a3"][8][8][8] == [1] * 9


@pytest.mark.parametrize("text", ["a: &a [*a]", "a: &a {b: *a}", "&a [1, {b: [*a]}]"])
def test_an_alias_of_what_it_is_part_of_is_refused(text: str) -> None:
    with pytest.raises(yaml.YAMLError, match="an alias of what it is part of"):
        load_yaml(text)


def test_merge_keys_and_usual_aliases_are_taken() -> None:
    assert load_yaml("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}") == {"a": {"x": 1, "y": 2}, "b": {"x": 1, "y": 3}}


def test_many_keys_are_read_in_linear_time_and_too_many_values_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = "\n".join(f"k{i}: 1" for i in range(5_000))
    assert len(load_yaml(keys)) == 5_000
    monkeypatch.setattr(yaml_loader, "NODES_MAX", 1_000)
    with pytest.raises(yaml.YAMLError, match="more than 1000 values"):
        load_yaml("[" + "1," * 1_001 + "]")
    assert len(load_yaml("[" + "1," * 900 + "]")) == 900
