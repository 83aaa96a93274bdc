"""Protocol buffers and TFRecord files, decoded without their libraries: fields by number, as they are on the wire."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.io.input_files import open_input

Fields = dict[int, list[int | memoryview]]
"""Values of a message by the number of their field: whole numbers, or the bytes of anything else."""
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # wire types
RECORD_MAX = 2**27  # [B]; Waymo's have some millions


def records(path: Path) -> Iterator[memoryview]:
    """Yields the records of a TFRecord file; its checksums are not checked.

    Raises:
        InputError: the file is no TFRecord file, or ends within a record.
    """
    with open_input(path) as file:
        while head := file.read(12):  # length, and a checksum of it
            length = struct.unpack("<Q", head[:8])[0] if len(head) == 12 else RECORD_MAX + 1
            if length > RECORD_MAX:
                raise InputError(f"{path}: no TFRecord file, or the file ends within a record")
            record = file.read(length + 4)
            if len(record) < length + 4:
                raise InputError(f"{path}: the file ends within a record: was it downloaded whole?")
            yield memoryview(record)[:length]


def fields_of(message: int | memoryview) -> Fields:
    """Returns the fields of a message.

    Raises:
        ValueError: `message` is a number, or no protocol buffer.
    """
    if isinstance(message, int):
        raise ValueError("a number where a message is expected")  # noqa: TRY004 - of a file, not of an argument
    fields: Fields = {}
    offset = 0
    while offset < len(message):
        key, offset = _varint(message, offset)
        kind = key & 7
        value: int | memoryview
        if kind == VARINT:
            value, offset = _varint(message, offset)
        else:
            size = {FIXED64: 8, FIXED32: 4}.get(kind, -1)
            if kind == BYTES:
                size, offset = _varint(message, offset)
            if size < 0 or offset + size > len(message):
                raise ValueError(f"byte {offset}: not a protocol buffer")
            value, offset = message[offset : offset + size], offset + size
        fields.setdefault(key >> 3, []).append(value)
    return fields


def varints(packed: memoryview) -> list[int]:
    """Returns the whole numbers of a packed field."""
    values, offset = [], 0
    while offset < len(packed):
        value, offset = _varint(packed, offset)
        values.append(value)
    return values


def _varint(message: memoryview, offset: int) -> tuple[int, int]:
    """Returns the whole number at a place, and the place after it."""
    value = shift = 0
    while offset < len(message) and shift < 64:
        byte = message[offset]
        value |= (byte & 0x7F) << shift
        offset, shift = offset + 1, shift + 7
        if not byte & 0x80:
            return value, offset
    raise ValueError(f"byte {offset}: not a protocol buffer")
