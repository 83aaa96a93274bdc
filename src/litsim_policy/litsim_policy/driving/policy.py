"""What every policy of the background is: a plug-in of ``litsim.policies``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from litsim_sim.core.plugins import Configured
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable


class Policy(Configured, ABC):
    """Drives the agents that are off their logs.

    It is made for a run as ``cls(scenario)``, or as ``cls(scenario, configuration)`` if it has parameters, with the
    :class:`~litsim_sim.scenario.setting.Setting` of the run. :meth:`act` is called once per step, in order.

    Attributes:
        by_region: whether it drives every agent that comes near the ego, for good, and without forecasts, as the
            baselines of the paper do. Otherwise it drives those with a predicted conflict, until that is past.
        batched: whether it also drives the agents of several scenes at once, which must not react to each other (see
            `AgentTable.scene`), so that campaigns step several runs together.
        drives_walkers: whether it also drives walkers and cyclists whose way is blocked; otherwise they follow their
            logs.
    """

    by_region: ClassVar[bool] = False
    batched: ClassVar[bool] = False
    drives_walkers: ClassVar[bool] = False

    @abstractmethod
    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """Controls for the agents of `takeovers` at the step of `table`; agents without controls follow their logs."""
