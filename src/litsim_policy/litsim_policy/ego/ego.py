"""What every driver of the ego is: a plug-in of ``litsim.egos``."""

from __future__ import annotations

from abc import ABC, abstractmethod

from litsim_sim.core.plugins import Configured
from litsim_sim.core.scene import AgentTable, EgoCommand


class Ego(Configured, ABC):
    """Drives the ego.

    It is made for a run as ``cls(scenario)``, or as ``cls(scenario, configuration)`` if it has parameters, with the
    :class:`~litsim_sim.scenario.scenario.Scenario` of the run. :meth:`plan` is called once per step, in order.
    """

    @abstractmethod
    def plan(self, table: AgentTable) -> EgoCommand:
        """Returns the command for the step of `table`."""
