"""What a network has made of maps that it has seen: on straight roads, most are the same as some before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_sim.core.compiled import INTS2, OUT_INTS, kernel
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import ByteArray, IntArray

MOST = 4096
"""Maps that are remembered: 10 MB of them."""


@kernel(OUT_INTS(INTS2))
def first_alike(rows: IntArray) -> IntArray:
    """Return for each of the `rows` (n, k) the first row that is equal to it (n,)."""
    count, size = rows.shape
    first, mixed = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        total = 0
        for k in range(size):
            total += rows[i, k] * (2 * k + 1)
        first[i], mixed[i] = i, total  # which differs where rows do, nearly always
        for j in range(i):
            if mixed[j] == total and first[j] == j:
                k = 0
                while k < size and rows[j, k] == rows[i, k]:
                    k += 1
                if k == size:
                    first[i] = j
                    break
    return first


@quickly_made
@dataclass(frozen=True)
class MapCodes:
    """The maps of n agents, as far as their codes are known.

    Attributes:
        new: (u, C, H, W) those whose codes are not known, each of them once.
        known: (k, width) the codes of the others, each of them once.
        code_of: (n,) int64 the code of each agent, among those known and, after them, those of the new ones.
        keys: (u,) by which the new ones are remembered.
    """

    new: ByteArray
    known: Float32Array
    code_of: IntArray
    keys: tuple[bytes, ...]


class MapMemory:
    """Codes of width `width` by the map that they are of.

    A code depends on its map alone, to the last bit: whether it is remembered or made anew makes no difference.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self._codes: dict[bytes, Float32Array] = {}

    def look_up(self, raster: ByteArray) -> MapCodes:
        """What is known of the maps `raster` (n, C, H, W), and what is not."""
        known: list[Float32Array] = []
        keys: list[bytes] = []
        new: list[int] = []
        first = first_alike(raster.reshape(len(raster), -1).view(np.int64))  # eight bytes at a time
        place = np.zeros(len(raster), np.int64)  # of those that are the first of their kind: below 0 where it is new
        for row in (first == np.arange(len(raster))).nonzero()[0].tolist():
            key = raster[row].tobytes()
            code = self._codes.get(key)
            if code is None:
                keys.append(key)
                new.append(row)
                place[row] = -len(keys)  # -1 the first of them
            else:
                place[row] = len(known)
                known.append(code)
        code_of = place[first]
        code_of = np.where(code_of < 0, len(known) - 1 - code_of, code_of)
        codes = np.array(known, np.float32).reshape(-1, self._width)
        return MapCodes(raster[new], codes, code_of, tuple(keys))

    def keep(self, maps: MapCodes, codes: Float32Array) -> None:
        """Remember the `codes` (u, width) of the new ones of `maps`; of too many, the oldest are forgotten."""
        self._codes.update(zip(maps.keys, map(np.copy, codes), strict=True))  # not a part of a larger array
        while len(self._codes) > MOST:
            del self._codes[next(iter(self._codes))]
