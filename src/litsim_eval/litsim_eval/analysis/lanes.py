"""Where agents are on the lanes of a run."""

from __future__ import annotations

import numpy as np

from litsim_eval.analysis.collision import InLane
from litsim_sim.core.scene import AgentTable
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run


def in_lane_of(run: Run) -> InLane | None:
    """The test whether a box lies inside one lane of the attached net, read at the first call; None without a net."""

    def in_lane(table: AgentTable, row: int) -> bool:
        lane_map, one = lane_map_of(run), table.take(table.id == table.id[row])
        return lane_map is not None and bool(lane_map.inside_lane(one.x, one.y, one.yaw, one.length, one.width)[0])

    return in_lane if run.net_xml else None


def off_road_controlled(run: Run) -> float | None:
    """Share of agent-steps under control at which the box centre is on no lane; None without such steps or a net."""
    lane_map = lane_map_of(run)
    table = run.simulated.stacked
    x, y = table.x[table.of_policy], table.y[table.of_policy]
    return float(np.mean(~lane_map.inside_road(x, y))) if lane_map is not None and len(x) else None
