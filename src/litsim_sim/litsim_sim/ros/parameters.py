"""Configuration dataclasses as ROS parameters: fields and defaults are written down once, in the core."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

from rclpy.node import Node

Config = TypeVar("Config")


def declare(node: Node, default: Config, prefix: str = "") -> Config:
    """Declare each field of the frozen dataclass `default` as a parameter, and return what the node was given.

    The fields of a dataclass in a field become `field.name`; a tuple is an array.
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
