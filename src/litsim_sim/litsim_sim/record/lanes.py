"""The lanes of a run, from the SUMO net attached to its bag."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from litsim_eval.analysis.collision import InLane
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import NET_FILE, Run


def lane_map_of(run: Run) -> LaneMap | None:
    """Lanes of the attached net; None without a net.

    Raises:
        InputError: the attachment is not a SUMO net.
    """
    try:
        return _read(run.net_xml) if run.net_xml else None
    except InputError as error:
        raise InputError(f"{run.path}: attachment {NET_FILE}: {error}") from error


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


@lru_cache(maxsize=2)
def _read(net_xml: bytes) -> LaneMap:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NET_FILE
        path.write_bytes(net_xml)
        return LaneMap.from_net(path)
