"""The folder of a recording, before a run begins."""

from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.launch.output import check_output, held_output


def test_a_new_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    check_output(tmp_path / "a/b", overwrite=False)
    assert list((tmp_path / "a/b").iterdir()) == []


def test_a_recording_is_replaced_only_where_that_is_asked_for(tmp_path: Path) -> None:
    bag = tmp_path / "run_0.mcap"
    bag.touch()
    with pytest.raises(InputError, match="holds a recording already"):
        check_output(tmp_path, overwrite=False)
    check_output(tmp_path, overwrite=True)
    assert bag.exists()  # the recorder's to replace


def test_a_folder_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file/run: cannot be written: Not a directory"):
        check_output(tmp_path / "file/run", overwrite=False)


def test_a_name_too_long_for_the_files_of_a_run_is_told(tmp_path: Path) -> None:
    check_output(tmp_path / ("a" * 240), overwrite=False)
    with pytest.raises(InputError, match="aaa: cannot be written: File name too long"):
        check_output(tmp_path / ("a" * 250), overwrite=False)


def test_a_folder_is_held_by_one_run_at_a_time(tmp_path: Path) -> None:
    with held_output(tmp_path):
        with (
            pytest.raises(InputError, match="another run is recorded there; give another folder"),
            held_output(tmp_path),
        ):
            pass
        (tmp_path / "other").mkdir()
        with held_output(tmp_path / "other"):
            pass
    with held_output(tmp_path):
        assert list(tmp_path.iterdir()) == [tmp_path / "other"]
