"""Nets are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from litsim_data.maps import highway
from litsim_sim.core.errors import InputError
from made_roads import us101_like_plan


def test_a_full_disk_leaves_the_net_that_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "road.net.xml"
    highway.write_net(us101_like_plan(), path)
    before = path.read_bytes()

    def half(to: Path, text: str, **_: str) -> None:
        to.write_bytes(text[: len(text) // 2].encode())
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", half)
    with pytest.raises(InputError, match=r"road\.net\.xml: cannot be written: No space left on device"):
        highway.write_net(us101_like_plan(), path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
