"""What a source of recordings is: a plug-in of ``litsim.sources`` that recognizes files and reads scenes of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar

from litsim_data.generic.mapping import Mapping as Meaning
from litsim_data.generic.mapping import Span
from litsim_data.maps.lane_graph import LaneGraph
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.io.table_input import TableFiles
from litsim_sim.scenario.cropping import Crop
from litsim_sim.scenario.recording import Recording

SignalChange = tuple[float, str, str]
"""Time [s] by the clock of the tracks, name of a traffic light of the map, and name of its state from then on."""


@dataclass(frozen=True)
class Scene:
    """One recording of a source, with its map if the source has one.

    Attributes:
        name: short name, of letters, digits and ``_ + = -``; files are named after it.
        tracks: the tracks, as they are published; or a recording that needs no conversion.
        mapping: meaning of the columns of `tracks`; its `name`, `source` and `licence` are filled in on import. None
            for a recording.
        lanes: reads the map: its lanes; or a file, a SUMO net or an OpenDRIVE map. It raises InputError if the map is
            missing or cannot be used. None where the source has no map.
        map_name: name of the map; scenes with one name have one map.
        signals: what traffic lights of the map showed, ascending in time.
        ego: id of the vehicle that recorded the others, if it is known, which becomes the ego.
        notes: sentences on what of the scene is not used.
        about: licence and citation of its data, if they are not those of its :class:`Source`.
        signals_file: a file of signals of the net (docs/signals.md), in place of `signals`.
    """

    name: str
    tracks: TableFiles | Recording
    mapping: Meaning | None
    lanes: Callable[[], LaneGraph | Path] | None = None
    map_name: str = ""
    signals: Sequence[SignalChange] = ()
    ego: str | None = None
    notes: tuple[str, ...] = ()
    about: tuple[str, str] | None = None
    signals_file: Path | None = None

    def cropped(self, crop: Crop | None) -> Scene:
        """Returns the scene with the rows of its tracks whose columns are within [low, high] alone.

        Raises:
            InputError: a range is no pair of numbers.
        """
        if not crop or self.mapping is None:
            return self
        try:
            spans = {name: Span(min=low, max=high) for name, (low, high) in crop.items()}
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.tracks}: crop is {dict(crop)}, expected [low, high] by column") from error
        return replace(self, mapping=self.mapping.model_copy(update={"rows": self.mapping.rows | spans}))


class Source(ABC):
    """A kind of files with recordings, made without arguments.

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
        """Returns whether the file at `path`, which exists, is a recording of this source; judged by its content."""

    @abstractmethod
    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """Yields the scenes in the file at `path`.

        Args:
            path: a file that :meth:`recognizes`.
            lanes: file of the map, if the user has named one; else it is in the data, or beside `path`.

        Raises:
            InputError: the file cannot be used.
        """

    def scenes(self, path: Path, lanes: Path | None, crop: Crop | None) -> Iterator[Scene]:
        """Yields the scenes as :meth:`read`, cropped: the [low, high] to keep, by column of the tracks."""
        return (scene.cropped(crop) for scene in self.read(path, lanes))

    def load(self, path: Path, crop: Crop | None) -> Recording:
        """Returns the only recording in the file at `path`, without map and signals.

        Raises:
            InputError: the file cannot be used, or holds several.
        """
        from litsim_data.sources.conversion import converted  # loads scipy, which ready recordings do not need

        every = self.scenes(path, None, crop)
        scene, *others = islice(every, 2)
        if others:
            raise InputError(
                f"{path}: holds several recordings ({scene.name}, {others[0].name} and maybe more): import it first, "
                f"data import {path.name} FOLDER"
            )
        return converted(scene, self)[0]


class ReadySource(Source):
    """A source whose files hold one recording that needs no conversion, which :meth:`load` returns."""

    def read(self, path: Path, lanes: Path | None) -> Iterator[Scene]:
        """See :class:`Source`."""
        return self.scenes(path, lanes, None)

    def scenes(self, path: Path, lanes: Path | None, crop: Crop | None) -> Iterator[Scene]:  # noqa: ARG002 - has no map
        """See :class:`Source`."""
        recording = self.load(path, crop)
        yield Scene(recording.header.name, recording, None)

    @abstractmethod
    def load(self, path: Path, crop: Crop | None) -> Recording:
        """See :class:`Source`."""


def known_sources() -> list[Source]:
    """Returns the installed sources."""
    return [plugins.load(plugins.SOURCES, name)() for name in plugins.names(plugins.SOURCES)]


def source_of(path: Path) -> Source | None:
    """Returns the source that the file at `path` is of; None if it is of none."""
    return next((source for source in known_sources() if source.recognizes(path)), None)
