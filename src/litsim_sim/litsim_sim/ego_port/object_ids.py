"""UUIDs of agents, by which other software knows them as objects: eight fixed bytes, and the id in the recording."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import ByteArray, IntArray

NAMESPACE = b"litsim\0\0"


def uuids_of(ids: IntArray) -> ByteArray:
    """Returns the UUIDs (n, 16) of the agents `ids` (n,)."""
    uuids = np.empty((len(ids), 16), np.uint8)
    uuids[:, :8] = np.frombuffer(NAMESPACE, np.uint8)
    uuids[:, 8:] = ids.astype("<i8").view(np.uint8).reshape(-1, 8)
    return uuids


def agent_of(uuid: bytes) -> int | None:
    """Returns the id of the agent with `uuid`; None for an object that is none of LitSim's."""
    return int.from_bytes(uuid[8:], "little", signed=True) if uuid.startswith(NAMESPACE) else None
