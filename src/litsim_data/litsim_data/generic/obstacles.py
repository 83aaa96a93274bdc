"""Pedestrians and cyclists of a table: which of their columns are used; and sizes of agents that have none.

Data sets describe them less completely than vehicles: many give no heading, no size, or a size of 0. As obstacles that
follow their log they need accurate positions only; headings and speeds are derived from these.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_data.generic.counts import Counts
from litsim_data.generic.mapping import Mapping
from litsim_sim.core.scene import BoolArray, Kind, is_obstacle
from litsim_sim.scenario.recording import BOUNDS

USUAL_SIZES: dict[Kind, tuple[float, float]] = {
    Kind.CAR: (4.6, 1.9),
    Kind.TRUCK: (12.0, 2.5),
    Kind.MOTORCYCLE: (2.2, 0.9),
    Kind.BICYCLE: (1.8, 0.6),
    Kind.PEDESTRIAN: (0.5, 0.5),
}
"""Default length and width [m]; those of cars are of vehicles of unknown kind, too, where a table has no sizes."""

NAMES = tuple(kind.name.lower() for kind in (Kind.BICYCLE, Kind.PEDESTRIAN))
UNUSED = ("yaw", "speed", "speed_x", "speed_y", "acceleration")


def obstacle_rows(table: pd.DataFrame) -> BoolArray:
    """Returns the mask (n,) of pedestrians and cyclists; column `kind` holds names or numbers, and may be absent."""
    if "kind" not in table:
        return np.zeros(len(table), np.bool_)
    if pd.api.types.is_numeric_dtype(table["kind"]):
        return is_obstacle(table["kind"].to_numpy())
    return np.asarray(table["kind"].isin(NAMES), np.bool_)


def without_unused(table: pd.DataFrame) -> pd.DataFrame:
    """Returns `table`, as read, with 0 for unused columns of pedestrians and cyclists, and for their missing sizes."""
    rows = obstacle_rows(table)
    if not rows.any():
        return table
    table = table.assign(**{name: table[name].astype(object).mask(rows, 0) for name in UNUSED if name in table})
    for name in {"length", "width"} & {*table.columns}:
        missing = rows & ~np.isfinite(pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64, na_value=np.nan))
        table[name] = table[name].astype(object).mask(missing, 0)
    return table


def with_usual_sizes(table: pd.DataFrame, mapping: Mapping, counts: Counts) -> pd.DataFrame:
    """Returns `table`, in SI units, with default sizes for agents of a known kind without a usable size.

    A median size beyond BOUNDS is none, nor is one that the mapping gives for all vehicles that of pedestrians and
    cyclists. Those of unknown kind get the nearest size within BOUNDS, where they have one.
    """
    has_sizes = not (isinstance(mapping.columns.length, float) or isinstance(mapping.columns.width, float))
    sizes = table.groupby("vehicle_id")[["length", "width"]].transform("median")
    usable = sizes["length"].between(*BOUNDS["length"]) & sizes["width"].between(*BOUNDS["width"])
    rows = ~usable.to_numpy() | (obstacle_rows(table) & (not has_sizes))
    if not rows.any():
        return table
    agents = int(table.loc[rows, "vehicle_id"].nunique())
    text = f"{agents} agents without a usable size got a usual one of their kind"
    counts.tell("sizes", text, tracks_of_usual_size=agents)
    table = table.copy()
    for name in ("length", "width"):
        usual = USUAL_SIZES[Kind.CAR][name == "width"]
        table.loc[rows, name] = sizes.loc[rows, name].clip(*BOUNDS[name]).fillna(usual)
    for kind, (length, width) in USUAL_SIZES.items():
        table.loc[rows & (table["kind"].to_numpy() == kind), ["length", "width"]] = length, width
    return table
