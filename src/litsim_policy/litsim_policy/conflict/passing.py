"""Passing: an agent held behind a permanently slow one changes to an adjacent lane, and returns from there."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.diverged import HELD, LOGGED, OWN_INTENT, RELEASED, DivergedNow
from litsim_policy.motion.along_path import AlongPath, along_paths
from litsim_policy.motion.lane_change import GAIN_MIN, LaneChanges, weigh_changes
from litsim_policy.motion.lane_lines import NO_LANE, LaneLines
from litsim_policy.motion.route import Router
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap

SLOWER = 0.5  # [m/s] an agent is held back if it is slower than its log, lag included, by more than this
PATIENCE = 50  # [steps] in a row for which it is held back before it looks for another lane: as often as people change
AGAIN = 40  # [steps] least time from one lane change to the next
CHANGE_TIME = 3.5  # [s] duration of a lane change
LOOK = 150.0  # [m] ahead over which both lanes must lead the same way: changing, passing and changing back at 14 m/s
IN_LANE = 1.0  # [m] largest distance from the centre line of an agent that drives in a lane, rather than between two
APART = 1.8  # [m] distance from the logged path, half a lane, beyond which an agent is in another lane than its log
ABREAST = 40.0  # [m] distance within which only one agent begins a lane change at a step; others react at the next
INTENT = 2.0  # [s] time after which an agent's position on its path shows the lane into which it moves


class Passing:
    """Lets agents off their logs pass; its only state is the lines of the lanes."""

    def __init__(self, lane_map: LaneMap, router: Router) -> None:
        self._lane_map, self._router, self._lines = lane_map, router, LaneLines(lane_map)

    def may_return(self, now: DivergedNow, off_before: BoolArray) -> BoolArray:
        """Returns the mask (r,) of agents that have not left the lanes of their logs to pass, or can return to them.

        An agent that is on another road by now, such as a ramp, cannot. Agents that are not `off_before` (r,) were
        taken over at this very step: they claim no lane.
        """
        may = np.ones(len(now.agents), np.bool_)
        index = (off_before & (now.agents.beside != NO_LANE) & now.recorded).nonzero()[0]
        if len(index):
            here = self._lane_map.nearest(now.x[index], now.y[index], now.yaw[index]).lane
            there = self._lane_map.nearest(now.log_x[index], now.log_y[index], now.log_yaw[index]).lane
            may[index] = self._lines.road[here] == self._lines.road[there]
            other = may[index] & (here != there)
            index = index[other]
            may[index] = self._weighed(now, index, here[other], there[other], off_before).safe
        return may

    def change_lanes(self, now: DivergedNow) -> None:
        """Let agents that have been held back for long enough change lane where they can, in place.

        One that is handed back and begins to pass is HELD again.
        """
        agents, table = now.agents, now.table
        slowed = (now.speed < now.log_speed - SLOWER) & ~table.obstacle[now.rows]  # walkers and cyclists keep no lanes
        agents.slowed[:] = np.where(slowed, agents.slowed + 1, 0)
        self._stay_beside(now)
        self._give_up(now)
        waits = (agents.slowed >= PATIENCE) & (table.step - agents.changed_step >= AGAIN)
        index = ((waits | (agents.beside != NO_LANE)) & (agents.state != RELEASED)).nonzero()[0]
        if not len(index):
            return
        here = self._lane_map.nearest(now.x[index], now.y[index], now.yaw[index])
        inside = np.abs(here.d) <= IN_LANE
        index, lane, ahead = index[inside], here.lane[inside], here.s[inside] + LOOK
        both, here_lane = np.concatenate([index, index]), np.concatenate([lane, lane])
        there = np.concatenate([self._lines.left[lane], self._lines.right[lane]])
        part = self._lines.beside(here_lane, there) < np.concatenate([ahead, ahead])
        # an agent that passes and has the lane of its log to the left or right must return there before they part
        aside, passes = agents.logged_paths.project(index, now.x[index], now.y[index]).d, agents.beside[index] == lane
        must = part & np.concatenate([passes & (aside < -APART), passes & (aside > APART)])
        can = (there != NO_LANE) & (must | (waits[both] & ~part))
        both, here_lane, there, must = both[can], here_lane[can], there[can], must[can]
        if not len(both):
            return
        changes = self._weighed(now, both, here_lane, there)
        worth = changes.safe & (must | (changes.gain > GAIN_MIN))
        for k in _chosen(now, both, changes.gain, worth):
            self._change(now, int(both[k]), int(there[k]))

    def _change(self, now: DivergedNow, index: int, lane: int) -> None:
        """Let the agent at position `index` change to `lane` if there is a path."""
        pose = np.array([now.x[index], now.y[index], now.yaw[index]])
        path = self._router.beside(pose, CHANGE_TIME * float(now.speed[index]), lane)
        if path is not None:
            now.agents.pass_along(index, path, lane, now.table.step)

    def _give_up(self, now: DivergedNow) -> None:
        """Return agents to their logged paths that are not in their new lanes yet and can no longer change."""
        agents = now.agents
        index = (agents.beside != NO_LANE).nonzero()[0]
        if not len(index):
            return
        there = agents.beside[index]
        line = self._lines.rows(there)
        outside = np.abs(self._lines.batch.project(line, now.x[index], now.y[index]).d) > 0.5 * self._lines.width(there)
        index, there = index[outside], there[outside]
        if not len(index):
            return
        here = self._lane_map.nearest(now.x[index], now.y[index], now.yaw[index]).lane
        index = index[~self._weighed(now, index, here, there).room]
        agents.return_to_log(index)
        agents.changed_step[index], agents.slowed[index] = now.table.step, 0

    def _stay_beside(self, now: DivergedNow) -> None:
        """Keep agents in their present lanes that were returning to those of their logs and are held again."""
        agents = now.agents
        if not (agents.changed_step >= 0).any():
            return
        driven_on = (agents.state == HELD) | (agents.state == OWN_INTENT)
        index = ((agents.changed_step >= 0) & driven_on & (agents.source == LOGGED)).nonzero()[0]
        if not len(index):
            return
        index = index[np.abs(agents.logged_paths.project(index, now.x[index], now.y[index]).d) > APART]
        lanes = self._lane_map.nearest(now.x[index], now.y[index], now.yaw[index]).lane
        for k, lane in zip(index.tolist(), lanes.tolist(), strict=True):
            self._change(now, k, lane)

    def _weighed(
        self, now: DivergedNow, index: IntArray, here: IntArray, there: IntArray, claim: BoolArray | None = None
    ) -> LaneChanges:
        """Weigh lane changes from lanes `here` to lanes `there` (k,) of the agents at positions `index` (k,).

        Agents in the mask `claim` (r,), by default all, count as being in the lanes into which they move.
        """
        if not len(index):
            return LaneChanges(np.zeros(0), np.zeros(0, np.bool_), np.zeros(0, np.bool_))
        line, twice = self._lines.rows(np.concatenate([here, there])), np.concatenate([index, index])
        lines = self._lines.batch
        s = lines.project(line, now.x[twice], now.y[twice]).s
        x, y = lines.point(s, line).T
        heading = lines.heading(line, lines.segment(s, line))
        view = along_paths(lines, now.table, now.rows[twice], poses=(x, y, heading), path=line)
        claimed = self._claimed(now, np.arange(len(now.agents)) if claim is None else claim.nonzero()[0], there, view)
        return weigh_changes(
            now.table, now.rows[index], now.log_speed[index], view, claimed, CHANGE_TIME * now.speed[index]
        )

    def _claimed(self, now: DivergedNow, index: IntArray, there: IntArray, view: AlongPath) -> BoolArray:
        """Returns the mask (k, w) of agents at positions `index` (c,) with paths that lead into the lanes `there` (k,).

        Covers agents in the scenes of those that have the `view`; its first k rows are theirs.
        """
        paths = now.agents.paths
        s = paths.project(index, now.x[index], now.y[index]).s
        x, y = paths.point(s + INTENT * now.speed[index], index).T
        return self._lines.inside(there, now.rows[index], (x, y), view.first, view.s.shape[1])


def _chosen(now: DivergedNow, index: IntArray, gain: FloatArray, worth: BoolArray) -> list[int]:
    """Returns which of k lane changes are made: the best of each agent, and one of agents within ABREAST of each other.

    The agents are at positions `index` (k,) in `now`; changes `worth` (k,) it are safe, too, and have a `gain` (k,)
    [m/s2].
    """
    x, y, scene = now.x[index], now.y[index], now.table.scene[now.rows[index]]
    chosen: list[int] = []
    for k in worth.nonzero()[0].tolist():
        of_agent = (worth & (index == index[k])).nonzero()[0]
        best = of_agent[gain[of_agent].argmax()] == k
        near = (scene[chosen] == scene[k]) & ((x[chosen] - x[k]) ** 2 + (y[chosen] - y[k]) ** 2 < ABREAST**2)
        if best and not near.any():
            chosen.append(k)
    return chosen
