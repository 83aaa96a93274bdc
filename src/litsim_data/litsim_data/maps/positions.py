"""Positions for building and checking maps, from recordings of any format, with raw columns if a fit needs them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from litsim_data.ngsim import official as ngsim
from litsim_data.ngsim import windows as ngsim_windows
from litsim_data.ngsim.formats import is_official
from litsim_data.ngsim.sites import SITES
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import is_obstacle
from litsim_sim.io.input_files import require_file
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import HEADER_KEY, Recording

URBAN_COLUMNS = ("intersection", "section", "direction", "movement", "lane")
COMMONROAD_WINDOWS = ("scenario", "vehicle_id", "frame", "x_m", "y_m", "heading_rad")


def for_fitting(path: Path, site: str = "") -> tuple[pd.DataFrame, str]:
    """Returns positions of the recording at `path`, to fit lanes to, and the name of its NGSIM site, empty if unknown.

    Args:
        path: the US-101 windows file, an official NGSIM file, or any other recording.
        site: name of the site to which to keep; official files that hold several need it.

    Returns:
        Columns x, y [m] in frame map and lane; yaw [rad] in recordings; front_x, front_y, local_x [m] where known; the
        URBAN_COLUMNS with vehicle_id and frame in official files of streets.

    Raises:
        InputError: the file cannot be used, or holds no or several sites.
    """
    columns = _parquet_columns(path)
    if ngsim_windows.is_windows(columns):
        table = ngsim_windows.read_table(path)
        raw = pd.read_parquet(path, columns=["src", "global_x_m", "global_y_m", "local_x_m"])
        raw = raw[raw["src"] < ngsim_windows.WINDOW_SOURCES]
        front = SITES["us101"].map_from_global(*(raw[f"global_{axis}_m"].to_numpy(np.float64) for axis in "xy"))
        table["front_x"], table["front_y"] = front
        table["local_x"] = raw["local_x_m"].to_numpy(np.float64)
        return table, "us101"
    if not columns and is_official(path):
        return _official(path, site)
    recording = load_recording(path)
    known = recording.header.net.removesuffix(".net.xml")
    return vehicles_of(recording.table, str(path)), site or (known if known in SITES else "")


def vehicles_of(table: pd.DataFrame, where: str) -> pd.DataFrame:
    """Returns the rows of a neutral table without pedestrians and cyclists, which do not keep to lanes.

    Raises:
        InputError: no other agents are left; `where` names the recording.
    """
    vehicles = table[~is_obstacle(table["kind"].to_numpy())]
    if vehicles.empty:
        raise InputError(f"{where}: holds only pedestrians and cyclists, expected vehicles")
    return vehicles


def for_checking(path: Path, scenarios: Sequence[str] = ()) -> dict[str, pd.DataFrame]:
    """Returns parts of a recording's vehicles in the neutral columns vehicle_id, frame, x, y, yaw, lane, by name.

    Args:
        path: as :func:`for_fitting`; or windows of CommonRoad scenarios, each in a frame of its own.
        scenarios: names of those to be checked.

    Raises:
        InputError: the file cannot be used, or scenarios of it are needed and not named or unknown.
    """
    columns = _parquet_columns(path)
    if ngsim_windows.is_windows(columns):
        return {"recording": ngsim_windows.read_table(path)}
    if set(COMMONROAD_WINDOWS) <= set(columns):
        return _commonroad_windows(path, scenarios)
    return {"recording": vehicles_of(load_recording(path).table, str(path))}


def mapped_by(path: Path) -> dict[str, Any] | None:
    """Returns field `transform` of the mapping that the recording at `path` was converted with; None without one."""
    if HEADER_KEY not in (read_schema(path).metadata or {} if is_parquet(path) else {}):
        return None
    mapping = Recording.read(path).header.notes.get("mapping")
    return dict(mapping.get("transform") or {}) if isinstance(mapping, dict) else None


def _commonroad_windows(path: Path, scenarios: Sequence[str]) -> dict[str, pd.DataFrame]:
    raw = pd.read_parquet(path, columns=list(COMMONROAD_WINDOWS))
    known = sorted(raw["scenario"].unique())
    if not scenarios or not set(scenarios) <= set(known):
        raise InputError(f"{path}: every scenario has a frame of its own: name one with --scenario, of {known}")
    names = {"x_m": "x", "y_m": "y", "heading_rad": "yaw"}
    return {name: raw[raw["scenario"] == name].rename(columns=names).assign(lane=-1) for name in scenarios}


def _official(path: Path, site: str) -> tuple[pd.DataFrame, str]:
    table = ngsim.read(path, ("local_x", *URBAN_COLUMNS), site or None)
    sites = sorted({str(name).partition("_")[0] for name in table["recording"].unique()})
    if len(sites) != 1:
        raise InputError(f"{path}: the file holds the sites {sites}: name one with --site")
    # Ids are used again in other periods.
    period = table["recording"].astype("category").cat.codes.to_numpy(np.int64)
    table["vehicle_id"] = table["vehicle_id"].to_numpy(np.int64) + 1_000_000 * period
    # x and y are front centres: along the road that is half a vehicle off, across it nothing.
    table["front_x"], table["front_y"] = table["x"], table["y"]
    return table, sites[0]


def _parquet_columns(path: Path) -> list[str]:
    """Returns names of the columns of a Parquet file; none of anything else."""
    require_file(path, "recording")
    return list(read_schema(path).names) if is_parquet(path) else []
