"""The ego `log`, which replays its own log: a sanity check, in which every takeover is a false alarm."""

from __future__ import annotations

from litsim_policy.ego.ego import Ego
from litsim_sim.core.scene import AgentTable, EgoCommand, EgoMode
from litsim_sim.scenario.scenario import Scenario


class LogEgo(Ego):
    """Asks the bridge to follow the log."""

    def __init__(self, scenario: Scenario) -> None:
        """Takes nothing from `scenario`: the bridge knows the log."""

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.ego.Ego`."""
        return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
