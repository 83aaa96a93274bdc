"""The reaction of the background to a step: predictor, conflict and policy, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from litsim_predictor.forecast import Forecast
from litsim_sim.core.scene import AgentTable, ControlTable
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.scenario.setting import Setting


class Pipeline:
    """Predictor, conflict and policy stages of one scene or of several batched ones.

    Attributes:
        manager: of the takeovers.
    """

    def __init__(
        self,
        stages: Mapping[str, Callable[..., Any]],
        policy: str,
        scenario: Setting,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Build the stages by their constructors, for `policy` and `scenario`; `clock` [s] times them."""
        self._history_steps, self._clock = scenario.history_steps, clock
        self._predictor = stages["predictor"](policy, scenario)
        self.manager = stages["conflict"](policy, scenario)
        self._policy = stages["policy"](policy, scenario)

    def to(self, table: AgentTable, marks: dict[str, float]) -> tuple[TakeoverTable, ControlTable]:
        """Takeovers and controls for the step of `table`; adds the stages' times [s] to `marks`."""
        begin = self._clock()
        forecast = self._forecast(table)
        forecast_at = self._clock()
        takeovers = self.manager.update(table, forecast)
        taken_at = self._clock()
        controls = self._policy.act(table, takeovers)
        marks["predictor"], marks["conflict"] = forecast_at - begin, taken_at - forecast_at
        marks["policy"] = self._clock() - taken_at
        return takeovers, controls

    def _forecast(self, table: AgentTable) -> Forecast:
        """The forecast of a step; an empty one in the history, in which no agent is driven."""
        if table.step >= self._history_steps:
            return self._predictor.forecast(table)
        self._predictor.observe(table)
        return Forecast.empty(table.step)
