"""The frame of the programs that train: no training is lost, and what cannot be written is said in one line."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest
import torch
from pydantic import BaseModel

from litsim_policy.learning.checkpoint import CHECKPOINT, keep_state, read_state
from litsim_policy.learning.training_program import training_program
from litsim_sim.core.errors import InputError


class Config(BaseModel):
    """What a training is set to; nothing here."""


def arguments(out: Path, *, resume: bool = False) -> Namespace:
    return Namespace(out=out, resume=resume, threads=torch.get_num_threads())


def test_a_training_that_is_there_already_is_not_begun_anew(tmp_path: Path) -> None:
    (tmp_path / CHECKPOINT).touch()
    with (
        pytest.raises(InputError, match="holds a training already; --resume continues it"),
        training_program(arguments(tmp_path)),
    ):
        pytest.fail("begun")
    with training_program(arguments(tmp_path, resume=True)):
        pass


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(InputError, match=r"file/out: cannot be written"),
        training_program(arguments(tmp_path / "file/out")),
    ):
        pytest.fail("begun")


@pytest.mark.parametrize("kept", [False, True])
def test_an_interrupted_training_names_resume_only_where_there_is_something_to_resume(
    kept: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        if kept:
            (tmp_path / "out" / CHECKPOINT).touch()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), training_program(arguments(tmp_path / "out")):
        interrupted()
    assert ("--resume" in capsys.readouterr().err) == kept


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_full_disk_is_said_and_leaves_the_checkpoint_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    part = torch.nn.Linear(300, 300)
    path = tmp_path / CHECKPOINT
    keep_state(path, Config(), {"part": part}, {"done": 1})
    opened = Path.open
    monkeypatch.setattr(Path, "open", lambda _, *words: opened(Path("/dev/full"), *words))
    with pytest.raises(InputError, match=r"checkpoint\.pt: cannot be written: No space left on device"):
        keep_state(path, Config(), {"part": part}, {"done": 2})
    monkeypatch.undo()
    assert read_state(path, Config(), {"part": part})["done"] == 1
