"""Configuration dataclasses as ROS parameters: the fields are declared once, in the core."""

from __future__ import annotations

from dataclasses import fields
from typing import TypeVar

from rclpy.node import Node

Config = TypeVar("Config")


def declare(node: Node, default: Config) -> Config:
    """Declare each field of the frozen dataclass `default` as a parameter, and return what the node was given."""
    values = {}
    for field in fields(default):  # type: ignore[arg-type]
        value = node.declare_parameter(field.name, getattr(default, field.name)).value
        values[field.name] = tuple(value) if isinstance(getattr(default, field.name), tuple) else value
    return type(default)(**values)
