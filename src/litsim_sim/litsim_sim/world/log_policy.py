"""Policy L: agents follow the recording, and return to it without a jump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from litsim_sim.core.geometry import smooth_step, wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray
from litsim_sim.scenario.log import Log

COMFORT_ACCELERATION = 1.5  # [m/s2] largest acceleration that the fade of a residual adds to the logged motion
FADE_MIN_S = 1.0  # [s] shortest fade


class Offsets(NamedTuple):
    """Offset of an agent from its log at a step, while its residual fades.

    Attributes:
        position: (2,) offset from the logged box centre in frame map [m].
        velocity: (2,) offset from the logged velocity in frame map [m/s], the derivative of `position`.
        acceleration: (2,) the derivative of `velocity` [m/s2].
        yaw: offset from the logged heading [rad].
        yaw_rate: the derivative of `yaw` [rad/s].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    yaw: float
    yaw_rate: float


@dataclass(frozen=True)
class Residual:
    """Offset of an agent from its log at its release, and the duration of its fade.

    Attributes:
        step: step of the release.
        steps: duration of the fade.
        position: (2,) offset from the logged box centre in frame map [m].
        velocity: (2,) offset from the logged velocity in frame map [m/s].
        yaw: offset from the logged heading [rad].
    """

    step: int
    steps: int
    position: np.ndarray
    velocity: np.ndarray
    yaw: float

    @classmethod
    def between(cls, table: AgentTable, row: int, logged: AgentTable, logged_row: int) -> Residual:
        """Returns the residual of the agent in `row` of `table` against the same agent in `logged`."""

        def velocity(table: AgentTable, i: int) -> np.ndarray:
            return table.speed[i] * np.array([np.cos(table.yaw[i]), np.sin(table.yaw[i])])

        position = np.array([table.x[row] - logged.x[logged_row], table.y[row] - logged.y[logged_row]])
        rate = velocity(table, row) - velocity(logged, logged_row)
        yaw = float(wrap_angle(table.yaw[row] - logged.yaw[logged_row]))
        # Peaks of the second derivatives of the two blends below: 5.77 and 3.94. They come together, so the duration T
        # solves 5.77 offset / T^2 + 3.94 rate / T = COMFORT_ACCELERATION.
        linear = 0.5 * 3.94 * float(np.hypot(*rate)) / COMFORT_ACCELERATION
        constant = 5.77 * float(np.hypot(*position)) / COMFORT_ACCELERATION
        duration = max(FADE_MIN_S, linear + np.sqrt(linear**2 + constant))
        return cls(table.step, int(np.ceil(duration / STEP_S)), position, rate, yaw)

    def at(self, step: int) -> Offsets:
        """Returns the offsets at `step`; zero once faded.

        Quintics that start with the residual's value and rate and end with value, rate and acceleration zero.
        """
        s = min(1.0, (step - self.step) / self.steps)
        duration = self.steps * STEP_S
        value, slope = 1 - float(smooth_step(s)), -30 * s**2 * (1 - s) ** 2
        drift, drift_slope = s * (1 - s**2 * (6 - 8 * s + 3 * s**2)), 1 - s**2 * (18 - 32 * s + 15 * s**2)
        bend, drift_bend = -60 * s * (1 - s) * (1 - 2 * s), -12 * s * (1 - s) * (3 - 5 * s)
        return Offsets(
            position=self.position * value + self.velocity * (duration * drift),
            velocity=self.position * (slope / duration) + self.velocity * drift_slope,
            acceleration=self.position * (bend / duration**2) + self.velocity * (drift_bend / duration),
            yaw=self.yaw * value,
            yaw_rate=self.yaw * slope / duration,
        )


class LogPolicy:
    """Logged poses of every agent, with the residuals of released agents fading out.

    An agent can be released with a lag: its log is then replayed with that delay, from the logged pose nearest to the
    agent, so that it need not make up for lost time.
    """

    def __init__(self, log: Log) -> None:
        self.log = log
        self._residuals: dict[int, Residual] = {}
        self._lag = np.zeros(len(log.ids), np.int64)
        self._prepared: AgentTable | None = None

    def prepare(self, step: int) -> None:
        """Look up the logged agents at `step` in advance, for :meth:`table`."""
        self._prepared = self.log.table(step, self._lag)

    def release(self, table: AgentTable, agent: int, with_lag: bool = False) -> None:
        """Let `agent`, as it moves in `table`, follow its log again from the next step on.

        It is replayed with the lag of :meth:`litsim_sim.scenario.log.Log.lags` if `with_lag`, else without any.
        """
        row, log_row = table.row(agent), self.log.row(agent)
        self._prepared = None
        log_rows, place = np.array([log_row]), slice(row, row + 1)
        self._lag[log_rows] = self.log.lags(log_rows, table.step, table.x[place], table.y[place]) if with_lag else 0
        logged = self.log.table(table.step, self._lag)
        logged_row = logged.row(agent)
        if logged_row >= 0:
            self._residuals[agent] = Residual.between(table, row, logged, logged_row)

    def displaced(self, table: AgentTable) -> BoolArray:
        """Returns the mask (n,) of the agents of `table`, from :meth:`table`, with a lag or a residual."""
        late = self._lag[self.log.ids.searchsorted(table.id)] > 0
        return late | table.mask(np.array(sorted(self._residuals), np.int64))

    def table(self, step: int) -> AgentTable:
        """Returns the agents at the poses of policy L at `step`, with controller LOG."""
        table, self._prepared = self._prepared, None
        if table is None or table.step != step:
            table = self.log.table(step, self._lag)
        for agent, residual in list(self._residuals.items()):
            row = table.row(agent)
            if row < 0 or step - residual.step >= residual.steps:
                del self._residuals[agent]
                continue
            off = residual.at(step)
            table.yaw[row] += off.yaw
            table.x[row] += off.position[0]
            table.y[row] += off.position[1]
            # Logged value plus offset, both along the current heading of the agent.
            along, cos = np.array([np.cos(table.yaw[row]), np.sin(table.yaw[row])]), np.cos(off.yaw)
            speed = table.speed[row] * cos + off.velocity @ along
            table.speed[row] = max(0.0, speed)
            table.acceleration[row] = table.acceleration[row] * cos + off.acceleration @ along if speed > 0.0 else 0.0
            table.yaw_rate[row] += off.yaw_rate
        return table
