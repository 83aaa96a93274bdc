"""The frame of the programs that train: no training is lost, and what cannot be written is said in one line."""

from __future__ import annotations

import resource
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from pydantic import BaseModel

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.learning import network, simnet_network
from litsim_policy.learning.checkpoint import CHECKPOINT, keep_state, read_state, write_history
from litsim_policy.learning.imitation import network as imitation_network
from litsim_policy.learning.plots import plot_curves
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


@pytest.mark.parametrize("content", [{"model": {}}, {"config": "{}", "part": {}, "done": 1}, 7])
def test_a_checkpoint_of_another_program_or_version_is_refused(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / CHECKPOINT)
    with pytest.raises(InputError, match=r"checkpoint\.pt: a checkpoint of another program or version: \w+Error: "):
        read_state(tmp_path / CHECKPOINT, Config(), {"part": torch.nn.Linear(3, 3)}, ["done"])
    part = torch.nn.Linear(3, 3)
    keep_state(tmp_path / CHECKPOINT, Config(), {"part": part}, {})
    with pytest.raises(InputError, match="another program or version: KeyError: 'done'"):
        read_state(tmp_path / CHECKPOINT, Config(), {"part": part}, ["done"])


ENTRIES = [{"validation_score": 0.5}] * 50


@pytest.mark.parametrize(
    "write",
    [
        lambda path: keep_state(path, Config(), {"part": torch.nn.Linear(30, 30)}, {}),
        lambda path: write_history(ENTRIES, path),
        lambda path: plot_curves(ENTRIES, path.with_suffix(".png")),
        lambda path: network.save(network.GaussianPolicy(ObservationConfig()), path),
        lambda path: imitation_network.save(imitation_network.TrafficPolicy(), path, {}),
        lambda path: simnet_network.save(simnet_network.SimNet("small"), path, {}),
    ],
    ids=["checkpoint", "history", "curves", "policy C", "imitation", "simnet"],
)
def test_what_cannot_be_written_whole_leaves_what_was_there(write: Callable[[Path], None], tmp_path: Path) -> None:
    for name in ("made.file", "made.png"):
        (tmp_path / name).write_text("before")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
    try:
        with pytest.raises(InputError, match=r"made\.(file|png): cannot be written: File too large"):
            write(tmp_path / "made.file")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"made.file": "before", "made.png": "before"}
