"""Serialised messages: reading their stamp, and clearing their padding so that equal messages have equal bytes.

Fast CDR leaves uninitialised memory in the padding between fields. Recorded unchanged, equal runs would give different
files, which would contain parts of the writers' memory.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

from rosidl_parser import definition as idl  # type: ignore[import-untyped]

_HEADER = 4  # bytes of encapsulation; alignment counts from their end
_LITTLE_ENDIAN = b"\x00\x01"  # plain CDR: what every ROS 2 middleware on a PC writes
_SIZES = {
    **dict.fromkeys(("boolean", "octet", "char", "int8", "uint8"), 1),
    **dict.fromkeys(("int16", "uint16"), 2),
    **dict.fromkeys(("int32", "uint32", "float"), 4),
    **dict.fromkeys(("int64", "uint64", "double"), 8),
}

_Walk = Callable[[bytearray, int], int]
"""Function that steps over a value at an offset, clears the padding in it, and returns the offset of its end."""


def stamp_ns(data: bytes) -> int:
    """Returns the stamp [ns] of serialised data that begin with a ``std_msgs/Header``, or of a ``Clock``."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, _HEADER)
    return int(seconds) * 10**9 + int(nanoseconds)


def run_id_of(data: bytes) -> str:
    """Returns the run of serialised data that begin with a ``std_msgs/Header`` and a ``run_id``."""
    _, offset = _text(data, _HEADER + 8)
    run_id, _ = _text(data, offset + (_HEADER - offset) % 4)
    return run_id


def _text(data: bytes, offset: int) -> tuple[str, int]:
    """Returns the string that begins at an offset, and the offset of its end."""
    (length,) = struct.unpack_from("<I", data, offset)
    (text,) = struct.unpack_from(f"<{length}s", data, offset + 4)
    return text.rstrip(b"\0").decode(errors="replace"), offset + 4 + length


def without_padding(message_type: Any) -> Callable[[bytes], bytes]:
    """Returns a function that clears the padding in serialised messages of `message_type`, and removes trailing bytes.

    Data with another encapsulation, or that end too early, are returned unchanged.
    """
    walk = _message(message_type)

    def clear(data: bytes) -> bytes:
        if data[:2] != _LITTLE_ENDIAN:
            return data
        buffer = bytearray(data)
        try:
            end = walk(buffer, _HEADER)
        except struct.error:  # the data end too early
            return data
        if end > len(data):
            return data
        buffer[end:] = bytes(-end % 4)  # DDS sends whole words
        return bytes(buffer)

    return clear


@cache
def _message(message_type: Any) -> _Walk:
    members = [_value(slot) for slot in message_type.SLOT_TYPES]

    def walk(buffer: bytearray, offset: int) -> int:
        for member in members:
            offset = member(buffer, offset)
        return offset

    return walk


def _value(slot: Any) -> _Walk:
    if isinstance(slot, idl.BasicType):
        return _primitives(_SIZES[slot.typename], 1)
    if isinstance(slot, idl.AbstractString):
        return _counted(_primitives(1))
    if isinstance(slot, idl.NamespacedType):
        return _message(getattr(import_module(".".join(slot.namespaces)), slot.name))
    if isinstance(slot, idl.Array):
        return _several(slot.value_type, slot.size)
    if isinstance(slot, idl.AbstractSequence):
        return _counted(_several(slot.value_type))
    raise TypeError(f"no CDR layout for {slot}")


def _several(value_type: Any, count: int = 0) -> Callable[..., int]:
    """Steps over `count` values, or as many as it is told."""
    if isinstance(value_type, idl.BasicType):
        return _primitives(_SIZES[value_type.typename], count)
    skip = _value(value_type)

    def walk(buffer: bytearray, offset: int, count: int = count) -> int:
        for _ in range(count):
            if offset > len(buffer):
                break
            offset = skip(buffer, offset)
        return offset

    return walk


def _primitives(size: int, count: int = 0) -> Callable[..., int]:
    def walk(buffer: bytearray, offset: int, count: int = count) -> int:
        return _align(buffer, offset, size) + size * count if count else offset

    return walk


def _counted(values: Callable[[bytearray, int, int], int]) -> _Walk:
    def walk(buffer: bytearray, offset: int) -> int:
        offset = _align(buffer, offset, 4)
        (count,) = struct.unpack_from("<I", buffer, offset)
        return values(buffer, offset + 4, count)

    return walk


def _align(buffer: bytearray, offset: int, size: int) -> int:
    to = offset + (_HEADER - offset) % size
    if to > offset:
        buffer[offset:to] = bytes(to - offset)
    return to
