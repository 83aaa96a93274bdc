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


def undeclare_set(node: Node) -> frozenset[str]:
    """Undeclare the parameters that the user has set, to be declared with type and default; return their names.

    The node must be made with ``automatically_declare_parameters_from_overrides``. For nodes whose parameters may
    change at run time; all others use :func:`read_parameters`.
    """
    names = frozenset(parameters(node))
    for name in names:
        node.undeclare_parameter(name)
    return names


def check_set(node: Node, names: frozenset[str]) -> None:
    """Raise InputError if `node` has not declared some of the parameters `names`, which ROS would ignore."""
    declared = parameters(node)
    if unknown := sorted(names - declared.keys()):
        raise InputError(
            f"{node.get_name()}: unknown parameter {', '.join(unknown)}; expected {', '.join(declared) or 'none'}"
        )


def parameters(node: Node) -> dict[str, Any]:
    """Returns the parameters of `node` by name, without those that rclpy declares; arrays as lists."""
    by_name = sorted(node.get_parameters_by_prefix("").items())
    return {name: _plain(parameter.value) for name, parameter in by_name if name not in OF_EVERY_NODE}


def parameters_yaml(node: Node) -> str:
    """Returns the node's current parameters by name, in YAML."""
    return yaml.safe_dump(parameters(node))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, array | list | tuple) else value
