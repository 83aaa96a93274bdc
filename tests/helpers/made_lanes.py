"""Lanes made by hand, positions on them, and polylines for properties of paths."""

import numpy as np
import pandas as pd
from hypothesis import strategies as st

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


def lane_of(name: str, line: list[tuple[float, float]], *successors: str) -> Lane:
    """A lane of 3 m, the first of the edge that `name` begins with; a colon puts it inside a junction."""
    points = np.array(line, np.float64)
    s, edge = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]), name.partition("_")[0]
    inside = name.startswith(":")
    return Lane(name, edge, 0, 3.0, 10.0, points, s, float(s[-1]), successors, None, None, is_internal=inside)


def rows(x: object, y: object, yaw: object = 0.0, lane: object = -1, vehicle_id: object = 1) -> pd.DataFrame:
    """Positions in the neutral columns that checks of nets read, a frame each."""
    table = pd.DataFrame({"x": x, "y": y, "yaw": yaw, "lane": lane, "vehicle_id": vehicle_id})
    return table.assign(frame=np.arange(len(table)))


@st.composite
def polylines(draw: st.DrawFn) -> list[np.ndarray]:
    """One to five polylines of 2 to 60 points around the origin, some straight, some that cross themselves."""
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    bend = draw(st.sampled_from([0.0, 0.05, 0.5, 2.0]))
    lines = []
    for count in draw(st.lists(st.integers(2, 60), min_size=1, max_size=5)):
        heading = np.cumsum(random.normal(0.0, bend, count - 1))
        steps = random.uniform(0.3, 3.0, (count - 1, 1)) * np.column_stack([np.cos(heading), np.sin(heading)])
        lines.append(np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)]) + random.normal(0.0, 20.0, 2))
    return lines
