"""Training: equal seeds give equal weights, an interrupted one goes on where it stopped, bad input is named."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from torch.optim.swa_utils import AveragedModel

from command_line import refusal, status
from litsim_research.cli import score as evaluate
from litsim_research.cli import train_predictor as train
from litsim_research.predictors.checkpoint import CHECKPOINT
from litsim_research.predictors.data.scenes import scene_batches
from litsim_research.predictors.evaluation.evaluation import recording_tracks
from litsim_research.predictors.models.registry import build
from litsim_research.predictors.models.weights import Provenance, load_model, save_model
from litsim_research.predictors.training import data as training_data
from litsim_research.predictors.training.config import TrainingConfig
from litsim_research.predictors.training.data import Locator, load_parts
from litsim_research.predictors.training.training import CURVES, HISTORY_FILE, VALIDATION_STRIDE, WEIGHTS, Training
from litsim_sim.core.errors import EXIT_INTERRUPTED, InputError
from litsim_sim.core.scene import Kind
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import packaged

Straight = Callable[..., pd.DataFrame]
SMALL = """
model: joint
parameters: {map_width: 8, map_channels: 4, history_width: 8, state_width: 8, heads: 4, layers: 1, hidden: 16}
data:
- {kind: recording, files: [made.parquet]}
epochs: 2
warm_epochs: 1
stride: 10
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, straight: Straight) -> Path:
    """A training configuration beside a recording of ten vehicles on the net us101_like, and what it leaves in `a`."""
    folder, rng = tmp_path_factory.mktemp("trained"), np.random.default_rng(0)
    vehicles = [(k, 20.0 * k, -3.66 * (k % 5 + 0.5), float(rng.uniform(8, 14))) for k in range(10)]
    table = straight(*vehicles, frames=110).assign(acceleration=0.0, kind=int(Kind.CAR), lane=1)
    Recording.from_table(RecordingHeader("made", net="us101_like.net.xml"), table, "made").write(
        folder / "made.parquet"
    )
    (folder / "small.yaml").write_text(SMALL)
    run(folder / "small.yaml", folder / "a")
    return folder


@pytest.fixture
def config(tmp_path: Path, trained: Path) -> Path:
    """The configuration in a folder of this test's own, with the recording, and what was trained in `a`."""
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    return tmp_path / "small.yaml"


def words(config: Path, out: Path, *options: str) -> tuple[str, ...]:
    return ("--config", str(config), "--out", str(out), "--threads", "1", "--device", "cpu", *options)


def run(config: Path, out: Path, *options: str) -> None:
    assert status(train.main, *words(config, out, *options)) == 0


def same(first: Path, second: Path) -> bool:
    one, other = (load_model(str(folder / WEIGHTS))[0].state_dict() for folder in (first, second))
    return all(torch.equal(one[name], other[name]) for name in one)


def test_a_training_leaves_weights_curves_and_history(trained: Path) -> None:
    model, made = load_model(str(trained / "a" / WEIGHTS))
    assert not model.training
    assert made.command.startswith("ros2 run litsim_research train predictor --config small.yaml")
    assert made.manifest["rows"]["train"]["made"] == 7 * 110
    assert list(made.manifest["files"]) == ["made.parquet"] and len(made.manifest["files"]["made.parquet"]) == 64
    assert made.figures["val_rmse_5"] > made.figures["val_rmse_1"] > 0
    history = json.loads((trained / "a" / HISTORY_FILE).read_text())
    assert [entry["epoch"] for entry in history["epochs"]] == [1, 2]
    assert (trained / "a" / CURVES).read_bytes().startswith(b"\x89PNG")


def test_the_net_of_a_recording_may_lie_beside_it(config: Path, tmp_path: Path) -> None:
    table = Recording.read(tmp_path / "made.parquet").table
    Recording.from_table(RecordingHeader("made", net="street"), table, "made").write(tmp_path / "made.parquet")
    with pytest.raises(InputError, match=r"made.parquet: no net .*street: expected a file there"):
        load_parts(read_yaml(config, TrainingConfig), Locator(tmp_path))
    (tmp_path / "street.net.xml").write_bytes(packaged("nets/us101_like.net.xml").read_bytes())
    tracks, _ = load_parts(read_yaml(config, TrainingConfig), Locator(tmp_path))["train"][0]
    assert tracks.lanes is not None
    assert recording_tracks(tmp_path / "made.parquet", None).lanes is not None


def test_what_validates_a_training_is_what_evaluate_measures(trained: Path) -> None:
    file = str(trained / "a" / WEIGHTS)
    asked = ["--validation", str(trained / "small.yaml"), "--stride", str(VALIDATION_STRIDE), "--models", file]
    measured = evaluate.evaluate(evaluate.parser().parse_args(asked))[file]
    recorded = load_model(file)[1].figures
    assert measured["rmse"] == pytest.approx({s: recorded[f"val_rmse_{s}"] for s in measured["rmse"]}, rel=1e-4)
    assert measured["protocol"]["split"] == "val"


def test_equal_seeds_give_equal_weights_and_resuming_changes_nothing(config: Path, tmp_path: Path) -> None:
    """One that was interrupted after the first epoch ends where another one does that was not."""
    config.write_text(SMALL + "averaging: 0.5\n")
    whole_run, cut = tmp_path / "whole", tmp_path / "cut"
    run(config, whole_run)
    whole = torch.load(whole_run / CHECKPOINT, weights_only=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("litsim_research.predictors.training.training.Training._learning_rate", interrupt_at(1))
        assert status(train.main, *words(config, cut)) == EXIT_INTERRUPTED
    assert len(json.loads((cut / HISTORY_FILE).read_text())["epochs"]) == 1
    run(config, cut, "--resume")
    resumed = torch.load(cut / CHECKPOINT, weights_only=True)
    assert all(torch.equal(whole["model"][name], resumed["model"][name]) for name in whole["model"])
    assert same(whole_run, cut)


def test_the_number_of_workers_that_make_batches_changes_nothing(config: Path, tmp_path: Path) -> None:
    settings = read_yaml(config, TrainingConfig).model_copy(update={"agents_per_batch": 20})
    trainings = []
    for workers in (0, 2):
        (tmp_path / str(workers)).mkdir()
        training = Training(settings, tmp_path / str(workers), Locator(tmp_path), "", "cpu", workers)
        training.run()
        trainings.append(training)
    assert trainings[0].history == trainings[1].history
    assert same(tmp_path / "0", tmp_path / "2")


def test_averaged_weights_lag_behind_those_that_are_trained(config: Path, tmp_path: Path) -> None:
    """What is saved is the average, by its share, of all weights that there were after a step."""
    share, steps = 0.8, []
    update = AveragedModel.update_parameters

    def seen(averaged: AveragedModel, model: torch.nn.Module) -> None:
        steps.append({name: value.clone() for name, value in model.state_dict().items()})
        update(averaged, model)

    config.write_text(SMALL + f"agents_per_batch: 20\naveraging: {share}\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(AveragedModel, "update_parameters", seen)
        run(config, tmp_path / "averaged", "--epochs", "1")
    assert len(steps) > 2
    saved = load_model(str(tmp_path / "averaged" / WEIGHTS))[0].state_dict()
    for name, value in saved.items():
        average = steps[0][name]
        for step in steps[1:]:
            average = share * average + (1.0 - share) * step[name]
        torch.testing.assert_close(value, average)
    assert not all(torch.equal(saved[name], steps[-1][name]) for name in saved)


def test_a_fraction_of_the_vehicles_makes_epochs_of_as_many_steps(config: Path, tmp_path: Path) -> None:
    config.write_text(SMALL + "agents_per_batch: 20\n")
    steps: list[int] = []
    step = torch.optim.AdamW.step

    def counted(optimiser: torch.optim.AdamW) -> None:
        steps[-1] += 1
        step(optimiser)

    for name, options in (("all", ("--epochs", "1")), ("few", ("--epochs", "1", "--fraction", "0.3"))):
        steps.append(0)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(torch.optim.AdamW, "step", counted)
            run(config, tmp_path / name, *options)
    assert steps[0] == steps[1] > 2
    made = load_model(str(tmp_path / "few" / WEIGHTS))[1]
    assert made.manifest["rows"]["train"]["made"] == 2 * 110
    assert made.training["fraction"] == 0.3 and "--fraction 0.3" in made.command


def test_of_a_source_that_nobody_is_learned_of_no_fraction_is_taken(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = training_data.load

    def seen_only(*given: Any) -> Any:
        parts = real(*given)
        (tracks,) = parts["train"]
        return parts | {"train": [tracks, replace(tracks, target=np.zeros(len(tracks), np.bool_))]}

    monkeypatch.setattr(training_data, "load", seen_only)
    some = read_yaml(config, TrainingConfig).model_copy(update={"fraction": 0.3})
    learned, seen = load_parts(some, Locator(config.parent))["train"]
    assert learned[0].target.sum() == 2 * 110
    assert not seen[0].target.any() and seen[1] == some.data[0].share


def test_a_training_begins_with_other_weights_of_the_same_model(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begun = load_model(str(tmp_path / "a" / WEIGHTS))[0].state_dict()
    # Steps so small that they leave the weights where they begin.
    further = SMALL + "start: a/weights.safetensors\nlearning_rate: 1.0e-12\n"
    config.write_text(further)
    run(config, tmp_path / "second", "--epochs", "1")
    model, made = load_model(str(tmp_path / "second" / WEIGHTS))
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, begun[name], atol=1e-9, rtol=0.0)
    assert set(made.manifest["files"]) == {"made.parquet", "a/weights.safetensors"}
    config.write_text(further.replace("hidden: 16", "hidden: 8"))
    said = refusal(capsys, train.main, *words(config, tmp_path / "third"))
    assert "a/weights.safetensors: weights of model joint" in said


def test_a_training_with_teachers_learns_from_the_mean_of_their_forecasts(config: Path, tmp_path: Path) -> None:
    """The further loss is the squared distance from it; with nothing to compare it is zero, and it moves the model."""
    run(config, tmp_path / "other", "--seed", "1", "--epochs", "1")
    names = [f"{folder}/weights.safetensors" for folder in ("a", "other")]
    config.write_text(f"{SMALL}teachers: {names}\nteacher_weight: 10\n".replace("'", ""))
    settings, locate = read_yaml(config, TrainingConfig), Locator(tmp_path)
    training = Training(settings, tmp_path, locate, "", "cpu")
    batch = next(scene_batches([tracks for tracks, _ in load_parts(settings, locate)["val"]]))
    with torch.no_grad():
        one, other = (load_model(str(tmp_path / name))[0](batch).mean[:, :, 0] for name in names)
        wanted = (one + other) / 2
        assert (one - other)[batch.target].abs().max() > 0.01
        assert training._distillation(batch, wanted, batch.target) == pytest.approx(0.0, abs=1e-9)
        beside = wanted + torch.tensor([3.0, 4.0])
        assert training._distillation(batch, beside, batch.target) == pytest.approx(25.0, abs=1e-3)
        assert training._distillation(batch, beside, torch.zeros_like(batch.target)) == 0.0
    run(config, tmp_path / "taught")
    assert set(names) < set(load_model(str(tmp_path / "taught" / WEIGHTS))[1].manifest["files"])
    assert not same(tmp_path / "taught", tmp_path / "a")


@pytest.mark.parametrize(("every", "rates"), [(2, [0.01, 0.01, 1e-3, 1e-3, 1e-4]), (0, [0.01, 9.0e-3, 6.5e-3])])
def test_the_learning_rate_falls_in_steps_or_along_a_cosine(every: int, rates: list[float]) -> None:
    training = Training.__new__(Training)
    config = {"model": "joint", "learning_rate": 0.01, "divided_every": every, "epochs": 5}
    training.config = TrainingConfig.model_validate(config)
    assert [training._learning_rate(epoch) for epoch in range(len(rates))] == pytest.approx(rates, rel=0.01)


def interrupt_at(epoch: int) -> Callable[..., float]:
    """A learning rate that is interrupted, as by Ctrl-C, when it is asked for at `epoch`."""
    rate = Training._learning_rate

    def interrupted(self: Training, now: int) -> float:
        if now == epoch:
            raise KeyboardInterrupt
        return rate(self, now)

    return interrupted


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("model: joint\nepochs: 0\n", "small.yaml: line 2, field epochs"),
        ("model: joint\nlearning: 1\n", "small.yaml: line 2, field learning"),
        ("model: [\n", "small.yaml: malformed YAML"),
        ("model: rnn\n", "field model is 'rnn', expected one of joint, cs_lstm, bat"),
        ("model: joint\nparameters: {width: 8}\n", "training configuration: field parameters: width is unknown"),
        ("model: joint\nparameters: {neighbours: -1}\n", "neighbours is -1, expected a whole number of at least 0"),
        ("model: joint\nparameters: {heads: 7}\n", "heads is 7, expected a divisor of 160"),
        ("model: joint\nparameters: {attention: states, heads: 5}\n", "heads is 5, expected a divisor of 32"),
        ("model: joint\nparameters: {attention: states, traffic: true}\n", "traffic is True, expected False"),
        ("model: joint\nparameters: {history_width: 33, heads: 1}\n", "history_width is 33, expected an even number"),
        ("model: bat\nparameters: {heads: 5}\n", "embedding is 32, expected an even multiple of heads, 5"),
        ("model: cs_lstm\nparameters: {encoder: 0}\n", "encoder is 0, expected a whole number of more than 0"),
        ("model: joint\nparameters: {history: dense}\n", "history is 'dense', expected one of direct, recurrent"),
        ("model: joint\nparameters: {decoder: gru}\n", "decoder is 'gru', expected one of direct, recurrent"),
        ("model: joint\nparameters: {attention: all}\n", "attention is 'all', expected one of codes, states"),
        ("model: joint\nparameters: {hidden: 33, decoder: recurrent}\n", "hidden is 33, expected an even number"),
        ("model: joint\nparameters: {hidden: 1025}\n", "hidden is 1025, expected a whole number of more than 0 and at"),
        ("model: joint\nparameters: {layers: 1000000}\n", "layers is 1000000, expected a whole number of more than"),
        (f"model: joint\nparameters: {{neighbours: {10**30}}}\n", "a whole number of at least 0 and at most 1"),
        ("model: joint\nparameters: {reach: 1.0e+300}\n", "reach is 1e+300, expected a number of more than 0"),
        ("model: bat\nparameters: {embedding: 1000000}\n", "embedding is 1000000, expected a whole number"),
        (f"model: joint\nepochs: {10**400}\n", "small.yaml: line 2, field epochs"),
        ("model: joint\nseed: -1\n", "small.yaml: line 2, field seed"),
        (f"model: joint\nseed: {2**64}\n", "small.yaml: line 2, field seed"),
        ("model: joint\nstride: 36001\n", "small.yaml: line 2, field stride"),
        (SMALL.replace("[made.parquet]}", "[made.parquet], share: 1.0e+12}"), "small.yaml: line 5, field data.0"),
        ("model: joint\nlearning_rate: 1.0e+300\n", "small.yaml: line 2, field learning_rate"),
        ("model: joint\nlearning_rate: .inf\n", "small.yaml: line 2, field learning_rate"),
        ("model: joint\naugmentation: {mirror: 7.0}\n", "field augmentation.mirror"),
        ("model: joint\naugmentation: {crop_m: [80, 20]}\n", "crop_m is [80.0, 20.0], expected the least value first"),
        (SMALL + "learning_rate: 1.0e+30\n", "field learning_rate is 1e+30, with which the likelihood is not finite"),
        (SMALL.replace("made.parquet", "gone.parquet"), "gone.parquet: no such file"),
    ],
)
def test_bad_configurations_are_named(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, named: str
) -> None:
    config.write_text(text)
    assert named in refusal(capsys, train.main, *words(config, tmp_path / "out"))


@pytest.mark.parametrize(
    ("option", "value", "named"),
    [
        ("--epochs", "0", "error: command line: field epochs"),
        ("--fraction", "0", "error: command line: field fraction"),
        ("--device", "abacus", "error: --device abacus"),
        ("--threads", "-1", "argument --threads: '-1', expected a whole number of at least 1"),
    ],
)
def test_wrong_options_are_named(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str, named: str
) -> None:
    assert named in refusal(capsys, train.main, *words(config, tmp_path / "out", option, value))


def test_a_training_is_not_overwritten_and_another_one_not_resumed(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, named in (
        ((), "--resume continues it"),
        (("--resume", "--seed", "5"), "fields seed of the configuration differ"),
    ):
        assert named in refusal(capsys, train.main, *words(config, tmp_path / "a", *options))


def test_a_training_is_not_resumed_on_other_data(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = Recording.read(tmp_path / "made.parquet").table
    Recording.from_table(RecordingHeader("made"), table[table["vehicle_id"] != 3], "made").write(
        tmp_path / "made.parquet"
    )
    said = refusal(capsys, train.main, *words(config, tmp_path / "a", "--resume"))
    assert f"{CHECKPOINT}: trained on another made.parquet: " in said


@pytest.mark.parametrize("name", sorted(train.packaged_configs()))
def test_packaged_configurations_are_whole(name: str) -> None:
    config = read_yaml(train.packaged_configs()[name], TrainingConfig)
    build(config.model, config.parameters, name)


PARAMETERS = {"map_width": 8, "map_channels": 4, "history_width": 8, "state_width": 8, "heads": 4, "hidden": 16}


def test_weights_come_back_as_they_were_and_those_of_another_model_are_named(tmp_path: Path) -> None:
    def saved(parameters: dict[str, int]) -> Provenance:
        made = Provenance("joint", parameters, command="", training={}, manifest={}, figures={})
        save_model(model, made, tmp_path / "w.safetensors")
        return made

    model = build("joint", PARAMETERS, "test")
    made = saved(PARAMETERS)
    again, told = load_model(str(tmp_path / "w.safetensors"))
    assert told == made
    ours, theirs = model.state_dict(), again.state_dict()
    assert ours.keys() == theirs.keys() and all(torch.equal(ours[name], theirs[name]) for name in ours)
    for other, said in (({"hidden": 32}, "have shape"), ({"layers": 1}, "of no layer")):
        saved(PARAMETERS | other)
        with pytest.raises(InputError, match=said):
            load_model(str(tmp_path / "w.safetensors"))
    data = (tmp_path / "w.safetensors").read_bytes()
    (tmp_path / "w.safetensors").write_bytes(data.replace(b"litsim_predictor/1", b"litsim_predictor/7"))
    with pytest.raises(InputError, match=r"w\.safetensors: metadata format"):
        load_model(str(tmp_path / "w.safetensors"))
    with pytest.raises(InputError, match="no such weights; shipped are default, paper"):
        load_model("gone.safetensors")
