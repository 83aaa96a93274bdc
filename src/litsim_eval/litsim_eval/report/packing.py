"""Compression of arrays for embedding in an HTML page; `assets/container.js` is the reader.

The container is gzip over: the length of the header (uint32, little endian), the header (JSON, padded with spaces to a
multiple of 4 bytes), and the arrays, each padded to a multiple of 4 bytes. Values are rounded to a resolution and
differenced along the last axis, which turns smooth motion into small integers that compress well.
"""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np
import numpy.typing as npt

ALIGNMENT = 4
LEVEL = 6  # level of compression: 9 takes eight times as long for 3 % less
WHOLE = np.int32
NARROWEST_FIRST = (np.int8, np.int16, WHOLE)


class Packer:
    """Collects a tree of plain values and named arrays, and packs them into one text."""

    def __init__(self, content: dict[str, Any]) -> None:
        self._content = content
        self._described: list[dict[str, Any]] = []
        self._data: list[bytes] = []
        self._size = 0

    def add(self, name: str, values: npt.ArrayLike, resolution: float = 1.0, differences: int = 0) -> None:
        """Adds an array of any shape.

        Args:
            name: under which the page finds it.
            values: finite numbers; those beyond what 32 bits hold at this resolution are clipped.
            resolution: what values are rounded to.
            differences: how often neighbours along the last axis are subtracted; 2 suits positions, 1 other motion.
        """
        array = np.asarray(values, np.float64)
        limit = np.iinfo(WHOLE)
        whole = np.clip(np.round(array / resolution), limit.min, limit.max).astype(np.int64)
        for _ in range(differences):
            whole = np.diff(whole, axis=-1, prepend=0)
        low, high = (int(whole.min()), int(whole.max())) if whole.size else (0, 0)
        fits = (kind for kind in NARROWEST_FIRST if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max)
        kind = np.dtype(next(fits, WHOLE))  # differences that overflow wrap around, and their sums wrap back
        data = whole.astype(kind.newbyteorder("<")).tobytes()
        described = {"name": name, "kind": kind.name, "shape": list(array.shape), "offset": self._size}
        self._described.append(described | {"resolution": resolution, "differences": differences})
        self._data.append(data + b"\0" * (-len(data) % ALIGNMENT))
        self._size += len(self._data[-1])

    def pack(self) -> str:
        """Returns the container with everything added, in base64."""
        tree = {**self._content, "arrays": self._described}
        header = json.dumps(tree, allow_nan=False, separators=(",", ":")).encode()
        header += b" " * (-len(header) % ALIGNMENT)
        whole = b"".join([len(header).to_bytes(4, "little"), header, *self._data])
        return base64.b64encode(gzip.compress(whole, LEVEL, mtime=0)).decode()
