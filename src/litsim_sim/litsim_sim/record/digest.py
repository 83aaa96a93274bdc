"""A hash over all decisions of a run: equal for equal runs, independent of wall time."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import numpy.typing as npt

from litsim_sim.core.scene import CONTROL_DTYPES, DTYPES, AgentTable, ControlTable, EgoCommand

VERSION = b"litsim-digest-1\n"


class RunDigest:
    """SHA-256 over agent states, controls and ego commands, fed step by step in ascending order.

    The bytes, all little-endian and without padding, are those of :data:`VERSION`, then for every step:

    - `A`, step uint32, n uint32, then the arrays of :data:`litsim_sim.core.scene.ARRAY_FIELDS` in turn: id int64;
      kind and controller uint8; x, y, yaw, speed, acceleration, yaw_rate, length, width float64;
    - `C`, step uint32, m uint32, then id int64, acceleration, lateral_acceleration, yaw_rate float64, source uint8;
      nothing if the run has no policy (`None`);
    - `E`, step uint32, mode uint8, acceleration float64, yaw_rate float64; nothing without an answer.

    Floats count by their bits: -0.0 and 0.0 differ.
    """

    def __init__(self) -> None:
        self._hash = hashlib.sha256(VERSION)

    def update(self, table: AgentTable, controls: ControlTable | None, ego: EgoCommand | None) -> None:
        """Add one step and the answers to it."""
        parts = [struct.pack("<cII", b"A", table.step, len(table))]
        parts += [_bytes(getattr(table, field), dtype) for field, dtype in _TABLE_TYPES.items()]
        if controls is not None:
            parts.append(struct.pack("<cII", b"C", controls.step, len(controls.id)))
            parts += [_bytes(getattr(controls, field), dtype) for field, dtype in _CONTROL_TYPES.items()]
        if ego is not None:
            parts.append(struct.pack("<cIBdd", b"E", ego.step, int(ego.mode), ego.acceleration, ego.yaw_rate))
        self._hash.update(b"".join(parts))

    def hexdigest(self) -> str:
        """64 hexadecimal digits over the steps so far."""
        return self._hash.hexdigest()


def _bytes(values: npt.NDArray[np.generic], dtype: np.dtype[np.generic]) -> bytes:
    return values.astype(dtype, copy=False).tobytes()


_TABLE_TYPES, _CONTROL_TYPES = (
    {field: np.dtype(dtype).newbyteorder("<") for field, dtype in types.items()} for types in (DTYPES, CONTROL_DTYPES)
)
