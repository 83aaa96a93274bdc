"""Files that are replaced whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing


def test_the_old_file_stands_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with replacing(path) as new:
        new.write_text("new")
        assert path.read_text() == "old"
        assert new.suffix == path.suffix
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_after_an_error_everything_is_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(ValueError, match="half way"), replacing(path) as new:  # noqa: PT012
        new.write_text("ne")
        raise ValueError("half way")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_the_system_refuses_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no/a\.txt: cannot be written: No such file or directory"):  # noqa: SIM117
        with replacing(tmp_path / "no/a.txt") as new:
            new.write_text("new")
