"""Parameters of stages by the names that their nodes declare, for whoever runs the stages' cores without ROS."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Protocol, TypeVar

import yaml

from litsim_sim.core.errors import InputError

Config = TypeVar("Config")

Parameters = Mapping[str, Mapping[str, Any]]
"""Values by stage, and by name within it; the fields of a dataclass in a field are called `field.name`."""

SET_HELP = "parameters of the stages, as their nodes declare them, such as conflict.horizon=2.0"
"""Of the command lines that take them."""


class ParameterReader(Protocol):
    """Where a stage's core has its parameters from: a node that declares them, or values that were given by name."""

    def __call__(self, default: Config, prefix: str = "") -> Config:
        """The frozen dataclass `default` with what was given in place of its fields, whose names begin with `prefix`.

        Raises:
            InputError: a value does not fit its field.
        """


class ParameterOverrides:
    """Reads parameters of `stage` out of `values`."""

    def __init__(self, stage: str, values: Mapping[str, Any]) -> None:
        self._stage, self._values = stage, values
        self._known: list[str] = []

    def __call__(self, default: Config, prefix: str = "") -> Config:
        """See :class:`ParameterReader`."""
        read: dict[str, Any] = {}
        for field in fields(default):  # type: ignore[arg-type]
            name, value = prefix + field.name, getattr(default, field.name)
            if is_dataclass(value):
                read[field.name] = self(value, f"{name}.")
                continue
            self._known.append(name)
            read[field.name] = self._fitting(name, value) if name in self._values else value
        return type(default)(**read)

    @property
    def unknown(self) -> list[str]:
        """Names of values that nobody has asked for."""
        return sorted(set(self._values) - set(self._known))

    def check(self) -> None:
        """To be called when everything has been read.

        Raises:
            InputError: values were given that nobody has asked for.
        """
        if self.unknown:
            expected = ", ".join(sorted(self._known)) or "none"
            raise InputError(f"{self._stage}: unknown parameter {', '.join(self.unknown)}; expected {expected}")

    def _fitting(self, name: str, default: Any) -> Any:
        value = self._values[name]
        if isinstance(default, tuple) and isinstance(value, list | tuple):
            return tuple(value)
        if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
            return float(value)
        if type(value) is not type(default):
            raise InputError(f"{self._stage}: parameter {name} is {value!r}, expected such as {default!r}")
        return value


def by_stage(settings: Iterable[tuple[str, str, Any]]) -> dict[str, dict[str, Any]]:
    """Settings, each of a stage, a name and a value, as :data:`Parameters`; of two of a name, the later counts."""
    found: dict[str, dict[str, Any]] = {}
    for stage, name, value in settings:
        found.setdefault(stage, {})[name] = value
    return found


def setting(text: str) -> tuple[str, str, list[Any]]:
    """Stage, name and values of ``STAGE.NAME=VALUE[,VALUE]...``, as a command line has them; values are YAML.

    Raises:
        argparse.ArgumentTypeError: the text is not of that form.
    """
    where, equals, value = text.partition("=")
    stage, dot, name = where.partition(".")
    try:
        values = yaml.safe_load(f"[{value}]")
    except yaml.YAMLError:
        values = []
    if not (equals and dot and stage and name and values) or None in values:
        raise argparse.ArgumentTypeError(f"{text!r}: expected STAGE.NAME=VALUE, such as conflict.horizon=2.0")
    return stage, name, [tuple(each) if isinstance(each, list) else each for each in values]


def one_setting(text: str) -> tuple[str, str, Any]:
    """As :func:`setting`, where there can be but one value.

    Raises:
        argparse.ArgumentTypeError: the text is not of that form.
    """
    stage, name, values = setting(text)
    if len(values) != 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected one value, found {len(values)}")
    return stage, name, values[0]
