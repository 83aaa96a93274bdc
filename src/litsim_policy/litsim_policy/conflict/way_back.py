"""Whether agents off their logs can return to them, or are not needed any longer."""

from __future__ import annotations

import numpy as np

from litsim_policy.conflict.diverged import DivergedNow
from litsim_policy.motion.along_path import along_paths
from litsim_sim.core.nearby import around
from litsim_sim.core.scene import BoolArray, IntArray
from litsim_sim.scenario.log_overlaps import LogOverlaps
from litsim_sim.scenario.setting import Setting

OBSTACLE_SIGHT = 30.0  # [m] range, beyond the distance to the place in the log, of agents that may block the way


def obstructed(now: DivergedNow, index: IntArray, log_overlaps: LogOverlaps) -> BoolArray:
    """Returns the mask (k,) of agents at positions `index` (k,) whose way to their places in the log others block.

    Background agents that overlap them there in the log itself do not.
    """
    if not len(index):
        return np.zeros(0, np.bool_)
    table, paths, rows = now.table, now.agents.logged_paths, now.rows[index]
    place = paths.project(index, now.log_x[index], now.log_y[index])
    view = along_paths(paths, table, rows, sight=OBSTACLE_SIGHT + 2.0 * now.residual_position[index], path=index)
    between = view.ahead & view.in_path & (view.gap < (place.s - view.own_s)[:, None])
    for k, column, row in view.pairs(between):
        if not table.of_ego[row]:
            own, other = (int(log_row) for log_row in now.log.ids.searchsorted(table.id[[rows[k], row]]))
            time = table.step - int(now.lag[index[k]])
            between[k, column] = not log_overlaps.meets(own, other, time, table.x[row], table.y[row])
    return np.asarray(between.any(axis=1))


def unneeded(scenario: Setting, now: DivergedNow, roi_m: float) -> BoolArray:
    """Whether the logs of agents are over, without the ego or an agent whose own log continues within `roi_m` [m].

    Returns:
        mask (r,); a log that lasts until the end of the recording does not count as over.
    """
    table, last = now.table, now.log.last_step[now.log_rows]
    over = (table.step - now.lag >= last) & (last < scenario.last_logged[table.scene[now.rows]])
    if over.any():
        others = table.mask(scenario.ego_ids)
        others[now.rows[~over]] = True
        over &= ~around(table, others, roi_m)[now.rows]
    return np.asarray(over)
