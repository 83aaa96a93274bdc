"""Survey of an MCAP file: the places of its records, and whether its bytes are those that were written.

MCAP has four checksums, all CRC-32: of each chunk (its records, uncompressed), of each attachment, of the data section
(every byte before the record DataEnd) and of the summary with the footer; zero means that the writer gave none. The
mcap library checks, on request, a chunk's, and the data section's if a file is read from end to end; it never checks
those of attachments and of the summary. All except the chunks', which are checked on opening, are therefore checked
here, before anything in the file is trusted.

A truncated file is distinguished from a damaged one: the first ends within a record, or without the format's last eight
bytes, and its content is otherwise as it was written; the second is refused.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC as MAGIC
from zstandard import ZstdError, frame_content_size

from litsim_sim.core.errors import InputError

DAMAGE = (McapError, ZstdError, struct.error, ValueError, EOFError, IndexError, KeyError, MemoryError, OverflowError)
"""Exceptions that the mcap library raises for missing or wrong bytes."""

_HEAD = struct.Struct("<BQ")  # of every record: opcode, bytes that follow
_CRC = struct.Struct("<I")
_FOOTER = struct.Struct("<QQI")  # begin of the summary, begin of its offsets, checksum
_BLOCK = 2**20
CHUNK_MAX = 256 * 2**20  # [B] of a chunk, unpacked; those of LitSim and of ros2 bag have at most some millions
_KINDS: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_COUNTED = {Opcode.CHUNK: "chunk_count", Opcode.ATTACHMENT: "attachment_count", Opcode.METADATA: "metadata_count"}
"""Records of the data section that the summary's statistics count."""


@dataclass(frozen=True)
class Place:
    """A record as it lies in the file: its opcode, its first byte, that of its content, and the one after its last."""

    opcode: int
    begin: int
    content: int
    end: int


@dataclass(frozen=True)
class Survey:
    """Result of the survey of a file.

    Attributes:
        data: records of the data section in file order, without its end.
        summary: records of the summary; empty for a truncated file, as its checksum is in the last record.
        cut: offset of the byte after the last complete record of a truncated file; None if the file was closed.
    """

    data: tuple[Place, ...]
    summary: tuple[Place, ...]
    cut: int | None


def survey(path: Path) -> Survey:
    """Find the records of a file and check its bytes, except inside of chunks; raises InputError if it is damaged."""
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: not an MCAP file")
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                return _survey(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def places(content: mmap.mmap | bytes) -> Iterator[Place]:
    """Yields the records of a file in order, up to its footer or the last complete record."""
    begin, size = len(MAGIC), len(content)
    while begin + _HEAD.size <= size:
        opcode, length = _HEAD.unpack_from(content, begin)
        inside = begin + _HEAD.size
        if not opcode or length > size - inside:
            return
        yield Place(opcode, begin, inside, inside + length)
        if opcode == Opcode.FOOTER:
            return
        begin = inside + length


def parse(place: Place, content: bytes) -> McapRecord | None:
    """Returns a record from its content; None for kinds that bags do not need. Raises one of DAMAGE if it is none."""
    stream = ReadDataStream(BytesIO(content))
    if place.opcode == Opcode.MESSAGE:
        return Message.read(stream, len(content))
    kind = _KINDS.get(place.opcode)
    return None if kind is None else kind.read(stream)


def records_of(chunk: Chunk, path: Path) -> list[McapRecord]:
    """Returns the records in a chunk of the file at `path`.

    Raises:
        InputError: they are larger than any writer makes them, and would fill the memory.
        one of DAMAGE: they are not what was written.
    """
    stated = frame_content_size(chunk.data) if chunk.compression == "zstd" else 0
    if (size := max(stated, chunk.uncompressed_size)) > CHUNK_MAX:
        raise InputError(f"{path}: a chunk unpacks to {size} bytes, expected at most {CHUNK_MAX}")
    return breakup_chunk(chunk, validate_crc=True)


def damage_at(path: Path, byte: int, what: str) -> InputError:
    """Returns an error about the place at which `path` is damaged."""
    return InputError(f"{path}: damaged at byte {byte}: {what}")


def attachment_is_whole(content: bytes) -> bool:
    """Returns whether the content of an attachment's record matches its checksum, if its writer gave one."""
    if len(content) < _CRC.size:
        return False
    (checksum,) = _CRC.unpack(content[-_CRC.size :])
    return checksum in (0, zlib.crc32(content[: -_CRC.size]))


def _survey(path: Path, content: mmap.mmap) -> Survey:
    records = list(places(content))
    end = records[-1].end if records else len(MAGIC)
    tail = content[end:]
    footer = records[-1] if records and records[-1].opcode == Opcode.FOOTER else None
    at_end = next((i for i, place in enumerate(records) if place.opcode == Opcode.DATA_END), None)
    data = records[:at_end]
    for place in data:
        if place.opcode == Opcode.ATTACHMENT and not attachment_is_whole(content[place.content : place.end]):
            raise damage_at(path, place.begin, "an attachment is not what was written")
    if at_end is not None:
        _check_data(path, content, records[at_end])
    closed = len(content) >= end + len(MAGIC) and content[-len(MAGIC) :] == MAGIC
    if footer is None or tail != MAGIC:
        if closed or not _cut_short(tail, footer):
            raise damage_at(path, end, "no record that can be read")
        return Survey(tuple(data), (), end)
    if at_end is None:
        raise damage_at(path, footer.begin, "the end of the data is missing")
    _check_summary(path, content, records[at_end].end, footer)
    summary = tuple(records[at_end + 1 : -1])
    _check_counts(path, content, data, summary)
    return Survey(tuple(data), summary, None)


def _cut_short(tail: bytes, footer: Place | None) -> bool:
    """Returns whether `tail` can be the end of a file that was not written to its end.

    Bytes that were allocated but not written when the power failed are zero.
    """
    if footer is not None:
        return MAGIC.startswith(tail)
    return not tail.strip(b"\0") or bool(tail[0])


def _check_data(path: Path, content: mmap.mmap, end: Place) -> None:
    """Check the data section against its checksum, if the writer gave one."""
    if end.end - end.content != _CRC.size:
        raise damage_at(path, end.begin, "the end of the data is not what was written")
    (checksum,) = _CRC.unpack_from(content, end.content)
    if checksum and checksum != _crc(content, 0, end.begin):
        raise damage_at(path, end.begin, "the bytes before are not those that were written")


def _check_summary(path: Path, content: mmap.mmap, begin: int, footer: Place) -> None:
    """Check the summary, from `begin` on, and the footer against their checksum, if the writer gave one."""
    if footer.end - footer.content != _FOOTER.size:
        raise damage_at(path, footer.begin, "the footer is not what was written")
    start, _, checksum = _FOOTER.unpack_from(content, footer.content)
    if start not in (0, begin) or (checksum and checksum != _crc(content, begin, footer.end - _CRC.size)):
        raise damage_at(path, begin, "the summary is not what was written")


def _check_counts(path: Path, content: mmap.mmap, data: list[Place], summary: tuple[Place, ...]) -> None:
    """Check the number of records against the statistics in the summary; not all data need have a checksum."""
    counts = Counter(place.opcode for place in data)
    for place in summary:
        if place.opcode == Opcode.STATISTICS:
            try:
                statistics = parse(place, content[place.content : place.end])
            except DAMAGE as error:
                raise damage_at(path, place.begin, "statistics that cannot be read") from error
            for opcode, name in _COUNTED.items():
                written, kind = getattr(statistics, name), opcode.name.lower()
                if counts[opcode] != written:
                    what = f"{written} records of kind {kind} written, {counts[opcode]} found"
                    raise damage_at(path, place.begin, what)


def _crc(content: mmap.mmap, begin: int, end: int) -> int:
    """CRC-32 of the bytes from `begin` up to `end`, read in blocks."""
    crc = 0
    for start in range(begin, end, _BLOCK):
        crc = zlib.crc32(content[start : min(start + _BLOCK, end)], crc)
    return crc
