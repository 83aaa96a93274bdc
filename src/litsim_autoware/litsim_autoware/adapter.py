"""Autoware among the egos: what `--ego autoware` and `--ego autoware_universe` mean."""

from __future__ import annotations

from litsim_sim.launch.adapters import EgoAdapter

START_S = 300.0  # [s] for Autoware to start and to plan its first route

CONTROL = "/control/command/control_cmd"


def _adapter(profile: str, *record: str) -> EgoAdapter:
    """The adapter of a packaged profile, which records what the stack plans, commands, and says of its state."""
    return EgoAdapter("litsim_autoware", "autoware", ("--profile", profile), (*record, CONTROL), START_S)


CORE = _adapter("core", "/planning/trajectory", "/system/fail_safe/mrm_state")
UNIVERSE = _adapter("universe", "/planning/scenario_planning/trajectory", "/api/fail_safe/mrm_state")
