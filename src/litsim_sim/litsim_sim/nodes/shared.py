"""Imports that all nodes share, for the process that forks them; see :mod:`litsim_sim.launch.forked`."""

from __future__ import annotations

from importlib import import_module

from rcl_interfaces.msg import ParameterEvent
from rclpy.type_description_service import GetTypeDescription
from rclpy.type_support import check_for_type_support

import litsim_sim.ros.stage  # noqa: F401 - rclpy, messages, scenarios: what takes longest to import
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.kernels.imports import left_out
from litsim_sim.launch.forked import keep_imports
from litsim_sim.ros.topics import RECORDED_TOPICS

OF_EVERY_NODE = (ParameterEvent, GetTypeDescription)
"""One type of each package whose types every rclpy node uses; its type support is loaded with all of the package."""


def prepare_nodes() -> None:
    """Import all that nodes share, and keep it in shared memory pages."""
    load_kernels()
    with left_out("rosidl_generator_py.generate_py_impl"):  # which is for building messages, and brings parsers along
        import_module("rosidl_generator_py")
    for each in {*OF_EVERY_NODE, *(topic.type for topic in RECORDED_TOPICS)}:  # with all others of their packages
        check_for_type_support(each)
    keep_imports()
