"""Configuration dataclasses as ROS parameters: fields and defaults are written down once, in the core."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import yaml
from rclpy.node import Node

from litsim_sim.core.parameters import Config

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares itself."""


def declare(node: Node, default: Config, prefix: str = "") -> Config:
    """Declare each field of the frozen dataclass `default` as a parameter, and return what the node was given.

    A :class:`litsim_sim.core.parameters.ParameterReader`, once the node is bound. A tuple is an array.
    """
    values: dict[str, Any] = {}
    for field in fields(default):  # type: ignore[arg-type]
        name = prefix + field.name
        value: Any = getattr(default, field.name)
        if is_dataclass(value):
            values[field.name] = declare(node, value, f"{name}.")
        else:
            given = node.declare_parameter(name, value).value
            values[field.name] = tuple(given) if isinstance(value, tuple) else given
    return type(default)(**values)


def parameters_yaml(node: Node) -> str:
    """The node's parameters as it runs with them, by name, in YAML."""
    names = sorted(set(node.list_parameters([], 0).names) - set(OF_EVERY_NODE))
    values = {name: node.get_parameter(name).value for name in names}
    plain = {name: list(v) if isinstance(v, Sequence) and not isinstance(v, str) else v for name, v in values.items()}
    return yaml.safe_dump(plain)
