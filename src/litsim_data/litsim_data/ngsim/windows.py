"""Reader of the US-101 windows file of the development data: NGSIM tracks with their original times and positions.

Positions are metres of State Plane California V at the front centre of a vehicle. Frame ``map`` is a rigid transform of
these: x is about `local_y_m` (downstream), y about minus `local_x_m` (to the left). `local_y_m` itself is 1.1 % longer
than global metres and is used for cropping only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from litsim_data.ngsim.sites import US101
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import Kind
from litsim_sim.io import parquet_input
from litsim_sim.scenario.cropping import NUMBERS, Crop, within
from litsim_sim.scenario.recording import Recording, RecordingHeader

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (
    "vehicle_id",
    "frame",
    "t_ms",
    "local_x_m",
    "local_y_m",
    "global_x_m",
    "global_y_m",
    "heading_rad",
    "speed_mps",
    "accel_mps2",
    "length_m",
    "width_m",
    "lane_est",
    "src",
    "scenario",
)
UNUSED = ("t_ms", "scenario")
MARKERS = ("global_x_m", "local_y_m", "lane_est", "src")
"""Columns by which the format is recognised."""

# The file has no vehicle classes: they are guessed from sizes.
MOTORCYCLE_BELOW = 3.2  # [m] length of most motorcycles
MOTORCYCLE_NARROWER = 1.4  # [m] width of motorcycles; short cars are wider
TRUCK_ABOVE = 7.5  # [m] length of trucks
WINDOW_SOURCES = 2  # src 0 and 1 are the windows with all vehicles; others are single vehicles without heading


def is_windows(columns: Sequence[str]) -> bool:
    """Returns whether a table with these columns has this format."""
    return set(MARKERS) <= set(columns)


def read_table(path: Path) -> pd.DataFrame:
    """Returns all windows of the file at `path` in the neutral columns; tracks may have holes between windows.

    Raises:
        InputError: the file is missing or not of this format.
    """
    return neutral_table(parquet_input.read_table(path), str(path))


def load(path: Path, crop: Crop | None = None) -> Recording:
    """Returns the windows of the file at `path` within `crop` as a recording.

    Raises:
        InputError: the file is missing or not of this format, `crop` does not fit it, vehicles are missing between
            windows, or :meth:`Recording.from_columns` refuses the content.
    """
    where, arrow = str(path), parquet_input.read_arrow(path)
    columns: Mapping[str, Any] = parquet_input.plain_columns(arrow)
    if not {*arrow.column_names, *(crop or {})} - {*UNUSED} <= {*columns} or {*UNUSED} & {*(crop or {})}:
        columns = arrow.to_pandas()
    rows = within(columns, arrow.num_rows, crop, where)
    neutral = neutral_columns({name: columns[name][rows] for name in columns}, where)
    by_vehicle = np.lexsort((neutral["frame"], neutral["vehicle_id"]))
    vehicle, frame = neutral["vehicle_id"][by_vehicle], neutral["frame"][by_vehicle]
    if ((vehicle[1:] == vehicle[:-1]) & (frame[1:] - frame[:-1] > 1)).any():
        raise InputError(
            f"{where}: vehicles are missing between the windows of this file: crop it to one, such as frame 316 to 543 "
            f"and local_y_m 180 to 415"
        )
    header = RecordingHeader(
        name="us101_0750",
        source="NGSIM US-101 southbound, 2005-06-15, 07:50-08:05 (US DOT / FHWA, doi 10.21949/1504477), windows",
        licence="CC BY-SA",
        net="us101.net.xml",
        notes={"frames": [int(neutral["frame"].min()), int(neutral["frame"].max())]},
    )
    return Recording.from_columns(header, neutral, where)


def neutral_table(table: pd.DataFrame, where: str) -> pd.DataFrame:
    """Returns a windows table in the columns of the neutral schema; tracks may have holes between the windows.

    Raises:
        InputError: as :func:`neutral_columns`.
    """
    import pandas as pd

    return pd.DataFrame(neutral_columns({str(name): column for name, column in table.items()}, where))


def neutral_columns(columns: Mapping[str, Any], where: str) -> dict[str, np.ndarray]:
    """Returns columns of a windows table, arrays or pandas series (n,), as arrays in the neutral schema.

    Raises:
        InputError: a column is missing, unknown or not numeric, or no row is of a window.
    """
    missing = [name for name in COLUMNS if name not in columns and name not in UNUSED]
    unknown = [name for name in columns if name not in COLUMNS]
    if missing or unknown:
        raise InputError(f"{where}: unknown columns {unknown}, missing columns {missing}; expected {list(COLUMNS)}")
    used = {name: columns[name] for name in COLUMNS if name not in UNUSED}
    if words := [name for name, column in used.items() if column.dtype.kind not in NUMBERS]:
        raise InputError(f"{where}: columns {words} do not hold numbers")
    of_windows = np.asarray(used["src"]) < WINDOW_SOURCES
    if not of_windows.any():
        raise InputError(f"{where}: no rows of the windows (src below {WINDOW_SOURCES}) are left to read")
    used = {name: np.asarray(column)[of_windows] for name, column in used.items()}
    values = {name: column.astype(np.float64) for name, column in used.items()}
    yaw = wrap_angle(values["heading_rad"] + US101.yaw)
    front_x, front_y = US101.map_from_global(values["global_x_m"], values["global_y_m"])
    length, width = values["length_m"], values["width_m"]
    motorcycle = (length < MOTORCYCLE_BELOW) & (width < MOTORCYCLE_NARROWER)
    return {
        "vehicle_id": used["vehicle_id"],
        "frame": used["frame"],
        "x": front_x - 0.5 * length * np.cos(yaw),
        "y": front_y - 0.5 * length * np.sin(yaw),
        "yaw": yaw,
        "speed": values["speed_mps"],
        "acceleration": values["accel_mps2"],
        "length": length,
        "width": width,
        "kind": np.select([motorcycle, length > TRUCK_ABOVE], [Kind.MOTORCYCLE, Kind.TRUCK], Kind.CAR),
        "lane": used["lane_est"],
    }
