"""Files that are replaced whole or not at all."""

import os
import threading
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.io.files import refuse_input_as_output, replacing


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
    (tmp_path / "no").write_text("a file where a folder is expected")
    for name, why in (("no/a.txt", "File exists"), ("no/no/a.txt", "Not a directory")):
        with pytest.raises(InputError, match=rf"{name}: cannot be written: {why}"):  # noqa: SIM117
            with replacing(tmp_path / name) as new:
                new.write_text("new")


def test_the_folder_is_made(tmp_path: Path) -> None:
    with replacing(tmp_path / "a/b.txt") as new:
        new.write_text("new")
    assert (tmp_path / "a/b.txt").read_text() == "new"


def test_what_is_no_file_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    with replacing(pipe) as new:
        new.write_text("new")
    reader.join()
    assert read == ["new"]
    assert pipe.is_fifo()
    with pytest.raises(InputError, match="/dev/full: cannot be written: No space left"):
        _written_to_a_device(Path("/dev/full"))


def _written_to_a_device(device: Path) -> None:
    with replacing(device) as new:
        assert new == device  # else a test that fails, run by root, takes the device away
        new.write_text("new")


def test_an_input_is_not_its_own_output(tmp_path: Path) -> None:
    given, other, link = (tmp_path / name for name in ("in.csv", "out.csv", "link.csv"))
    given.write_text("a\n")
    link.symlink_to(given)
    refuse_input_as_output(other, given, tmp_path / "absent")
    for out in (given, link):
        with pytest.raises(InputError, match=rf"{out.name}: is the input .*in.csv itself, expected another file"):
            refuse_input_as_output(out, tmp_path / "absent", given)
