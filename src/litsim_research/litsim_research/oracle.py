"""The predictor called `oracle`: forecasts are where all agents went in an earlier run of the same case."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from litsim_predictor.forecast import Forecast
from litsim_predictor.plugin import PredictorPlugin, Scope
from litsim_predictor.selection import selected
from litsim_sim.core.errors import InputError
from litsim_sim.core.quantities import configuration
from litsim_sim.core.scene import STEP_S, AgentTable, FloatArray, index_of
from litsim_sim.scenario.outcomes import RecordedOutcomes
from litsim_sim.scenario.setting import Setting

STEPS = 50
"""Steps of a forecast, 0.1 s each; beyond the known future, agents go on at their last velocity."""
SIGMA_M = 0.01


@configuration
class OracleConfig:
    """Where the earlier runs are.

    Attributes:
        outcomes: folder of their recorded outcomes (:class:`litsim_sim.scenario.outcomes.RecordedOutcomes`).
    """

    outcomes: str = ""


class Oracle(PredictorPlugin):
    """Forecasts agents as they went on in the earlier run, from where they are now.

    Agents that were not on the road then have no forecast.
    """

    defaults, prefix = OracleConfig(), "oracle."
    batched = True

    def __init__(self, scenario: Setting, scope: Scope, config: OracleConfig) -> None:
        """See :class:`litsim_predictor.plugin.PredictorPlugin`.

        Raises:
            InputError: the folder does not hold what happened in a run of `scenario`.
        """
        if not config.outcomes:
            raise InputError("predictor: parameter oracle.outcomes is empty, expected the folder of earlier runs")
        self._outcomes = RecordedOutcomes.read(Path(config.outcomes), scenario)
        self._ids, self._ego_ids, self._scope = scenario.log.ids, scenario.ego_ids, scope

    def observe(self, table: AgentTable) -> None:
        """Nothing is remembered."""

    def forecast(self, table: AgentTable) -> Forecast:
        """See :class:`litsim_predictor.forecast.Predictor`."""
        agents, rows = selected(table, self._ego_ids, self._scope.roi_m, self._scope.wanted)
        agents = agents.take(rows)
        if not len(agents):
            return Forecast.empty(table.step)
        poses, valid = self._futures(agents)
        spread = np.zeros((len(agents), STEPS, 3), np.float32)
        spread[..., :2] = SIGMA_M
        nothing = np.empty((len(agents), 0), np.float32)
        yaw = poses[..., 2].astype(np.float32)
        return Forecast(
            table.step, STEP_S, agents.id, np.ascontiguousarray(poses[..., :2]), yaw, spread, nothing, valid
        )

    def _futures(self, agents: AgentTable) -> tuple[FloatArray, np.ndarray]:
        """Returns (n, STEPS, 3) poses from the next step on, and (n,) whether an agent's are known."""
        there, pose = self._outcomes.there, self._outcomes.pose
        poses, valid = np.zeros((len(agents), STEPS, 3)), np.zeros(len(agents), np.bool_)
        for k, row in enumerate(index_of(self._ids, agents.id).tolist()):
            now = agents.step
            if row < 0 or now >= there.shape[1] or not there[row, now]:
                continue
            known = int(np.argmin(np.append(there[row, now:], False)))  # steps in a row, this one included
            ahead = np.minimum(np.arange(1, STEPS + 1), known - 1)
            beyond = np.arange(1, STEPS + 1) - ahead
            last = pose[row, now + known - 1]
            velocity = last - pose[row, now + known - 2] if known > 1 else np.zeros(3)
            velocity[2] = 0.0
            offset = np.array([agents.x[k], agents.y[k], agents.yaw[k]]) - pose[row, now]
            poses[k] = pose[row, now + ahead] + beyond[:, None] * velocity + offset
            valid[k] = True
        return poses, valid
