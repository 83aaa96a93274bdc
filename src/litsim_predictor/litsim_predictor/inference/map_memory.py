"""What a network has made of maps that it has seen: on straight roads, most are the same as some before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_sim.core.scene import ByteArray, IntArray

MOST = 4096
"""Maps that are remembered: 10 MB of them."""


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
        place: dict[bytes, int] = {}  # below 0 where it is new: -1 the first of them
        keys: list[bytes] = []
        first: list[int] = []
        code_of = np.empty(len(raster), np.int64)
        for row, each in enumerate(raster):
            key = each.tobytes()
            at = place.get(key)
            if at is None:
                code = self._codes.get(key)
                if code is None:
                    keys.append(key)
                    first.append(row)
                    at = -len(keys)
                else:
                    at = len(known)
                    known.append(code)
                place[key] = at
            code_of[row] = at
        new = code_of < 0
        code_of[new] = len(known) - 1 - code_of[new]
        codes = np.array(known, np.float32).reshape(-1, self._width)
        return MapCodes(raster[first], codes, code_of, tuple(keys))

    def keep(self, maps: MapCodes, codes: Float32Array) -> None:
        """Remember the `codes` (u, width) of the new ones of `maps`; of too many, the oldest are forgotten."""
        self._codes.update(zip(maps.keys, map(np.copy, codes), strict=True))  # not a part of a larger array
        while len(self._codes) > MOST:
            del self._codes[next(iter(self._codes))]
