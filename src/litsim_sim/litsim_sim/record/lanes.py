"""The lanes of a run, from the SUMO net attached to its bag."""

from __future__ import annotations

import tempfile
from functools import lru_cache
from pathlib import Path

from litsim_sim.core.errors import InputError
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.run import NET_FILE, Run


def lane_map_of(run: Run) -> LaneMap | None:
    """Returns the lanes of the attached net; None without a net. Raises InputError if it is none."""
    try:
        return _read(run.net_xml) if run.net_xml else None
    except InputError as error:
        raise InputError(f"{run.path}: attachment {NET_FILE}: {error}") from error


@lru_cache(maxsize=2)
def _read(net_xml: bytes) -> LaneMap:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / NET_FILE
        path.write_bytes(net_xml)
        return LaneMap.from_net(path)
