"""The frame of the programs that train: no training is lost, and what cannot be written is said in one line."""

import resource
import shutil
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from pydantic import BaseModel

from litsim_policy.driving.features.observation import ObservationConfig
from litsim_research.imitation import network as imitation_network
from litsim_research.imitation import simnet_network
from litsim_research.policies import network
from litsim_research.policies.checkpoint import write_history
from litsim_research.policies.data import DataConfig, described, prepare
from litsim_research.policies.training_program import training_program
from litsim_research.predictors.checkpoint import CHECKPOINT, ResumableTraining, save_checkpoint
from litsim_research.predictors.training.curves import PANELS, plot_curves
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import Recording


class Config(BaseModel):
    """What a training is set to."""

    seed: int = 0
    iterations: int = 1


class Small(ResumableTraining):
    """A training of a part, without data unless they are given."""

    parts, more = ("part",), ("done",)

    def __init__(self, data: dict[str, Any] | None = None, **config: int) -> None:
        self.data = data or {}
        self.config, self.part, self.done = Config(**config), torch.nn.Linear(3, 3), 7


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
    said = capsys.readouterr().err
    assert said == ("\ninterrupted; to continue: the same command with --resume\n" if kept else "")


@pytest.mark.parametrize("content", [{"model": {}}, {"config": '{"seed": 0}', "part": {}, "done": 1}, 7])
def test_a_checkpoint_of_another_program_or_version_is_refused(tmp_path: Path, content: object) -> None:
    torch.save(content, tmp_path / CHECKPOINT)
    with pytest.raises(InputError, match=r"checkpoint\.pt: a checkpoint of another program or version: \w+Error: "):
        Small().read(tmp_path / CHECKPOINT)
    older = Small()
    older.more = ()
    older.keep(tmp_path)
    with pytest.raises(InputError, match="another program or version: KeyError: 'done'"):
        Small().read(tmp_path / CHECKPOINT)


def test_what_a_checkpoint_must_be(tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT
    with pytest.raises(InputError, match="no checkpoint"):
        Small().read(path)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a readable checkpoint"):
        Small().read(path)
    first, longer = Small(), Small(iterations=9)
    first.done = 8
    first.keep(tmp_path)
    longer.read(path)
    assert longer.done == 8 and torch.equal(longer.part.weight, first.part.weight)
    with pytest.raises(InputError, match="fields seed of the configuration differ"):
        Small(seed=5).read(path)


# Scenarios that have changed since the training began

CHANGED = [
    (
        "other.parquet",
        r'recording of validation scenario 2, other: "[0-9a-f]{64}", expected "[0-9a-f]{64}"; restore it',
    ),
    ("road.net.xml", 'net of training scenario 1, road: "'),
    ({"ego": 2}, "field ego of training scenario 1, road: 2, expected 1; restore"),
    ({"name": "third"}, 'training scenario 1: "third", expected "road"; restore'),
    ("third.yaml", 'training scenario 2: "third", expected none; restore'),
    ({"description": "Two vehicles."}, None),
    ("moved", None),
]


@pytest.mark.parametrize(("change", "said"), CHANGED)
def test_scenarios_that_are_no_longer_the_same_are_named(
    change: str | dict[str, Any], said: str | None, make_scenario: Any, track: Any, lane_centres: Any, tmp_path: Path
) -> None:
    """They may be moved, and be described otherwise."""
    scenario, folder = (
        make_scenario(*(track(k, x=60.0 + 20.0 * k, y=lane_centres[1], last=45) for k in (1, 2))),
        tmp_path / "data",
    )
    folder.mkdir()
    given = yaml.safe_load(scenario.to_yaml())
    for name in ("road", "third", "other"):
        shutil.copy(given["recording"], folder / f"{name}.parquet")
        shutil.copy(given["net"], folder / f"{name}.net.xml")
        files = {"name": name, "recording": f"{name}.parquet", "net": f"{name}.net.xml"}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(given | files))

    def training(folder: Path, *names: str) -> Small:
        of_parts = {"scenarios": names, "validation": ("other",)}
        files = {part: tuple(str(folder / f"{name}.yaml") for name in names) for part, names in of_parts.items()}
        return Small(described(prepare(DataConfig(**files, real_weight=2), tmp_path)))

    training(folder, "road").keep(tmp_path)
    names = ("road",)
    if change == "moved":
        folder = folder.rename(tmp_path / "moved")
    elif change == "third.yaml":
        names = ("road", "third")
    elif isinstance(change, dict):
        file = folder / "road.yaml"
        file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | change))
    elif change.endswith(".xml"):
        with (folder / change).open("a") as net:
            net.write("<!-- another -->\n")
    else:
        recording = Recording.read(folder / change)
        table = recording.table.assign(speed=recording.table["speed"] + 0.01)
        Recording.from_table(recording.header, table, "made").write(folder / change)
    resumed = training(folder, *names)
    if said is None:
        resumed.read(tmp_path / CHECKPOINT)
    else:
        with pytest.raises(InputError, match=rf"checkpoint\.pt: trained on another {said}"):
            resumed.read(tmp_path / CHECKPOINT)


ENTRIES = [{"validation_score": 0.5}] * 50


@pytest.mark.parametrize(
    "write",
    [
        lambda path: save_checkpoint(path, {"part": torch.nn.Linear(30, 30).state_dict()}),
        lambda path: write_history(ENTRIES, path),
        lambda path: plot_curves(ENTRIES, path.with_suffix(".png"), PANELS),
        lambda path: network.save(network.GaussianPolicy(ObservationConfig()), path),
        lambda path: imitation_network.save(imitation_network.TrafficPolicy(), path, {}),
        lambda path: simnet_network.save(simnet_network.SimNet(), path, {}),
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
