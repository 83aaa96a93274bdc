"""Stop lines at signals: a red light counts as a leader that stands at the stop line.

Agents stop at red if the maximum braking suffices, and at amber if comfortable braking does. Agents that are too near
when a light changes drive on, as people do.
"""

from __future__ import annotations

import numpy as np

from litsim_policy.motion.car_following import GAP_MIN, IdmConfig, idm_acceleration
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.signals import AMBER_STATES, STOP_STATES
from litsim_sim.lane_map.signal_links import FACING, PASSED
from litsim_sim.scenario.signals import LinkSignals

IS_RED, IS_AMBER = (np.isin(np.arange(256), states) for states in (STOP_STATES, AMBER_STATES))  # masks by state
ON_WAY = 1.6  # [m] from a lane's centre line within which a path is on the lane: half the width of a narrow lane
FREE = np.inf
RED_BRAKING = 8.0  # [m/s2] most braking for a stop at red
AMBER_BRAKING = 3.0  # [m/s2] most braking for a stop at amber: what is comfortable


class StopLines:
    """Distances of agents on paths to the stop lines at which they must stop."""

    def __init__(self, signals: LinkSignals | None) -> None:
        self._signals = signals
        links = () if signals is None else signals.links
        self._stop = np.array([link.stop for link in links]).reshape(-1, 2)
        self._exit = np.array([link.exit for link in links]).reshape(-1, 2)
        self._heading = np.array([link.heading for link in links])

    @property
    def any(self) -> bool:
        """Whether there are signals on the road."""
        return self._signals is not None

    def gaps(self, table: AgentTable, rows: IntArray, paths: PathBatch, s: FloatArray) -> FloatArray:
        """Distances (m,) [m] from the agents' fronts to the lines at which they must stop; infinite without a stop.

        They are in `rows` (m,), at arc lengths `s` (m,) [m] on their paths.
        """
        distance = np.full(len(rows), FREE)
        if self._signals is None or not len(rows):
            return distance
        state, scene = self._signals.of_links(table.step), table.scene[rows]
        red = IS_RED[state]
        path, link = (red | IS_AMBER[state])[scene].nonzero()
        if not len(path):
            return distance
        line = paths.project(path, *np.ascontiguousarray(self._stop[link].T))
        gap = line.s - (s + 0.5 * table.length[rows])[path]
        needed = table.speed[rows][path] ** 2 / (2.0 * np.maximum(gap, GAP_MIN))
        bound = np.where(red[scene[path], link], RED_BRAKING, AMBER_BRAKING)
        ahead = ((np.abs(line.d) <= ON_WAY) & (gap > -PASSED) & (needed <= bound)).nonzero()[0]
        ahead = ahead[self._taken(paths, path[ahead], link[ahead], line.segment[ahead], line.s[ahead])]
        np.minimum.at(distance, path[ahead], np.maximum(gap[ahead], GAP_MIN))
        return distance

    def of(self, agents: PathFollowers) -> FloatArray:
        """Returns the :meth:`gaps` (m,) [m] of agents that follow paths, at the step of their table."""
        if self._signals is None:
            return np.full(len(agents), FREE)
        return self.gaps(agents.table, agents.rows, agents.paths, agents.s)

    def _taken(self, paths: PathBatch, path: IntArray, link: IntArray, segment: IntArray, s: FloatArray) -> BoolArray:
        """Returns whether paths take links (k,), whose stop lines are in their `segment`, at arc lengths `s` [m]."""
        leave = paths.project(path, *np.ascontiguousarray(self._exit[link].T))
        facing = np.cos(paths.heading(path, segment) - self._heading[link]) >= FACING
        return (np.abs(leave.d) <= ON_WAY) & facing & (leave.s > s)


def idm_at_signals(
    config: IdmConfig, speed: FloatArray, desired_speed: FloatArray, acceleration: FloatArray, gap: FloatArray
) -> FloatArray:
    """Returns the lesser of `acceleration` (m,) [m/s2] and that of the model for a stop after `gap` [m]."""
    rows = (gap < FREE).nonzero()[0]
    if not len(rows):
        return acceleration
    limited = acceleration.copy()
    standing = np.zeros((len(rows), 1))
    limited[rows] = np.minimum(
        limited[rows], idm_acceleration(config, speed[rows], desired_speed[rows], gap[rows][:, None], standing)
    )
    return limited
