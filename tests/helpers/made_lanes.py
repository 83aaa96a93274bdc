"""Lanes made by hand, and positions on them."""

import numpy as np
import pandas as pd

from litsim_sim.lane_map.net_lanes import Lane


def made_lane(
    name: str,
    start: tuple[float, float],
    end: tuple[float, float],
    successors: tuple[str, ...] = (),
    left: str | None = None,
    right: str | None = None,
) -> Lane:
    """A straight lane of 3.5 m; `name` is edge_index, and begins with a colon inside a junction."""
    line = np.array([start, end], np.float64)
    length = float(np.hypot(*(line[1] - line[0])))
    edge, _, index = name.rpartition("_")
    inside = name.startswith(":")
    s = np.array([0.0, length])
    return Lane(name, edge, int(index), 3.5, 20.0, line, s, length, successors, left, right, is_internal=inside)


def rows(x: object, y: object, yaw: object = 0.0, lane: object = -1, vehicle_id: object = 1) -> pd.DataFrame:
    """Positions in the neutral columns that checks of nets read, a frame each."""
    table = pd.DataFrame({"x": x, "y": y, "yaw": yaw, "lane": lane, "vehicle_id": vehicle_id})
    return table.assign(frame=np.arange(len(table)))
