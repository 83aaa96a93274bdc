"""Parameters of nodes: read, checked and declared by the configurations of their stages."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares itself."""

Configuration = TypeVar("Configuration")


def read_parameters(node: Node, stage: Callable[[ParameterOverrides], Configuration]) -> Configuration:
    """Let `stage` read its configurations from the parameters of `node`, and declare these as read-only.

    The node must be made with ``automatically_declare_parameters_from_overrides``: ROS would refuse an integer for a
    parameter with a float as default, and silently ignore undeclared parameters.

    Raises:
        InputError: a parameter is unknown, or does not fit.
    """
    read = ParameterOverrides(node.get_name(), parameters(node))
    configuration = stage(read)
    read.check()
    for name, value in read.values.items():
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        node.declare_parameter(name, value, ParameterDescriptor(read_only=True), ignore_override=True)
    return configuration


def refuse_parameters(node: Node) -> None:
    """Raise InputError if the user has set parameters of `node`, which has none: ROS would silently ignore them.

    The node must be made with ``automatically_declare_parameters_from_overrides``.
    """
    if unknown := sorted(parameters(node)):
        raise InputError(f"{node.get_name()}: unknown parameter {', '.join(unknown)}; expected none")


def parameters(node: Node) -> dict[str, Any]:
    """Returns the parameters of `node` by name, without those that rclpy declares; arrays as lists."""
    by_name = sorted(node.get_parameters_by_prefix("").items())
    values = {name: parameter.value for name, parameter in by_name if name not in OF_EVERY_NODE}
    return {name: list(value) if isinstance(value, array | tuple) else value for name, value in values.items()}


def parameters_yaml(node: Node) -> str:
    """Returns the node's current parameters by name, in YAML."""
    return yaml.safe_dump(parameters(node))
