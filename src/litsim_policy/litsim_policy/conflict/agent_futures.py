"""The futures of agents that conflict detection compares: by their logs, as forecast, or as intended under control."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.futures import OtherMotions, PredictedMotion, follow_logs, hold_back, interpolate
from litsim_policy.conflict.intended import Intents, intended_motion
from litsim_policy.motion.along_path import Poses
from litsim_predictor.forecast import Forecast, Modes
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.log import Log


class AgentFutures:
    """Makes the futures of agents, every 0.1 s up to the horizon of `config`."""

    def __init__(self, log: Log, config: ConflictConfig) -> None:
        self._log, self._config = log, config
        self._steps = int(config.horizon / STEP_S + 1e-9)

    def logged(self, table: AgentTable, lag: IntArray | None = None) -> PredictedMotion:
        """The future of all agents by their logs.

        An agent on its log keeps its present residual, if any; an agent off its log is put back onto it at once.

        Args:
            table: n agents.
            lag: (n,) steps by which the replay of each log lags; None for no lag.
        """
        log, rows = self._log, self._log.ids.searchsorted(table.id)
        now = np.full(len(table), table.step) if lag is None else table.step - lag
        return PredictedMotion(
            *follow_logs(log.x, log.y, log.yaw, log.valid, rows, now, self._steps, table.x, table.y, ~table.off_log)
        )

    def forecast(self, table: AgentTable, forecast: Forecast) -> PredictedMotion:
        """The forecast motion of all agents, for any `dt` of the forecast; not valid for agents without a forecast.

        Between the instants of the forecast, and from the present pose to the first of them, centres, headings and
        covariances are interpolated linearly; now, the covariance is zero. Nothing is valid beyond its last instant.
        Agents that brake hard are moved back along the forecast accordingly; see `ConflictConfig.braking_time`.

        Args:
            table: n agents.
            forecast: of the same step.
        """
        return self.expected(table, forecast, np.ones(len(table), np.bool_))

    def expected(
        self, table: AgentTable, forecast: Forecast, of: BoolArray, intents: Intents | None = None
    ) -> PredictedMotion:
        """The motion of some agents, as forecast, or as intended under control; not valid for all others.

        Args:
            table: n agents.
            forecast: of the same step.
            of: mask (n,) of these agents.
            intents: agents under control, all of them in `of`; None for none.
        """
        rows = forecast.rows(table.id)
        rows[~of] = -1
        states, valid = self._interpolated(forecast, forecast.dt, rows, (table.x, table.y, table.yaw))
        hard = self._brakes_hard(table) & (rows >= 0)
        for row in hard.nonzero()[0]:
            self._hold_back(states[row], table, int(row))
        config = self._config
        if config.intent.used and intents is not None and len(intents.rows):
            at = intents.rows
            forecasts = PredictedMotion(states[at], valid[at])
            motion = intended_motion(config.intent, intents, table, forecasts, config.sigma_scale)
            states[at], valid[at], rows[at] = motion.states, motion.valid, -1  # no other manoeuvres
        return PredictedMotion(states, valid, self._others(table, forecast, rows, hard))

    def _others(self, table: AgentTable, forecast: Forecast, rows: IntArray, hard: BoolArray) -> OtherMotions:
        """Other manoeuvres of the agents, by `forecast`.

        Args:
            table: n agents.
            forecast: of the same step.
            rows: (n,) of the agents in it; -1 for those not wanted.
            hard: mask (n,) of those that brake hard.
        """
        modes, known = forecast.modes, (rows >= 0).nonzero()[0]
        agent_of = np.full(len(forecast.id), -1, np.int64)
        agent_of[rows[known]] = known
        agent = agent_of[modes.row]
        asked = (agent >= 0).nonzero()[0]
        if not len(asked):
            return OtherMotions.none(self._steps)
        agent = agent[asked]
        kept = modes.probability[asked].astype(np.float64)
        total = forecast.share[modes.row[asked]] + np.bincount(agent, kept, len(table))[agent]
        now = table.x[agent], table.y[agent], table.yaw[agent]
        states, valid = self._interpolated(modes, forecast.dt, asked, now)
        for k in hard[agent].nonzero()[0]:
            self._hold_back(states[k], table, int(agent[k]))
        return OtherMotions(agent, kept / total, states, valid)

    def _interpolated(
        self, motions: Forecast | Modes, dt: float, rows: IntArray, now: Poses
    ) -> tuple[FloatArray, BoolArray]:
        """States (k, T, 6) and validity (k, T) of motions, every 0.1 s.

        Args:
            motions: the most probable motions of a forecast, or its alternatives.
            dt: between the instants of `motions` [s].
            rows: (k,) of the motions in `motions`; -1 for none.
            now: poses (k,) from which they begin.
        """
        return interpolate(
            np.ascontiguousarray(motions.mean),
            np.ascontiguousarray(motions.yaw),
            np.ascontiguousarray(motions.covariance),
            dt,
            rows,
            self._steps,
            self._config.sigma_scale,
            *now,
        )

    def _brakes_hard(self, table: AgentTable) -> BoolArray:
        """Mask (n,) of agents that are assumed to keep braking hard; see `ConflictConfig.braking_time`."""
        config = self._config
        braking = -table.acceleration
        return (braking > 0.0) & (braking >= np.where(table.of_ego, config.braking_hard, config.emergency))

    def _hold_back(self, states: FloatArray, table: AgentTable, row: int) -> None:
        """Hold the motion `states` (T, 6) of the agent in `row` back in place, as its braking requires."""
        speed, braking = table.speed[row], -table.acceleration[row]
        hold_back(states, table.x[row], table.y[row], speed, braking, self._config.braking_time)
