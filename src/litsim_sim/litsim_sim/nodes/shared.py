"""Imports that all nodes share, for the process that forks them; see :mod:`litsim_sim.launch.forked`."""

from __future__ import annotations

import gc
import inspect

from rclpy.type_support import check_for_type_support

import litsim_sim.ros.stage  # noqa: F401 - rclpy, messages, scenarios: what takes longest to import
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.ros.definitions import definition, type_name
from litsim_sim.ros.topics import EGO_FEEDS, HELLO, RECORDED_TOPICS


def prepare_nodes() -> None:
    """Load what nodes share, and keep present objects in memory pages that copies of this process share.

    These are all kernels, the types of messages, and the files of all modules, through which Python looks for the
    caller of the first line that a node logs: 0.1 s in each process otherwise.

    The garbage collector would touch, and so copy, all of them: a run of 2 s would take 1.18 times the processor time
    (1.08 to 1.32, 5 pairs).
    """
    load_kernels()
    for topic in {HELLO, *RECORDED_TOPICS, *EGO_FEEDS}:
        check_for_type_support(topic.type)
    inspect.getmodule(inspect.currentframe())
    gc.freeze()  # without collecting first: that takes longer than the copies of what little garbage there is


def prepare_reading() -> None:
    """Parse the definitions by which records are read."""
    from litsim_sim.record.decoding import typestore  # a launcher needs it after the run only

    for name in {type_name(topic.type) for topic in RECORDED_TOPICS}:
        typestore(definition(name), name)
