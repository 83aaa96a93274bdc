"""Autoware among the egos: what `--ego autoware` and `--ego autoware_universe` mean."""

from __future__ import annotations

from litsim_sim.launch.adapters import EgoAdapter

START_S = 300.0  # [s] for Autoware to start and to plan its first route

CORE = EgoAdapter("litsim_autoware", "autoware", ("--profile", "core"), ready_s=START_S)
UNIVERSE = EgoAdapter("litsim_autoware", "autoware", ("--profile", "universe"), ready_s=START_S)
