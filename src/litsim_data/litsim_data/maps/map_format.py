"""Formats of maps that `data map` imports: plug-ins of ``litsim.maps``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from litsim_sim.core.errors import InputError


class MapFormat(ABC):
    """A format of maps, made without arguments; its entry point's name is the option of `data map` that reads it.

    Attributes:
        file: name of a file of this format in help, such as ``F.osm``.
        content: what such a file holds, in help, such as "a Lanelet2 map".
    """

    file: ClassVar[str]
    content: ClassVar[str]

    @abstractmethod
    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:
        """Writes the map at `path` as a SUMO net to `out`; returns netconvert's warnings.

        Args:
            path: file of this format.
            origin: latitude and longitude [deg] of the point that becomes (0, 0), if the user has given it.
            out: the net to write.

        Raises:
            InputError: the map cannot be used, or netconvert is missing.
        """


class CommonRoad(MapFormat):
    """Maps of CommonRoad scenarios, in their own frame."""

    file, content = "F.xml", "a CommonRoad lanelet map"

    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:  # noqa: ARG002 - has its own frame
        """See :class:`MapFormat`."""
        from litsim_data.maps.commonroad import read_lanelets
        from litsim_data.maps.lanelets import write_lanelets

        return write_lanelets(read_lanelets(path), out)


class Lanelet2(MapFormat):
    """Lanelet2 maps, as of Autoware; frame map is UTM metres from the origin, x east, y north."""

    file, content = "F.osm", "a Lanelet2 map (pip install lanelet2)"

    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:
        """See :class:`MapFormat`."""
        from litsim_data.maps.lanelet2_osm import read_lanelets
        from litsim_data.maps.lanelets import write_lanelets

        if origin is None:
            raise InputError("data map: --lanelet2 needs --origin LAT LON, the point that becomes (0, 0)")
        return write_lanelets(read_lanelets(path, origin), out)


class OpenDrive(MapFormat):
    """OpenDRIVE maps, through netconvert, in the frame of the file."""

    file, content = "F.xodr", "an OpenDRIVE map through netconvert"

    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:  # noqa: ARG002 - has its own frame
        """See :class:`MapFormat`."""
        from litsim_data.maps.netconvert import import_opendrive

        return import_opendrive(path, out)
