"""Imports that all nodes share, for the process that forks them; see :mod:`litsim_sim.launch.forked`."""

from __future__ import annotations

import gc

import litsim_sim.ros.stage  # noqa: F401 - rclpy, messages, scenarios: what takes longest to import
from litsim_sim.kernels.compiled import load_kernels


def prepare_nodes() -> None:
    """Load all kernels that nodes share, and keep present objects in memory pages that copies of this process share.

    The garbage collector would touch, and so copy, all of them: a run of 2 s would take 1.18 times the processor time
    (1.08 to 1.32, 5 pairs).
    """
    load_kernels()
    gc.freeze()  # without collecting first: that takes longer than the copies of what little garbage there is
