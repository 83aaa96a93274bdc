"""Positions for building and checking maps, from recordings of any format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

from litsim_data.ngsim import windows
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import is_obstacle
from litsim_sim.io.input_files import require_file
from litsim_sim.io.parquet_input import is_parquet, read_schema
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.recording import HEADER_KEY, Recording


def positions_of(path: Path) -> pd.DataFrame:
    """Returns the rows of a recording's vehicles in the neutral columns; of the US-101 windows file those of all.

    Raises:
        InputError: the file cannot be used.
    """
    require_file(path, "recording")
    if is_parquet(path) and windows.is_windows(read_schema(path).names):
        return windows.read_table(path)
    return vehicles_of(load_recording(path).table, str(path))


def vehicles_of(table: pd.DataFrame, where: str) -> pd.DataFrame:
    """Returns the rows of a neutral table without pedestrians and cyclists, which do not keep to lanes.

    Raises:
        InputError: no other agents are left; `where` names the recording.
    """
    vehicles = table[~is_obstacle(table["kind"].to_numpy())]
    if vehicles.empty:
        raise InputError(f"{where}: holds only pedestrians and cyclists, expected vehicles")
    return vehicles


def mapped_by(path: Path) -> dict[str, Any] | None:
    """Returns field `transform` of the mapping that the recording at `path` was converted with; None without one."""
    if HEADER_KEY not in (read_schema(path).metadata or {} if is_parquet(path) else {}):
        return None
    mapping = Recording.read(path).header.notes.get("mapping")
    return dict(mapping.get("transform") or {}) if isinstance(mapping, dict) else None
