"""Why a run has failed, beside its recording."""

import shutil
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import FAILURE_FILE, make_room
from litsim_sim.record.failure import read_failure, write_failure


@pytest.fixture
def mcap(tmp_path: Path) -> Path:
    path = tmp_path / "run_0.mcap"
    path.touch()
    return path


def test_what_is_left_in_one_line_is_found(mcap: Path) -> None:
    assert read_failure(mcap) == ""
    write_failure(mcap.parent, "the stack ended:\n  planner lost its mind")
    assert read_failure(mcap) == "the stack ended: planner lost its mind"
    assert (mcap.parent / FAILURE_FILE).read_text().count("\n") == 1


def test_of_several_recordings_nobody_knows_which_one_is_meant(mcap: Path) -> None:
    write_failure(mcap.parent, "it broke")
    shutil.copy(mcap, mcap.with_name("other_0.mcap"))
    assert read_failure(mcap) == ""


def test_what_cannot_be_read_is_named(mcap: Path) -> None:
    (mcap.parent / FAILURE_FILE).write_bytes(b"\xff\xfe\xff")
    with pytest.raises(InputError, match=f"{FAILURE_FILE}: cannot be read"):
        read_failure(mcap)


def test_it_goes_with_the_recording(mcap: Path) -> None:
    write_failure(mcap.parent, "it broke")
    with pytest.raises(InputError, match="holds a bag already"):
        make_room(mcap.parent, overwrite=False)
    assert read_failure(mcap) == "it broke"
    make_room(mcap.parent, overwrite=True)
    assert not list(mcap.parent.iterdir())
