"""Nets are written whole or not at all."""

from pathlib import Path

import numpy as np
import pytest

from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around
from litsim_data.maps.net_builder import write_graph
from litsim_sim.core.errors import InputError


def test_a_full_disk_leaves_the_net_that_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    road = LaneGraph((Lanelet("a", *around(np.array([[0.0, 0.0], [640.0, 0.0]]))),))
    path = tmp_path / "road.net.xml"
    write_graph(road, path)
    before = path.read_bytes()

    def half(to: Path, text: str, **_: str) -> None:
        to.write_bytes(text[: len(text) // 2].encode())
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(InputError, match=r"road\.net\.xml: cannot be written: No space left on device"):
        write_graph(road, path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
