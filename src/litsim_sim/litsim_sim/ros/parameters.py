"""The parameters of nodes: read, checked and declared as the configurations of their stages say."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import ParameterOverrides, ParameterReader

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy declares itself."""

Made = TypeVar("Made")


def read_parameters(node: Node, stage: Callable[[ParameterReader], Made]) -> Made:
    """Let `stage` read its configurations from what `node` was given, and declare them as read-only parameters.

    The node has to be made with ``automatically_declare_parameters_from_overrides``: ROS would refuse a whole number
    for a parameter whose default is none, and say nothing of one that nobody declares.

    Raises:
        InputError: a parameter is unknown, or does not fit.
    """
    read = ParameterOverrides(node.get_name(), parameters(node))
    made = stage(read)
    read.check()
    for name, value in read.values.items():
        if node.has_parameter(name):
            node.undeclare_parameter(name)
        node.declare_parameter(name, value, ParameterDescriptor(read_only=True), ignore_override=True)
    return made


def undeclare_given(node: Node) -> frozenset[str]:
    """Take back the declarations of what `node` was given, to be declared with a type and a default; returns the names.

    The node has to be made with ``automatically_declare_parameters_from_overrides``. For nodes whose parameters may
    change while they run; all others use :func:`read_parameters`.
    """
    given = frozenset(parameters(node))
    for name in given:
        node.undeclare_parameter(name)
    return given


def check_given(node: Node, given: frozenset[str]) -> None:
    """Refuse parameters that were given and that `node` has not declared; ROS would ignore them.

    Raises:
        InputError: there are such.
    """
    declared = parameters(node)
    if unknown := sorted(given - declared.keys()):
        raise InputError(
            f"{node.get_name()}: unknown parameter {', '.join(unknown)}; expected {', '.join(declared) or 'none'}"
        )


def parameters(node: Node) -> dict[str, Any]:
    """The parameters of `node` by name, in their order, but for those that rclpy declares itself; arrays as lists."""
    found = sorted(node.get_parameters_by_prefix("").items())
    return {name: _plain(parameter.value) for name, parameter in found if name not in OF_EVERY_NODE}


def parameters_yaml(node: Node) -> str:
    """The node's parameters as it runs with them, by name, in YAML."""
    return yaml.safe_dump(parameters(node))


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, array | list | tuple) else value
