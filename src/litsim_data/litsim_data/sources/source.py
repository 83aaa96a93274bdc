"""What a data set is to `data import`: plug-ins of ``litsim.sources``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from litsim_data.generic.mapping import Mapping as Meaning
from litsim_data.maps.lane_graph import LaneGraph
from litsim_sim.core import plugins
from litsim_sim.io.table_input import TableFiles

SignalChange = tuple[float, str, str]
"""Time [s] by the clock of the tracks, name of a traffic light of the map, and name of its state from then on."""


@dataclass(frozen=True)
class Scene:
    """One recording of a data set, with its map.

    Attributes:
        name: short name, of letters, digits and ``_ + = -``; files are named after it.
        tracks: the tracks, as the data set has them.
        mapping: meaning of the columns of `tracks`; its `name`, `source`, `licence` and `net` are filled in on import.
        lanes: reads the map: its lanes; or a file, a SUMO net or an OpenDRIVE map. It raises InputError if the map is
            missing or cannot be used. None where the data set has no map.
        map_name: name of the map; scenes with one name have one map.
        signals: what traffic lights of the map showed, ascending in time.
        ego: id of the vehicle that recorded the others, if it is known, which becomes the ego.
        notes: sentences on what of the scene is not used.
        about: licence and citation of its data, if they are not those of its :class:`Source`.
        left_out: numbers of rows of the file that are not among `tracks`, by reason.
    """

    name: str
    tracks: TableFiles
    mapping: Meaning
    lanes: Callable[[], LaneGraph | Path] | None = None
    map_name: str = ""
    signals: Sequence[SignalChange] = ()
    ego: str | None = None
    notes: tuple[str, ...] = ()
    about: tuple[str, str] | None = None
    left_out: Mapping[str, int] = field(default_factory=dict)


class Source(ABC):
    """A data set, made without arguments.

    Attributes:
        content: what a file of it holds, for errors, such as "an Argoverse 2 scenario".
        licence: licence of its data, and whether they may be passed on.
        citation: the publication to cite.
    """

    content: ClassVar[str]
    licence: ClassVar[str]
    citation: ClassVar[str]

    @abstractmethod
    def recognizes(self, path: Path) -> bool:
        """Returns whether the file at `path`, which exists, is a recording of this data set; judged by its content."""

    @abstractmethod
    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """Yields the scenes in the file at `path`.

        Args:
            path: a file that :meth:`recognizes`.
            lanes: file of the map, if the user has named one; else it is in the data, or beside `path`.

        Raises:
            InputError: the file cannot be used.
        """


def known_sources() -> list[Source]:
    """Returns the installed data sets."""
    return [plugins.load(plugins.SOURCES, name)() for name in plugins.names(plugins.SOURCES)]


def source_of(path: Path) -> Source | None:
    """Returns the data set that the file at `path` is of; None if it is of none."""
    return next((source for source in known_sources() if source.recognizes(path)), None)
