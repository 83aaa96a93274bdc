"""Passing: an agent held behind a permanently slow one changes to an adjacent lane, and returns from there."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.config import PassingConfig
from litsim_policy.conflict.diverged import HELD, LOGGED, RELEASED, DivergedAgents, Residuals
from litsim_policy.motion.along_path import AlongPath, along_paths
from litsim_policy.motion.lane_change import LaneChanges, weigh_changes
from litsim_policy.motion.lane_lines import NO_LANE, LaneLines
from litsim_policy.motion.route import Router
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import BOOLS, FLOATS, INTS, OUT_INTS, float64, kernel
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log

IN_LANE = 1.0  # [m] largest distance from the centre line of an agent that drives in a lane, rather than between two
APART = 1.8  # [m] distance from the logged path, half a lane, beyond which an agent is in another lane than its log
ABREAST = 40.0  # [m] distance within which only one agent begins a lane change at a step; others react at the next
INTENT = 2.0  # [s] time after which an agent's position on its path shows the lane into which it moves


class Passing:
    """Lets agents off their logs pass; its only state is the lines of the lanes."""

    def __init__(self, lane_map: LaneMap, log: Log, router: Router, config: PassingConfig) -> None:
        self._lane_map, self._log, self._router, self._config = lane_map, log, router, config
        self._lines = LaneLines(lane_map)

    def may_return(
        self, table: AgentTable, diverged: DivergedAgents, rows: IntArray, lag: IntArray, residuals: Residuals
    ) -> BoolArray:
        """Mask (r,) of the agents that have not left the lanes of their logs to pass, or can return to them.

        An agent that is on another road by now, such as a ramp, cannot.

        Args:
            table: all agents.
            diverged: r agents.
            rows: (r,) of the agents in `table`.
            lag: (r,) steps by which their logs lag.
            residuals: of the agents.
        """
        may = np.ones(len(diverged), np.bool_)
        at = ((diverged.beside != NO_LANE) & residuals.known).nonzero()[0]
        if len(at):
            me, log_rows = rows[at], self._log.ids.searchsorted(diverged.agent[at])
            yaw = self._log.yaw[log_rows, self._clipped(table.step - lag[at])]
            here = self._lane_map.nearest(table.x[me], table.y[me], table.yaw[me]).lane
            there = self._lane_map.nearest(residuals.x[at], residuals.y[at], yaw).lane
            may[at] = self._lines.road[here] == self._lines.road[there]
            other = may[at] & (here != there)
            at = at[other]
            may[at] = self._weighed(
                table, diverged, rows, self._desired_speeds(diverged, table, lag), at, here[other], there[other]
            ).safe
        return may

    def change_lanes(self, table: AgentTable, diverged: DivergedAgents, rows: IntArray, lag: IntArray) -> None:
        """Let agents that have been held back for long enough change lane where they can; in place.

        Args:
            table: all agents.
            diverged: r agents; one that is handed back and begins to pass is HELD again.
            rows: (r,) of the agents in `table`.
            lag: (r,) steps by which their logs lag.
        """
        config, desired = self._config, self._desired_speeds(diverged, table, lag)
        diverged.slowed[:] = np.where(table.speed[rows] < desired - config.slower, diverged.slowed + 1, 0)
        self._stay_beside(table, diverged, rows)
        self._give_up(table, diverged, rows, desired)
        waits = (diverged.slowed >= config.patience) & (table.step - diverged.changed_step >= config.again)
        at = ((waits | (diverged.beside != NO_LANE)) & (diverged.state != RELEASED)).nonzero()[0]
        if not len(at):
            return
        here = self._lane_map.nearest(table.x[rows[at]], table.y[rows[at]], table.yaw[rows[at]])
        inside = np.abs(here.d) <= IN_LANE
        at, lane, ahead = at[inside], here.lane[inside], here.s[inside] + config.look
        both, here_lane = np.concatenate([at, at]), np.concatenate([lane, lane])
        there = np.concatenate([self._lines.left[lane], self._lines.right[lane]])
        part = self._lines.beside(here_lane, there) < np.concatenate([ahead, ahead])
        must = part & np.concatenate(self._to_either_side(table, diverged, rows, at, lane))
        can = (there != NO_LANE) & (must | (waits[both] & ~part))
        both, here_lane, there, must = both[can], here_lane[can], there[can], must[can]
        if not len(both):
            return
        changes = self._weighed(table, diverged, rows, desired, both, here_lane, there)
        worth = changes.safe & (must | (changes.gain > config.mobil.threshold))
        if not worth.any():
            return
        me = rows[both]
        for k in _chosen(both, changes.gain, worth, table.scene[me], table.x[me], table.y[me], ABREAST).tolist():
            self._change(table, diverged, int(both[k]), int(rows[both[k]]), int(there[k]))

    def _to_either_side(
        self, table: AgentTable, diverged: DivergedAgents, rows: IntArray, at: IntArray, lane: IntArray
    ) -> tuple[BoolArray, BoolArray]:
        """Masks (k,) of passing agents that have the lanes of their logs to the left, and to the right.

        The agents are those at positions `at` (k,), in lanes `lane` (k,); one passes if it has taken that lane to pass.
        """
        d = diverged.logged_paths.project(at, table.x[rows[at]], table.y[rows[at]]).d
        passes = diverged.beside[at] == lane
        return passes & (d < -APART), passes & (d > APART)

    def _change(self, table: AgentTable, diverged: DivergedAgents, at: int, row: int, lane: int) -> None:
        """Let the agent at position `at` of `diverged`, in `row` of the table, change to `lane` if there is a path."""
        pose = np.array([table.x[row], table.y[row], table.yaw[row]])
        path = self._router.beside(pose, self._config.change_time * float(table.speed[row]), lane)
        if path is not None:
            diverged.pass_along(at, path, lane, table.step)

    def _give_up(self, table: AgentTable, diverged: DivergedAgents, rows: IntArray, desired: FloatArray) -> None:
        """Return agents to their logged paths that are not in their new lanes yet and can no longer change."""
        at = (diverged.beside != NO_LANE).nonzero()[0]
        if not len(at):
            return
        there, me = diverged.beside[at], rows[at]
        line = self._lines.rows(there)
        outside = np.abs(self._lines.made.project(line, table.x[me], table.y[me]).d) > 0.5 * self._lines.width(there)
        if not outside.any():
            return
        at, there, me = at[outside], there[outside], me[outside]
        here = self._lane_map.nearest(table.x[me], table.y[me], table.yaw[me]).lane
        diverged.give_up(at[~self._weighed(table, diverged, rows, desired, at, here, there).room], table.step)

    def _stay_beside(self, table: AgentTable, diverged: DivergedAgents, rows: IntArray) -> None:
        """Keep agents in their present lanes that were returning to those of their logs and are held again."""
        at = ((diverged.changed_step >= 0) & (diverged.state == HELD) & (diverged.source == LOGGED)).nonzero()[0]
        if not len(at):
            return
        me = rows[at]
        apart = np.abs(diverged.logged_paths.project(at, table.x[me], table.y[me]).d) > APART
        at, me = at[apart], me[apart]
        lanes = self._lane_map.nearest(table.x[me], table.y[me], table.yaw[me]).lane
        for k, row, lane in zip(at.tolist(), me.tolist(), lanes.tolist(), strict=True):
            self._change(table, diverged, k, row, lane)

    def _desired_speeds(self, diverged: DivergedAgents, table: AgentTable, lag: IntArray) -> FloatArray:
        """Speeds (r,) [m/s] of the agents' logs, lags included; with time_shift, those at the agents' positions."""
        log_rows = self._log.ids.searchsorted(diverged.agent)
        return self._log.speed[log_rows, self._clipped(table.step - lag)]

    def _clipped(self, step: IntArray) -> IntArray:
        """Limit `step` to the steps of the log."""
        return np.minimum(np.maximum(step, 0), self._log.steps - 1)

    def _weighed(
        self,
        table: AgentTable,
        diverged: DivergedAgents,
        rows: IntArray,
        desired: FloatArray,
        at: IntArray,
        here: IntArray,
        there: IntArray,
    ) -> LaneChanges:
        """Weigh lane changes from lanes `here` to lanes `there` (k,) of the agents at positions `at` (k,).

        `desired` (r,) are the desired speeds of all agents off their logs [m/s].
        """
        if not len(at):
            return LaneChanges(np.zeros(0), np.zeros(0, np.bool_), np.zeros(0, np.bool_))
        line, me = self._lines.rows(np.concatenate([here, there])), np.concatenate([rows[at], rows[at]])
        lines, count = self._lines.made, len(at)
        s = lines.project(line, table.x[me], table.y[me]).s
        x, y = lines.point(s, line).T
        heading = lines.heading(line, lines.segment(s[:, None], line)[:, 0])
        view = along_paths(lines, table, me, poses=(x, y, heading), path=line)
        claimed = self._claims(table, diverged, rows, there, view)
        me, reach = me[:count], self._config.change_time * table.speed[me[:count]]
        return weigh_changes(self._config.mobil, table, me, desired[at], view, claimed, reach)

    def _claims(
        self, table: AgentTable, diverged: DivergedAgents, rows: IntArray, there: IntArray, view: AlongPath
    ) -> BoolArray:
        """Mask (k, w) of other agents with paths that lead into the lanes `there` (k,).

        Covers agents in the scenes of those that have the `view`; its first k rows are theirs.
        """
        s = diverged.paths.project(diverged.paths.each, table.x[rows], table.y[rows]).s
        x, y = diverged.paths.point(s + INTENT * table.speed[rows]).T
        return self._lines.inside(there, rows, (x, y), view.first, view.s.shape[1])


@kernel(OUT_INTS(INTS, FLOATS, BOOLS, INTS, FLOATS, FLOATS, float64))
def _chosen(
    agent: IntArray, gain: FloatArray, worth: BoolArray, scene: IntArray, x: FloatArray, y: FloatArray, abreast: float
) -> IntArray:
    """Positions of those of k changes that are made: the best of each agent, and one of agents near each other.

    Args:
        agent: (k,) positions of the agents.
        gain, worth: (k,) gain [m/s2], and mask of the changes that are safe and worth it.
        scene, x, y: (k,) of the agents.
        abreast: distance [m] within which only the first agent changes.
    """
    best = np.full(len(agent), -1, np.int64)
    count = 0
    for k in range(len(agent)):
        if not worth[k]:
            continue
        better = True
        for other in range(len(agent)):
            same = worth[other] and agent[other] == agent[k]
            if same and (gain[other] > gain[k] or (gain[other] == gain[k] and other < k)):
                better = False
        for c in range(count):
            other = best[c]
            close = (x[other] - x[k]) ** 2 + (y[other] - y[k]) ** 2 < abreast**2
            if scene[other] == scene[k] and close:
                better = False
        if better:
            best[count] = k
            count += 1
    return best[:count].copy()
