"""The format `centre_lines` of maps: a table of points along the centres of lanes, with columns lane, x, y [m]."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around
from litsim_data.maps.map_format import GraphFormat


class CentreLines(GraphFormat):
    """Lanes of 3.5 m around their centre lines, in the frame of the file."""

    file, content = "F.csv", "centre lines of lanes"

    def read(self, path: Path, origin: tuple[float, float] | None) -> LaneGraph:  # noqa: ARG002 - has its own frame
        """See :class:`litsim_data.maps.map_format.GraphFormat`."""
        lines = {str(lane): points[["x", "y"]].to_numpy() for lane, points in pd.read_csv(path).groupby("lane")}
        return LaneGraph(tuple(Lanelet(lane, *around(line)) for lane, line in lines.items()))
