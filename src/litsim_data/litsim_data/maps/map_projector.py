"""``map_projector_info.yaml``, which says how Autoware finds the coordinates of a Lanelet2 map in its frame ``map``.

The kinds are those of autoware_lanelet2_extension: UTM from another origin, or about a meridian of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self
from xml.etree import ElementTree as ET

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from litsim_data.generic.geography import mercator, meridian_of, utm
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray
from litsim_sim.io.yaml_input import read_yaml

PROJECTOR_FILE = "map_projector_info.yaml"
EAST_MAX = 10.0  # [deg] from the central meridian, within which UTM is used at all
SQUARE = 100_000.0  # [m] of a square of the MGRS
ROWS = "ABCDEFGHJKLMNPQRSTUV"
"""Letters of the squares from south to north, which repeat; those of columns are as well without I and O."""
COLUMNS = "ABCDEFGHJKLMNPQRSTUVWXYZ"


class Origin(BaseModel):
    """The place that is (0, 0): latitude and longitude [deg]; the altitude is not used, as the world is flat."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    latitude: Annotated[float, Field(ge=-80.0, le=84.0)]
    longitude: Annotated[float, Field(ge=-180.0, le=180.0)]
    altitude: float = 0.0


class MapProjector(BaseModel):
    """The content of a ``map_projector_info.yaml``.

    Attributes:
        projector_type: Local: coordinates in metres are in tags of the nodes; LocalCartesianUTM: UTM metres from the
            origin; MGRS: UTM metres from the south-west corner of a square; TransverseMercator: as UTM, with the
            central meridian through the origin.
        mgrs_grid: the square, such as ``54SUE``.
        map_origin: the origin.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    projector_type: Literal["Local", "local", "LocalCartesianUTM", "MGRS", "TransverseMercator"]
    mgrs_grid: Annotated[str, Field(pattern=r"^\d{1,2}[C-HJ-NP-X][A-HJ-NP-Z][A-HJ-NP-V]$")] | None = None
    map_origin: Origin | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.projector_type == "MGRS" and self.mgrs_grid is None:
            raise ValueError("projector_type MGRS needs field mgrs_grid, such as 54SUE")
        if self.projector_type in ("LocalCartesianUTM", "TransverseMercator") and self.map_origin is None:
            raise ValueError(f"projector_type {self.projector_type} needs field map_origin")
        return self

    @classmethod
    def beside(cls, source: Path) -> MapProjector | None:
        """Returns the projector of the map file `source`, from the file in its folder; None where there is none.

        Raises:
            InputError: the file cannot be read, or a field does not fit.
        """
        path = source.parent / PROJECTOR_FILE
        return read_yaml(path, cls) if path.is_file() else None

    def locate(self, latitude: FloatArray, longitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns x and y (n,) [m] in frame ``map`` of Autoware of places (n,) [deg].

        Raises:
            ValueError: a place is far outside of the zone.
        """
        if self.projector_type == "MGRS":
            assert self.mgrs_grid is not None
            meridian = 6.0 * int(self.mgrs_grid[:-3]) - 183.0
            x, y = utm(latitude, longitude, meridian)
            corner_x, corner_y = _corner(self.mgrs_grid, float(y[0]))
        else:
            assert self.map_origin is not None
            origin = np.array(self.map_origin.latitude), np.array(self.map_origin.longitude)
            turned = self.projector_type == "TransverseMercator"
            meridian = float(origin[1]) if turned else meridian_of(*map(float, origin))
            x, y = mercator(latitude, longitude, meridian)
            corner_x, corner_y = map(float, mercator(*origin, meridian))
        if (far := np.abs(longitude - meridian) > EAST_MAX).any():
            raise ValueError(f"longitude {longitude[far][0]:g} is more than {EAST_MAX:g} degrees from {meridian:g}")
        return x - corner_x, y - corner_y


def _corner(grid: str, northing: float) -> tuple[float, float]:
    """Returns UTM easting and northing [m] of the south-west corner of a square, for a map at about `northing`.

    Columns are lettered through three zones each, eight to a zone; rows begin anew every 2000 km, in zones of even
    number at F.
    """
    zone, column, row = int(grid[:-3]), grid[-2], grid[-1]
    easting = (COLUMNS.index(column) - 8 * ((zone - 1) % 3) + 1) * SQUARE
    again = len(ROWS) * SQUARE
    south = ((ROWS.index(row) - (0 if zone % 2 else 5)) % len(ROWS)) * SQUARE
    return easting, south + again * round((northing - south) / again)


def located(nodes: Sequence[ET.Element], source: Path) -> list[tuple[float, float]] | None:
    """Returns x and y [m] in Autoware's frame ``map`` of the nodes of the Lanelet2 file `source`.

    None is returned where no ``map_projector_info.yaml`` lies beside the file, or where it says that tags of the nodes
    have them.

    Raises:
        InputError: that file cannot be used, or a node has no place on earth that fits it.
    """
    projector = MapProjector.beside(source)
    if projector is None or projector.projector_type.capitalize() == "Local" or not nodes:
        return None
    try:
        degrees = (np.array([_degrees(node, name) for node in nodes]) for name in ("lat", "lon"))
        x, y = projector.locate(*degrees)
        return list(zip(x.tolist(), y.tolist(), strict=True))
    except ValueError as error:
        why = " ".join(str(error).split())
        raise InputError(f"{source}: {PROJECTOR_FILE} beside it, {projector.projector_type}: {why}") from error


def _degrees(node: ET.Element, name: str) -> float:
    value = node.get(name)
    if value is None:
        raise ValueError(f"node {node.get('id')} has no {name}")
    if not abs(degrees := float(value)) <= (84.0 if name == "lat" else 180.0):
        raise ValueError(f"node {node.get('id')}: {name} is {degrees:g}")
    return degrees
