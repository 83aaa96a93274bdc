"""Heights of the file, which recordings do not have: vehicles that pass over each other would touch."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
from scipy.spatial import KDTree

from litsim_data.generic.counts import Counts
from litsim_sim.io.table_input import TableFiles
from litsim_sim.lane_map.net_lanes import LEVEL

NAMES = r"((vehicle|local|pos(ition)?|utm|map|cent(er|re))_?)?z(_?(m|center|centre|pos|position))?|elevation|altitude"
"""Pattern of names of a column of heights, in lower case."""
NEAR = 30.0  # [m] within which vehicles on two levels are looked for: a hill does not rise as much
INSTANTS = 400  # about as many instants are compared


def tell_levels(table: pd.DataFrame, source: TableFiles, counts: Counts) -> None:
    """Tells `counts` of vehicles near each other on different levels.

    Args:
        table: vehicle_id, t [s], x, y [m], and row, the place in `source`.
        source: the file, of which a column that looks like heights in metres is read.
    """
    name = next((column for column in source.columns if re.fullmatch(NAMES, column.strip().lower())), None)
    if name is None or source.columns.count(name) > 1:
        return
    column = source.read([name], needed=set()).set_index("row")[name]
    heights = pd.to_numeric(column, errors="coerce").reindex(table["row"]).to_numpy(np.float64)
    instant = np.round(table["t"].to_numpy() * 10.0).astype(np.int64)
    every = max(1, len(np.unique(instant)) // INSTANTS)
    measured = np.isfinite(heights) & (instant % every == 0)
    rows = table[measured].assign(height=heights[measured], instant=instant[measured])
    height, vehicle = rows["height"].to_numpy(), rows["vehicle_id"].to_numpy()
    places = np.column_stack([rows[["x", "y"]], 2.0 * NEAR * rows["instant"]])  # those of another instant are not near
    first, other = KDTree(places).query_pairs(NEAR, output_type="ndarray").T
    apart = np.abs(height[first] - height[other]) > LEVEL
    if pairs := {*zip(vehicle[first[apart]].tolist(), vehicle[other[apart]].tolist(), strict=True)}:
        low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
        counts.tell(
            "levels",
            f"column {name!r} spans {high - low:.1f} m and is not used, though {len(pairs)} pairs of vehicles are near "
            f"each other on different levels, where they touch on a flat net: keep one level by field rows of the "
            f"mapping, such as rows: {{{name}: {{max: {low + LEVEL:.1f}}}}}",
        )
