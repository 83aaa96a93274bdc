"""SUMO's trajectories: files of option ``--fcd-output``, as XML or as the CSV that SUMO's xml2csv makes of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pandas as pd

from litsim_data.generic.loaded_table import LoadedTable
from litsim_data.sources.source import Scene, Source
from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import open_input, read_head
from litsim_sim.io.table_input import TableFile
from litsim_sim.scenario.recorded_net import NET_ENDINGS

NUMBERS = ("x", "y", "angle", "speed")
COLUMNS = ["vehicle_id", "type", "time", "x", "y", "yaw", "speed"]
ELSEWHERE = 1e9  # [m] coordinates beyond stand for vehicles that are not on the road
SIZES: dict[str, tuple[str, float, float]] = {
    "passenger": ("car", 5.0, 1.8),
    "truck": ("truck", 7.1, 2.4),
    "trailer": ("truck", 16.5, 2.55),
    "bus": ("truck", 12.0, 2.5),
    "coach": ("truck", 14.0, 2.6),
    "delivery": ("car", 6.5, 2.16),
    "motorcycle": ("motorcycle", 2.2, 0.9),
    "moped": ("motorcycle", 2.1, 0.8),
    "bicycle": ("bicycle", 1.6, 0.65),
    "pedestrian": ("pedestrian", 0.5, 0.5),
    "ignoring": ("unknown", 5.0, 1.8),
}
"""Our kind, length and width [m] by SUMO's vehicle class, as SUMO assumes them."""


class SumoTrajectories(Source):
    """Positions of front centres at any step; sizes are those of the vehicle types in the files beside."""

    content = "SUMO's trajectories (--fcd-output, XML or CSV)"
    licence = "that of whoever ran the simulation"
    citation = "Lopez et al., Microscopic Traffic Simulation using SUMO, ITSC 2018"

    def recognizes(self, path: Path) -> bool:
        """See :class:`.source.Source`."""
        head = read_head(path)
        return b"<fcd-export" in head or head.lstrip(b"\xef\xbb\xbf").startswith(b"timestep_time")

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`.source.Source`."""
        name = path.name.split(".")[0]
        table = _from_csv(path) if path.suffix == ".csv" else _from_xml(path)
        places = table[["x", "y"]].apply(pd.to_numeric, errors="coerce")
        table = table[~(places.abs() >= ELSEWHERE).any(axis="columns")].reset_index(drop=True)
        types = vehicle_types(path.parent)
        sizes = [types.get(kind, SIZES["passenger"]) for kind in table["type"]]
        unknown = sorted({*table["type"]} - {*types})
        kinds = [kind for kind, *_ in sizes]
        table = table.assign(kind=kinds, length=[size[1] for size in sizes], width=[size[2] for size in sizes])
        tracks = LoadedTable.of(path, table)
        mapping = tracks.meaning(
            {kind: kind for kind in kinds},
            reference="front_centre",
            units={"angle": "deg"},
            angles={"zero": "y", "positive": "clockwise"},
            accept=["heading", "side"],
        )
        notes = [f"no vType {', '.join(unknown)} in the files beside: cars of 5 by 1.8 m"] if unknown else []
        yield Scene(name, tracks, mapping, partial(_net, path, lanes), f"{name}_net", notes=tuple(notes))


def _net(path: Path, lanes: Path | None) -> Path:
    """Returns the net that is named, or the only one beside the trajectories."""
    if lanes:
        return lanes
    files = sorted({file for ending in NET_ENDINGS for file in path.parent.glob(f"*{ending}")})
    if len(files) != 1:
        held = f"holds {', '.join(file.name for file in files[:5])}" if files else "holds none"
        raise InputError(f"{path}: the SUMO net: {path.parent} {held}: name it by --map")
    return files[0]


def vehicle_types(folder: Path) -> dict[str, tuple[str, float, float]]:
    """Returns our kind, length and width [m] of the vehicle types in the XML files of a folder, and of SUMO's own."""
    types = {f"DEFAULT_{name}TYPE": SIZES[of] for name, of in (("VEH", "passenger"), ("BIKE", "bicycle"))}
    types["DEFAULT_PEDTYPE"] = SIZES["pedestrian"]
    for file in sorted(folder.glob("*.xml")):
        if file.name.endswith((".net.xml", "fcd.xml")):
            continue
        with suppress(InputError, OSError, ET.ParseError, ValueError), open_input(file) as content:  # no file of SUMO
            for _, element in ET.iterparse(content):  # noqa: S314  of users, by a parser without network access
                if element.tag == "vType":
                    kind, length, width = SIZES.get(element.get("vClass", "passenger"), SIZES["passenger"])
                    size = float(element.get("length", length)), float(element.get("width", width))
                    types[element.get("id", "")] = kind, *size
                element.clear()
    return types


def _from_xml(path: Path) -> pd.DataFrame:
    """Returns the columns COLUMNS of an XML file, headings in degrees."""
    rows: list[tuple[Any, ...]] = []
    time = 0.0
    try:
        with open_input(path) as file:
            for event, element in ET.iterparse(file, ("start", "end")):  # noqa: S314  a parser without network access
                if element.tag == "timestep":
                    if event == "start":
                        time = float(element.get("time", ""))
                    else:
                        element.clear()
                elif event == "start" and element.tag in ("vehicle", "person"):
                    values = [float(element.get(name, "nan")) for name in NUMBERS]
                    usual = "DEFAULT_PEDTYPE" if element.tag == "person" else "DEFAULT_VEHTYPE"
                    rows.append((element.get("id", ""), element.get("type", usual), time, *values))
    except (ET.ParseError, ValueError, OSError) as error:
        raise InputError(f"{path}: not a readable file of SUMO's trajectories: {error}") from error
    return pd.DataFrame(rows, columns=COLUMNS)


def _from_csv(path: Path) -> pd.DataFrame:
    """Returns the same of a CSV file, whose columns are named after elements and attributes."""
    names = ["vehicle_id", "vehicle_type", "timestep_time", *(f"vehicle_{name}" for name in NUMBERS)]
    table = TableFile.open(path).read(names).dropna(subset=["vehicle_id"])  # steps without vehicles have a row
    return table[names].set_axis(COLUMNS, axis="columns").astype({"vehicle_id": str, "type": str})
