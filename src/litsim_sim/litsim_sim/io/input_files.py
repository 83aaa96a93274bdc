"""Opening of files that users name: regular ones only, packed ones up to a bound; and reading of XML and JSON in them.

A device has no end, a pipe without a writer is waited for, and a small file may fill the memory once it is unpacked.
"""

from __future__ import annotations

import io
import json
import stat
from math import inf, nan
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree as ET

from litsim_sim.core.errors import InputError

PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\x04\x22\x4d\x18": "lz4", b"\x28\xb5\x2f\xfd": "zstd"}
"""What packed files begin with, whatever they are called, and Arrow's names of how they are packed."""
UNPACKED_MIN = 512 * 2**20  # [B] to which any packed file may unpack
SHRUNK_MAX = 100  # times that a larger file may grow by unpacking
TREE_MAX = 256 * 2**20  # [B] of a text that is read whole into a tree, which is ten times as large


def require_file(path: Path, what: str = "file", hint: str = "", *, where: str = "", size_max: float = inf) -> None:
    """Check that `path` is a regular file of at most `size_max` bytes, for a reader that opens it itself.

    Raises an InputError if it is not, or cannot be reached. `what` it should be, such as "net", and a `hint`, such
    as "; shipped are ...", are added to that; `where`, such as "a.yaml: field net: ", is put before.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{where}{path}: no such {what}{hint}") from error
    except OSError as error:
        raise InputError(f"{where}{path}: cannot be read: {error.strerror or error}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "folder" if stat.S_ISDIR(status.st_mode) else "device, pipe or socket"
        raise InputError(f"{where}{path}: is a {kind}, expected a file")
    if status.st_size > size_max:
        raise InputError(f"{where}{path}: has {status.st_size} bytes, expected at most {size_max}")


def open_input(path: Path, what: str = "file", *, size_max: float = inf) -> BinaryIO:
    """Opens a file for reading, and unpacks it if it is packed.

    Raises an InputError as :func:`require_file` with these arguments, or once more than `size_max` bytes are read,
    unpacked.
    """
    require_file(path, what, size_max=size_max)
    try:
        if packing := packing_of(path):
            return io.BufferedReader(_Unpacked(path, packing, size_max))
        return path.open("rb")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def packing_of(path: Path) -> str:
    """Returns how the file at `path` is packed, by Arrow's names; empty if it is not; raises OSError."""
    with path.open("rb") as file:
        head = file.read(4)
    return next((name for magic, name in PACKED.items() if head.startswith(magic)), "")


def read_head(path: Path, size: int = 4000) -> bytes:
    """Returns the first `size` bytes, unpacked, by which formats are recognised; raises as :func:`open_input`."""
    try:
        with open_input(path) as file:
            return file.read(size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def unpacked_max(packed: int) -> int:
    """Returns the most [B] that a file of `packed` bytes may unpack to: tables of measurements shrink tenfold at most.

    A small file that is large once it is unpacked would fill the memory.
    """
    return max(UNPACKED_MIN, SHRUNK_MAX * packed)


def read_plain_xml(path: Path, what: str) -> ET.Element:
    """Returns the root element as :func:`read_xml`; the tags of all elements are without namespaces."""
    root = read_xml(path, what)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def number_in(element: ET.Element, name: str, most: float) -> float:
    """Returns an attribute that is a number of at most `most`, whatever its sign; raises ValueError otherwise."""
    text = element.get(name)
    try:
        value = float(text or "")
    except ValueError:
        value = nan
    if not abs(value) <= most:
        raise ValueError(f"element {element.tag}: attribute {name} is {text!s:.60}, expected a number up to {most:g}")
    return value


def read_xml(path: Path, what: str) -> ET.Element:
    """Returns the root element of an XML file; raises InputError if it is no `what`, such as "Lanelet2 file"."""
    try:
        with open_input(path, what, size_max=TREE_MAX) as file:
            root: ET.Element = ET.parse(file).getroot()  # noqa: S314  by a parser without network, that bounds entities
            return root
    except (ET.ParseError, OSError, ValueError, LookupError) as error:  # the latter of encodings that are none
        raise InputError(f"{path}: not a readable {what}: {error}") from error


def read_json(path: Path, what: str) -> Any:
    """Returns the content of a JSON file; raises InputError if it is none, and says that `what` is expected."""
    require_file(path, hint=f", expected {what}")
    try:
        with open_input(path, size_max=TREE_MAX) as file:
            return json.load(file)
    except RecursionError as error:
        raise InputError(f"{path}: nested deeper than can be read, expected {what}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not readable as JSON, expected {what}: {error}") from error


class _Unpacked(io.RawIOBase):
    """The content of a packed file, up to the bound on it.

    Raises:
        InputError: when more is read.
    """

    def __init__(self, path: Path, packing: str, size_max: float) -> None:
        import pyarrow as pa  # takes a while to load, and few files are packed

        self._path, self._stream = path, pa.input_stream(path, compression=packing)
        self._left = self._most = min(size_max, unpacked_max(path.stat().st_size))

    def readable(self) -> bool:
        """See :class:`io.RawIOBase`."""
        return True

    def readinto(self, buffer: Any) -> int:
        """See :class:`io.RawIOBase`."""
        data = self._stream.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise InputError(f"{self._path}: unpacks to more than {self._most} bytes, the most expected of its size")
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        """See :class:`io.RawIOBase`."""
        self._stream.close()
        super().close()
