"""The ego `log`, which replays its own log: a sanity check, in which every takeover is a false alarm."""

from __future__ import annotations

from litsim_sim.core.scene import AgentTable, EgoCommand, EgoMode


class LogEgo:
    """Asks the bridge to follow the log."""

    def plan(self, table: AgentTable) -> EgoCommand:
        """See :class:`litsim_policy.ego.registry.Ego`."""
        return EgoCommand(table.step, mode=EgoMode.FOLLOW_LOG)
