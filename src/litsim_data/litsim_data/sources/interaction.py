"""INTERACTION: ``vehicle_tracks_*.csv``, with ``pedestrian_tracks_*.csv`` beside, or many cases of a few seconds in
one file, as since version 1.2; and Lanelet2 maps.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.generic.mapping import Columns, Mapping
from litsim_data.maps.lane_graph import LaneGraph
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFiles, first_cells

COLUMNS = Columns(
    vehicle_id="track_id",
    time="timestamp_ms",
    x="x",
    y="y",
    yaw="psi_rad",
    speed=("vx", "vy"),
    length="length",
    width="width",
    kind="agent_type",
)
NAMES = [*COLUMNS.named().values()]
CASE = "case_id"
"""Column of the cases, in each of which ids and times begin anew."""
ORIGIN = (0.0, 0.0)
"""Latitude and longitude [deg] of (0, 0) in its maps, which lie in the Gulf of Guinea."""
KINDS = {"car": "car", "truck": "truck", "bus": "truck", "motorcycle": "motorcycle"}
WALKING = {"pedestrian": "pedestrian", "bicycle": "bicycle", "pedestrian/bicycle": "pedestrian"}


class Interaction(Source):
    """Recordings of some minutes at 10 Hz, or of 4 s each."""

    content = "INTERACTION (vehicle_tracks_*.csv, or *.csv with column case_id)"
    licence = "INTERACTION: non-commercial research; the data must not be passed on"
    citation = (
        "Zhan et al., INTERACTION Dataset: An INTERnational, Adversarial and Cooperative moTION Dataset in Interactive "
        "Driving Scenarios with Semantic Maps, arXiv:1910.03088, 2019"
    )

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        return path.suffix == ".csv" and {*NAMES} <= first_cells(path)

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        beside = path.with_name(path.name.replace("vehicle", "pedestrian"))
        files = [path, beside] if beside != path and beside.is_file() else [path]
        tracks = TableFiles.open(files)
        kinds = dict.fromkeys(map(str, tracks.read(["agent_type"])["agent_type"].unique()), "unknown") | KINDS | WALKING
        mapping = Mapping.of_scene(COLUMNS, kinds, units={"time": "ms"})
        if CASE in tracks.columns:
            place = path.stem.rpartition("_")[0] or path.stem
            for case, rows in tracks.read([*NAMES, CASE]).groupby(CASE, sort=True):
                named = LoadedTable.of(path, rows[NAMES].reset_index(drop=True))
                yield Scene(f"{path.stem}_{case:g}", named, mapping, partial(_map, path, lanes, place), place)
            return
        place = path.resolve().parent.name.lstrip(".")
        name = f"{place}_{path.stem.removeprefix('vehicle_tracks_')}"
        yield Scene(name, tracks, mapping, partial(_map, path, lanes, place), place)


def _map(path: Path, lanes: Path | None, name: str) -> LaneGraph | Path:
    """Returns the map that is named, or ``maps/NAME.osm`` in the folder of the recording or above.

    Raises:
        InputError: there is none.
    """
    from litsim_data.maps.lanelet2_osm import read_graph

    place = path.resolve().parent
    beside = [folder / "maps" / f"{name}.osm" for folder in (place, *place.parents[:2])]
    file = lanes or next((candidate for candidate in beside if candidate.is_file()), None)
    if file is None:
        raise InputError(f"{path}: no map {beside[-1]}: name it by --map")
    return file if file.suffix == ".xodr" else read_graph(file, ORIGIN)
