"""Pedestrians and cyclists of a table: what of them is used, and what takes the place of the rest.

Data sets say less of them than of vehicles, and less reliably: many give no heading, no size or a size of 0. They are
obstacles that follow their log, so that their places matter, and headings and speeds that fit these are good enough.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from litsim_sim.core.scene import BoolArray, Kind, is_obstacle
from litsim_sim.recordings.generic.counts import Counts
from litsim_sim.recordings.generic.mapping import Mapping
from litsim_sim.recordings.recording import BOUNDS

USUAL_SIZES: dict[Kind, tuple[float, float]] = {Kind.BICYCLE: (1.8, 0.6), Kind.PEDESTRIAN: (0.5, 0.5)}
"""Length and width [m] of those whose size the file does not say."""

NAMES = tuple(kind.name.lower() for kind in USUAL_SIZES)
UNUSED = ("yaw", "speed", "speed_x", "speed_y", "acceleration")


def obstacle_rows(table: pd.DataFrame) -> BoolArray:
    """(n,) rows of pedestrians and cyclists in a table with our column kind, as names or as numbers, or without it."""
    if "kind" not in table:
        return np.zeros(len(table), np.bool_)
    if pd.api.types.is_numeric_dtype(table["kind"]):
        return is_obstacle(table["kind"].to_numpy())
    return np.asarray(table["kind"].isin(NAMES), np.bool_)


def without_unused(given: pd.DataFrame) -> pd.DataFrame:
    """`given`, as the file has it, with 0 for what is not used of pedestrians and cyclists, and for missing sizes."""
    rows = obstacle_rows(given)
    if not rows.any():
        return given
    given = given.assign(**{name: given[name].astype(object).mask(rows, 0) for name in UNUSED if name in given})
    for name in {"length", "width"} & {*given.columns}:
        missing = rows & ~np.isfinite(pd.to_numeric(given[name], errors="coerce").to_numpy(np.float64, na_value=np.nan))
        given[name] = given[name].astype(object).mask(missing, 0)
    return given


def with_usual_sizes(table: pd.DataFrame, mapping: Mapping, counts: Counts) -> pd.DataFrame:
    """`table`, in SI units, with usual sizes for pedestrians and cyclists who have none.

    That is where the mapping gives one size for every vehicle, or where half of somebody's rows are smaller than any
    agent of a recording may be.
    """
    rows = obstacle_rows(table)
    if not rows.any():
        return table
    known = isinstance(mapping.columns.length, str) and isinstance(mapping.columns.width, str)
    sizes = table.groupby("vehicle_id")[["length", "width"]].transform("median")
    small = (sizes["length"] < BOUNDS["length"][0]) | (sizes["width"] < BOUNDS["width"][0])
    rows &= small.to_numpy() | (not known)
    counts.usual_sizes = int(table.loc[rows, "vehicle_id"].nunique())
    table = table.copy()
    for kind, (length, width) in USUAL_SIZES.items():
        table.loc[rows & (table["kind"].to_numpy() == kind), ["length", "width"]] = length, width
    return table
