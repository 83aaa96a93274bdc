"""Human reaction, a layer around any policy: agents react after a time, and braking builds up.

An agent that is taken over drives on as its log did until its reaction time, from the step of the detection on, is
over. After that, as long as it is under control, its braking and the growth of its braking are limited.

The careful and competent driver of UN Regulation 157 takes 0.75 s, brakes up to 0.774 g, and builds that up with
12.65 m/s3. Published reaction times are around 0.70 to 0.75 s for expected events, and around 1.25 s for unexpected
ones (Green 2000); their log-normal distribution is an assumption.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from litsim_policy.driving.policy import Policy
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.parameters import ParameterReader
from litsim_sim.core.quantities import Acceleration, Duration, Jerk, NonNegative, Number, Positive, configuration
from litsim_sim.core.scene import STEP_S, AgentTable, ControlSource, ControlTable, FloatArray, IntArray
from litsim_sim.core.takeover import Takeover, TakeoverReason, TakeoverState, TakeoverTable
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.setting import Setting

LATE = int(ControlSource.LATE)
DRAW = 715  # distinguishes these draws from others with the same seeds and ids


@configuration
class ReactionConfig:
    """How people react.

    Attributes:
        time: median time until an agent reacts to its takeover; 0 for at once.
        spread: standard deviation of its logarithm over agents; 0 for the same time for all.
        braking_max: hardest braking of agents under control.
        braking_jerk: jerk with which braking builds up; 0 for at once.
    """

    time: NonNegative[Duration] = 0.0
    spread: NonNegative[Number] = 0.0
    braking_max: Positive[Acceleration] = 8.0
    braking_jerk: NonNegative[Jerk] = 0.0


class HumanReaction(Policy):
    """The commands of `policy`, delayed and limited as for human drivers."""

    def __init__(self, policy: Policy, scenario: Setting, config: ReactionConfig) -> None:
        self.policy, self._config, self._log = policy, config, scenario.log
        self._steps = reaction_steps(config, scenario.identities)
        self._at_once = not self._steps.any()

    def act(self, table: AgentTable, takeovers: TakeoverTable) -> ControlTable:
        """See :class:`litsim_policy.driving.policy.Policy`."""
        wanted = self.policy.act(table, takeovers)
        if not len(wanted.id):
            return wanted
        rows = table.rows(wanted.id)
        eased = np.maximum(wanted.acceleration, self._hardest(table.acceleration[rows]))
        acceleration = np.where(wanted.source != LATE, eased, wanted.acceleration)
        if self._at_once:
            return ControlTable.without_slip(table, rows, acceleration, wanted.yaw_rate, wanted.source)
        by_agent = {t.agent: t for t in takeovers.takeovers}
        yaw_rate, source = wanted.yaw_rate.copy(), wanted.source.copy()
        for k, agent in enumerate(wanted.id.tolist()):
            takeover = by_agent[agent]
            if self._unaware(takeover, table.step):
                logged = self._as_logged(takeover, table.step)
                if logged is not None:
                    acceleration[k], yaw_rate[k] = logged
                    source[k] = ControlSource.POLICY
        return ControlTable.without_slip(table, rows, acceleration, yaw_rate, source)

    def _hardest(self, before: FloatArray) -> FloatArray:
        """Returns lowest accelerations (m,) [m/s2] that are possible now, after those of the step `before` (m,)."""
        config = self._config
        if not config.braking_jerk:
            return np.full(len(before), -config.braking_max)
        return np.maximum(-config.braking_max, np.minimum(before, 0.0) - config.braking_jerk * STEP_S)

    def _unaware(self, takeover: Takeover, step: int) -> bool:
        """Returns whether the driver has not reacted yet."""
        if takeover.reason != TakeoverReason.CONFLICT or takeover.state != TakeoverState.HELD:
            return False
        row = int(self._log.ids.searchsorted(takeover.agent))
        return step - takeover.detected_step < int(self._steps[row])

    def _as_logged(self, takeover: Takeover, step: int) -> tuple[float, float] | None:
        """Acceleration [m/s2] and yaw rate [rad/s] of the agent's log, with its lag; None if the log is over."""
        log: Log = self._log
        row, now = int(log.ids.searchsorted(takeover.agent)), step - round(takeover.time_shift / STEP_S)
        if now < 0 or now + 1 >= log.valid.shape[1] or not (log.valid[row, now] and log.valid[row, now + 1]):
            return None
        faster = (log.speed[row, now + 1] - log.speed[row, now]) / STEP_S
        return float(faster), float(wrap_angle(log.yaw[row, now + 1] - log.yaw[row, now])) / STEP_S


def read_reaction(read: ParameterReader) -> Callable[[Policy, Setting], Policy]:
    """Read the parameters ``reaction.*``; the result limits a policy to human reactions, if they do."""
    config = read(ReactionConfig(), "reaction.")
    if config == ReactionConfig():
        return lambda policy, _: policy
    return lambda policy, scenario: HumanReaction(policy, scenario, config)


def reaction_steps(config: ReactionConfig, identities: IntArray) -> IntArray:
    """Returns steps (N,) until the agents react, drawn by seed and id (N, 2), independently of other agents."""
    if not config.spread or not config.time:
        return np.full(len(identities), round(config.time / STEP_S))
    drawn = [np.random.default_rng([*identity, DRAW]).standard_normal() for identity in identities.tolist()]
    times = config.time * np.exp(config.spread * np.array(drawn))
    return np.array([math.floor(t / STEP_S + 0.5) for t in times.tolist()], np.int64)
