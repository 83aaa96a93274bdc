"""The net that a recording lies on."""

from __future__ import annotations

from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import RecordingHeader
from litsim_sim.scenario.scenario import packaged, packaged_nets

NET_ENDINGS = (".net.xml", ".net.xml.gz")
"""Of files of nets."""


def net_named(name: str, folder: Path | str = ".") -> Path:
    """Returns the packaged net of a name, else the file that the name is of, seen from `folder`."""
    return packaged(f"nets/{name}.net.xml") if name in packaged_nets() else Path(folder) / name


def net_of(header: RecordingHeader, recording: Path, named: str | None = None) -> Path:
    """Returns the net of a recording: the one that is `named`, packaged or a file, or that of its header.

    The latter is packaged, or lies in the folder of the `recording`. Raises an InputError if there is none.
    """
    name = named or header.net
    plain = name.removesuffix(".net.xml")
    if plain in packaged_nets():
        return packaged(f"nets/{plain}.net.xml")
    folder = Path() if named else recording.parent
    for file in (folder / name, folder / f"{name}.net.xml"):
        if name and file.is_file():
            return file
    raise InputError(
        f"{recording}: no net {folder / name if name else 'named in its header'}: expected a file there, or one of the "
        f"packaged {', '.join(packaged_nets())}; where a command has --net, it names another"
    )
