"""What every predictor by name is: a plug-in of ``litsim.predictors``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from litsim_predictor.forecast import Forecast
from litsim_predictor.selection import Wanted
from litsim_sim.core.plugins import Configured
from litsim_sim.core.scene import AgentTable


@dataclass(frozen=True)
class Scope:
    """Whom a predictor forecasts, and what of it.

    Attributes:
        roi_m: radius around agents off their log within which agents are looked at [m].
        wanted: the agents that are forecast.
        modes: greatest number of manoeuvres of each besides the most probable one.
        along_lanes: whether learned models forecast along lanes that bend.
    """

    roi_m: float
    wanted: Wanted = Wanted.READ
    modes: int = 0
    along_lanes: bool = True


class PredictorPlugin(Configured, ABC):
    """Forecasts traffic, as a :class:`litsim_predictor.forecast.Predictor`.

    It is made for a run as ``cls(scenario, scope)``, or with its configuration as third argument if it has parameters.

    Attributes:
        batched: whether it also forecasts the agents of several scenes at once, which do not see each other.
    """

    batched: ClassVar[bool] = False

    @abstractmethod
    def observe(self, table: AgentTable) -> None:
        """Take note of a step for which no forecast is needed."""

    @abstractmethod
    def forecast(self, table: AgentTable) -> Forecast:
        """Forecast agents of `table` that matter to the ego and to those off their log; see :mod:`.selection`."""
