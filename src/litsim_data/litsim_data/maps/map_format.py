"""Formats of maps that `data map` imports: plug-ins of ``litsim.maps``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import yaml

from litsim_data.maps.lane_graph import LaneGraph
from litsim_sim.io.files import write_text

SIGNALS_HEAD = """# Connections by the traffic lights of the map, under their ids there (Lanelet2: of the relations).
# In place of `states`, a file with columns group, begin and state, may be `program`, a timing plan: docs/signals.md
"""


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
        """Writes the map at `path` as a SUMO net to `out`; returns lines on what was not used, and on warnings.

        Args:
            path: file of this format.
            origin: latitude and longitude [deg] of the point that becomes (0, 0), if the user has given it.
            out: the net to write.

        Raises:
            InputError: the map cannot be used, or netconvert is missing.
        """


def _write_groups(groups: Mapping[str, Sequence[str]], net: Path) -> list[str]:
    """Writes a file of signals beside a net, of groups that are named as the lights of the map; returns a line on it.

    A file that is there is kept, as users say in it what the lights show.
    """
    if not groups:
        return []
    path = net.with_name(f"{net.name.removesuffix('.net.xml')}_signals.yaml")
    if path.exists():
        return [f"signals: {path} exists already and is kept"]
    content = yaml.safe_dump({"groups": {name: [*groups[name]] for name in groups}}, sort_keys=False)
    write_text(path, f"{SIGNALS_HEAD}{content}states: {{file: states.csv}}\n")
    return [f"signals: {len(groups)} traffic lights of the map -> {path}; name there what they show"]


class GraphFormat(MapFormat):
    """A format that is read as a lane graph, of which LitSim builds the net."""

    @abstractmethod
    def read(self, path: Path, origin: tuple[float, float] | None) -> LaneGraph:
        """Returns the lanes of the map at `path`; arguments and errors are those of :meth:`write_net`."""

    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:
        """See :class:`MapFormat`; the groups of the traffic lights are written beside the net."""
        from litsim_data.maps.net_builder import write_graph

        graph = self.read(path, origin)
        built = write_graph(graph, out)
        return [*built.notes, *_write_groups(built.controlled(graph), out)]


class CommonRoad(GraphFormat):
    """Maps of CommonRoad scenarios, in their own frame."""

    file, content = "F.xml", "a CommonRoad lanelet map"

    def read(self, path: Path, origin: tuple[float, float] | None) -> LaneGraph:  # noqa: ARG002 - has its own frame
        """See :class:`GraphFormat`."""
        from litsim_data.maps.commonroad import read_graph, read_root

        return read_graph(read_root(path), path)


class Lanelet2(GraphFormat):
    """Lanelet2 maps, as of Autoware; frame map is UTM metres from the origin, x east, y north."""

    file, content = "F.osm", "a Lanelet2 map (pip install lanelet2)"

    def read(self, path: Path, origin: tuple[float, float] | None) -> LaneGraph:
        """See :class:`GraphFormat`."""
        from litsim_data.maps.lanelet2_osm import read_graph

        return read_graph(path, origin)


class OpenDrive(MapFormat):
    """OpenDRIVE maps, through netconvert, in the frame of the file.

    They describe roads by curves and lanes by polynomials along them, with signals, and roundings at junctions; all of
    that netconvert has read for years. Maps on whose roads traffic keeps to either side are read as a lane graph.
    """

    file, content = "F.xodr", "an OpenDRIVE map through netconvert"

    def write_net(self, path: Path, origin: tuple[float, float] | None, out: Path) -> list[str]:  # noqa: ARG002 - has its own frame
        """See :class:`MapFormat`."""
        from litsim_data.maps.net_builder import write_graph
        from litsim_data.maps.netconvert import import_opendrive
        from litsim_data.maps.opendrive_lanes import has_both_rules, read_lanes

        return [*write_graph(read_lanes(path), out).notes] if has_both_rules(path) else import_opendrive(path, out)
