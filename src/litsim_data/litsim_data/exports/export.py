"""What an export format is: plug-ins of ``litsim.exports``."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from xml.etree import ElementTree as ET

import pandas as pd

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S
from litsim_sim.io.files import replacing
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.signals import Signals


@dataclass(frozen=True)
class Content:
    """What is exported: the motion of agents on a net, or a net alone.

    Attributes:
        name: short name.
        path: where it is from, for errors.
        table: the neutral columns by agent and frame, ascending in frames, and those of a run; None for a net alone.
        net: SUMO net; None where it is not known.
        ego: id of the ego; None for a recording.
        free_from: frame from which on the ego is free; the first one for a recording.
        signals: states of the net's signals, from the first frame on; None where they are not known.
        source, licence: those of the recording.
    """

    name: str
    path: Path
    table: pd.DataFrame | None = None
    net: Path | None = None
    ego: int | None = None
    free_from: int = 0
    signals: Signals | None = None
    source: str = ""
    licence: str = ""

    def motion(self) -> pd.DataFrame:
        """Returns the table, with column `t`: time from its first frame [s].

        Raises:
            InputError: a net has no motion.
        """
        if self.table is None:
            raise InputError(f"{self.path}: is a net, expected a run, a scenario or a recording")
        return self.table.assign(t=((self.table["frame"] - self.table["frame"].min()) * STEP_S).round(3))

    @property
    def counts(self) -> str:
        """How many rows of how many agents the table has, and in a run which controllers moved them."""
        assert self.table is not None
        by = self.table["controller"].value_counts().items() if "controller" in self.table else ()
        moved = ", ".join(f"{count} {name}" for name, count in by)
        return f"{len(self.table)} rows of {self.table['vehicle_id'].nunique()} agents{f' ({moved})' if moved else ''}"

    def net_file(self) -> Path:
        """Returns the SUMO net.

        Raises:
            InputError: it is not known.
        """
        if self.net is None:
            raise InputError(f"{self.path}: its net is not known: name it by --net")
        return self.net

    def lanes(self) -> LaneMap:
        """Returns the lanes of the net.

        Raises:
            InputError: the net is not known, or cannot be read.
        """
        return LaneMap.from_net(self.net_file())


class Export(ABC):
    """A format, made without arguments; it is chosen by the ending of the file to write.

    Attributes:
        endings: of file names, such as ``.xosc``; where several fit, the longest counts.
        content: what such a file holds, in help.
    """

    endings: ClassVar[tuple[str, ...]]
    content: ClassVar[str]

    @abstractmethod
    def write(self, content: Content, out: Path) -> list[str]:
        """Writes the file `out`, and others beside it; returns lines: counts first where there are any, others then.

        Raises:
            InputError: the content lacks what the format needs, or a file cannot be written.
        """


def by_ending() -> dict[str, Export]:
    """Returns the installed formats by their endings, the longest first."""
    formats = [plugins.load(plugins.EXPORTS, name)() for name in plugins.names(plugins.EXPORTS)]
    pairs = {ending: file_format for file_format in formats for ending in file_format.endings}
    return dict(sorted(pairs.items(), key=lambda pair: (-len(pair[0]), pair[0])))


def format_of(out: Path) -> Export:
    """Returns the format by the ending of the file to write.

    Raises:
        InputError: there is none.
    """
    formats = by_ending()
    for ending, file_format in formats.items():
        if out.name.endswith(ending):
            return file_format
    expected = "; ".join(f"{ending}: {file_format.content}" for ending, file_format in formats.items())
    raise InputError(f"{out}: expected a name with the ending of a format: {expected}")


def beside(out: Path, ending: str) -> Path:
    """Returns the file beside `out` of the same name, up to its first dot, with another ending."""
    return out.with_name(f"{out.name.split('.')[0]}{ending}")


def write_xml(root: ET.Element, path: Path) -> None:
    """Writes the XML file `path`.

    Raises:
        InputError: it cannot be written.
    """
    ET.indent(root)
    with replacing(path) as new:
        ET.ElementTree(root).write(new, encoding="UTF-8", xml_declaration=True)


def add(parent: ET.Element, path: str, text: object = None, **attributes: object) -> ET.Element:
    """Adds elements within each other, such as ``Init/Actions``; the last one, which is returned, gets the rest."""
    for tag in path.split("/"):
        parent = ET.SubElement(parent, tag)
    parent.attrib |= {name: str(value) for name, value in attributes.items()}
    parent.text = None if text is None else str(text)
    return parent
