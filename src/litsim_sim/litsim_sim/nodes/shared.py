"""What all nodes have in common, for a process that forks them: see :mod:`litsim_sim.launch.forked`."""

from __future__ import annotations

import litsim_sim.ros.stage  # noqa: F401 - rclpy, messages, scenarios: what takes longest to import
from litsim_sim.core.compiled import load_kernels
from litsim_sim.launch.forked import keep_imports


def prepare_nodes() -> None:
    """Have all that nodes share be there by now, and stay shared."""
    load_kernels()
    keep_imports()
