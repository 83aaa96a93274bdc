"""Trajectories as a plain table: CSV or Parquet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from litsim_data.exports.export import Content, Export
from litsim_sim.core.scene import Controller
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.net_lanes import lanes_from_left
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run, start_frame
from litsim_sim.scenario.recording import COLUMNS

EXTRA = ("step", "yaw_rate", "controller")


def trajectories(run: Run) -> pd.DataFrame:
    """Returns one row per agent and step, ordered by step: the columns of the neutral schema and EXTRA.

    `frame` is the recording's; `lane` is counted from the left of the edge in the bag's net (-1: inside a junction, or
    no net); `controller` is the name of a :class:`litsim_sim.core.scene.Controller` in lower case.

    Raises:
        InputError: the net or the scenario in the bag cannot be read.
    """
    start = start_frame(run.scenario_yaml, run.path) if run.scenario_yaml else 0
    rows = pd.concat(
        [
            pd.DataFrame(
                {
                    "vehicle_id": table.id,
                    "step": table.step,
                    **{name: getattr(table, name) for name in COLUMNS if hasattr(table, name)},
                    "yaw_rate": table.yaw_rate,
                    "controller": [Controller(code).name.lower() for code in table.controller],
                }
            )
            for table in run.tables
        ],
        ignore_index=True,
    )
    rows = rows.assign(frame=rows["step"] + start, lane=_lanes(run, rows))
    return rows[[*COLUMNS, *EXTRA]].astype(COLUMNS)


def _lanes(run: Run, rows: pd.DataFrame) -> np.ndarray:
    lane_map = lane_map_of(run)
    if lane_map is None or rows.empty:
        return np.full(len(rows), -1)
    nearest = lane_map.nearest(*(rows[name].to_numpy() for name in ("x", "y", "yaw")))
    from_left = np.array(lanes_from_left(lane_map.lanes))[nearest.lane]
    return np.where(from_left == 0, -1, from_left)


class Table(Export):
    """Rows by agent and frame, for tools that do not read bags."""

    endings, content = (".csv", ".parquet"), "a table of all agents by frame"

    def write(self, content: Content, out: Path) -> list[str]:
        """See :class:`.export.Export`."""
        rows = content.motion().drop(columns="t")
        with replacing(out) as new:
            if out.suffix == ".csv":
                rows.to_csv(new, index=False)
            else:
                rows.to_parquet(new, index=False, compression="zstd")
        return [content.counts]
