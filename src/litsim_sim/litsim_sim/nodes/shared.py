"""Imports that all nodes share, for the process that forks them; see :mod:`litsim_sim.launch.forked`."""

from __future__ import annotations

import litsim_sim.ros.stage  # noqa: F401 - rclpy, messages, scenarios: what takes longest to import
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.launch.forked import keep_imports


def prepare_nodes() -> None:
    """Import all that nodes share, and keep it in shared memory pages."""
    load_kernels()
    keep_imports()
