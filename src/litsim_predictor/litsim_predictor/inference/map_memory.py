"""A network's encodings of the maps that it has seen.

On straight roads most maps repeat; in a campaign, those around agents that follow the log repeat in every run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt

from litsim_predictor.forecast import Float32Array
from litsim_sim.core.scene import ByteArray, IntArray
from litsim_sim.kernels.compiled import Ints, Ints2, kernel, read_array, uint64

MOST = 32768
"""Maps that are remembered: 16 MB of codes and fingerprints."""

Words2 = Annotated[npt.NDArray[np.uint64], read_array(uint64, 2)]


@kernel
def first_alike(rows: Ints2) -> Ints:
    """Return for each of the `rows` (n, k) the first row that is equal to it (n,)."""
    count, size = rows.shape
    first, mixed = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        total = 0
        for k in range(size):
            total += rows[i, k] * (2 * k + 1)
        first[i], mixed[i] = i, total  # rows with different sums differ, and nearly always the other way round
        for j in range(i):
            if mixed[j] == total and first[j] == j:
                k = 0
                while k < size and rows[j, k] == rows[i, k]:
                    k += 1
                if k == size:
                    first[i] = j
                    break
    return first


@kernel
def fingerprints(rows: Words2, chosen: Ints) -> Words2:
    """Return 128 bits (m, 2) of each of the `chosen` (m,) of `rows` (n, k), which two different rows do not share.

    They are two sums of 64 bits, in which each word is mixed as in MurmurHash3: of a million rows, two share all 128
    bits with a probability of 1e-27.
    """
    found = np.empty((len(chosen), 2), np.uint64)
    for i in range(len(chosen)):
        one, other = uint64(0x9E3779B97F4A7C15), uint64(0xC2B2AE3D27D4EB4F)
        for k in range(rows.shape[1]):
            word = rows[chosen[i], k]
            one = (one ^ word) * uint64(0xFF51AFD7ED558CCD)
            one ^= one >> uint64(32)
            other = (other + word) * uint64(0xC4CEB9FE1A85EC53)
            other ^= other >> uint64(29)
        found[i, 0], found[i, 1] = one, other
    return found


@dataclass
class MapCodes:
    """The maps of n agents, as far as their codes are known.

    Attributes:
        new: (u, C, H, W) maps whose codes are not known, each once.
        known: (k, width) the codes of the others, each of them once.
        code_of: (n,) int64 the code of each agent, among those known and, after them, those of the new ones.
        keys: (u,) by which the new ones are remembered.
    """

    new: ByteArray
    known: Float32Array
    code_of: IntArray
    keys: tuple[bytes, ...]


class MapMemory:
    """Codes of width `width` by the fingerprint of the map that they are of.

    A code depends on its map alone, to the last bit: whether it is remembered or made anew makes no difference.
    """

    def __init__(self, width: int) -> None:
        self._codes: Float32Array = np.empty((MOST, width), np.float32)
        self._place: dict[bytes, int] = {}  # of each key among the codes, the oldest first
        self._next = 0  # places, of which the oldest is reused once none is free

    def look_up(self, raster: ByteArray) -> MapCodes:
        """Returns the known codes of the maps `raster` (n, C, H, W), and the maps without one."""
        words = raster.reshape(len(raster), -1).view(np.int64)  # eight bytes at a time
        first = first_alike(words)
        alone = (first == np.arange(len(raster))).nonzero()[0]  # the first of their kind
        keys = fingerprints(words.view(np.uint64), alone).view("V16")[:, 0].tolist()
        places = np.array([self._place.get(key, -1) for key in keys], np.int64)
        is_new = places < 0
        if not is_new.any():
            return MapCodes(raster[:0], self._codes[places], alone.searchsorted(first), ())
        order = np.where(is_new, np.count_nonzero(~is_new) + is_new.cumsum(), (~is_new).cumsum()) - 1
        code_of = np.empty(len(raster), np.int64)
        code_of[alone] = order
        new = is_new.nonzero()[0].tolist()
        return MapCodes(raster[alone[new]], self._codes[places[~is_new]], code_of[first], tuple(keys[k] for k in new))

    def keep(self, maps: MapCodes, codes: Float32Array) -> None:
        """Remember the `codes` (u, width) of the new ones of `maps`; of too many, the oldest are forgotten."""
        for key, code in zip(maps.keys, codes, strict=True):
            if len(self._place) == len(self._codes):
                del self._place[next(iter(self._place))]
            self._codes[self._next], self._place[key] = code, self._next
            self._next = (self._next + 1) % len(self._codes)
