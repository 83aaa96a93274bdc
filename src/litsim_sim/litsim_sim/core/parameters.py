"""Parameters of stages: reading them from command lines and nodes, and checking them.

A stage has its parameters in configurations (see :mod:`litsim_sim.core.quantities`). Each field is a parameter of the
same name; fields of a nested configuration are named `field.name`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import expected, field_type
from litsim_sim.core.yaml_loader import load_yaml

Config = TypeVar("Config")

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by stage, and by the name of the parameter within it."""

SET_HELP = "parameters of the stages, as their nodes declare them, such as conflict.horizon=2.0"
"""Help of the option ``--set`` of the command lines that have it."""


class ParameterOverrides:
    """Reads the configurations of `stage` with the given `values`, by name, in place of defaults."""

    def __init__(self, stage: str, values: Mapping[str, Any]) -> None:
        self._stage, self._given = stage, values
        self.values: dict[str, Any] = {}
        """Value of each parameter that has been read, given or default, by name."""

    def __call__(self, default: Config, prefix: str = "") -> Config:
        """Return `default` with given values in place of defaults; names of parameters begin with `prefix`.

        Raises:
            InputError: a value does not fit its field.
        """
        read: dict[str, Any] = {}
        for field in fields(default):  # type: ignore[arg-type]
            name, value = prefix + field.name, getattr(default, field.name)
            read[field.name] = self(value, f"{name}.") if is_dataclass(value) else self._given.get(name, value)
        try:
            config = type(default)(**read)
        except ValidationError as error:
            texts = [f"parameter {prefix}{problem}" for problem in problems(error, type(default), read)]
            raise InputError(f"{self._stage}: {'; '.join(texts)}") from error
        flat = {prefix + name: getattr(config, name) for name in read if not is_dataclass(getattr(config, name))}
        self.values |= flat
        return config

    def check(self) -> None:
        """Raise InputError if values are given that no configuration has; to be called after all have been read."""
        if unknown := sorted(set(self._given) - set(self.values)):
            raise InputError(f"{self._stage}: unknown parameter {not_among(unknown, self.values)}")


def problems(error: ValidationError, config: type, values: Mapping[str, Any]) -> list[str]:
    """Returns what is wrong with the fields of a configuration: name, value, and what was expected.

    The constructor of its class `config` has raised `error` for the arguments `values`.
    """
    texts = []
    for problem in error.errors():
        text = str(problem["ctx"]["error"]) if problem["type"] == "value_error" else ""
        name = str(problem["loc"][0]) if problem["loc"] else ""
        if problem["type"] == "unexpected_keyword_argument":
            text = f"{name} is unknown"
        elif name:  # without one, the problem is that of fields together, and its text begins with the name of one
            text = f"{name} is {values[name]!r}, {text or f'expected {expected(field_type(config, name))}'}"
        texts.append(text)
    return list(dict.fromkeys(texts))


def not_among(names: Iterable[str], expected: Iterable[str]) -> str:
    """Returns a text that lists unknown `names`, similar `expected` ones, and all `expected` ones."""
    expected = sorted(expected)
    near = {name: ", ".join(get_close_matches(name, expected)) for name in names}
    texts = [f"{name} (near: {similar})" if similar else name for name, similar in near.items()]
    return f"{', '.join(texts)}; expected {', '.join(expected) or 'none'}"


def by_stage(settings: Iterable[tuple[str, str, Any]]) -> dict[str, dict[str, Any]]:
    """Arrange settings (stage, name, value) as :data:`Parameters`; later ones override earlier ones."""
    parameters: dict[str, dict[str, Any]] = {}
    for stage, name, value in settings:
        parameters.setdefault(stage, {})[name] = value
    return parameters


def by_place(values: Iterable[tuple[str, Any]]) -> dict[str, dict[str, Any]]:
    """Arranges places (STAGE.NAME) and their values as :data:`Parameters`; later ones override earlier ones."""
    return by_stage((*place.split(".", 1), value) for place, value in values)


def setting(text: str) -> tuple[str, str, list[Any]]:
    """Parse ``STAGE.NAME=VALUE[,VALUE]...`` of a command line to stage, name and values; values are YAML.

    Raises:
        argparse.ArgumentTypeError: the text is not of that form.
    """
    where, equals, value = text.partition("=")
    stage, dot, name = where.partition(".")
    try:
        values = load_yaml(f"[{value}]")
    except yaml.YAMLError:
        values = []
    if not (equals and dot and stage and name and values) or None in values:
        raise argparse.ArgumentTypeError(f"{text!r}: expected STAGE.NAME=VALUE, such as conflict.horizon=2.0")
    return stage, name, [tuple(value) if isinstance(value, list) else value for value in values]


def one_setting(text: str) -> tuple[str, str, Any]:
    """Like :func:`setting`, for exactly one value."""
    stage, name, values = setting(text)
    if len(values) != 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected one value, found {len(values)}")
    return stage, name, values[0]
