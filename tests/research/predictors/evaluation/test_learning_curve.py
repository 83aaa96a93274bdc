"""Learning curves from the metadata of weights: seeds are averaged, other differences are refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from litsim_research.cli.score import main
from litsim_research.predictors.evaluation.learning_curve import learning_curves
from litsim_research.predictors.models.registry import build
from litsim_research.predictors.models.weights import Provenance, save_model
from litsim_sim.core.errors import InputError


@pytest.fixture
def trained(tmp_path: Path) -> Any:
    """Writes weights whose metadata tell of a training with `fraction` and `seed` that came to `error` and `nll`."""
    model = build("cs_lstm", {}, "test")

    def write(fraction: float, error: float, nll: float, *, seed: int = 0, config: str = "small", **other: Any) -> Path:
        path = tmp_path / f"{config}_{fraction}_{seed}.safetensors"
        command = f"ros2 run litsim_research train predictor --config {config} --fraction {fraction} --out there"
        training = {"model": "cs_lstm", "epochs": 3, "fraction": fraction, "seed": seed} | other
        figures = {"val_error": error, "val_nll": nll}
        save_model(model, Provenance("cs_lstm", {}, command, training, {}, figures), path)
        return path

    return write


def test_curves_are_by_configuration_and_share_and_seeds_are_averaged(trained: Any) -> None:
    files = [trained(1.0, 2.0, 0.1), trained(0.5, 2.4, 0.3), trained(0.5, 2.6, 0.5, seed=1)]
    files.append(trained(1.0, 3.0, 1.0, config="mine.yaml"))
    found = learning_curves(files)
    assert list(found) == ["small", "mine"] and list(found["small"]) == [0.5, 1.0]
    assert found["small"][0.5] == pytest.approx({"val_error": 2.5, "val_nll": 0.4})
    assert found["mine"] == {1.0: {"val_error": 3.0, "val_nll": 1.0}}


def test_trainings_that_differ_in_more_are_refused(trained: Any) -> None:
    files = [trained(1.0, 2.0, 0.1), trained(0.5, 2.4, 0.3, epochs=9)]
    with pytest.raises(InputError, match=r"small_0\.5_0\.safetensors: field epochs of its training is 9, expected 3"):
        learning_curves(files)


def test_weights_of_no_training_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "untrained.safetensors"
    save_model(build("cs_lstm", {}, "test"), Provenance("cs_lstm", {}, "", {}, {}, {}), path)
    with pytest.raises(InputError, match=r"untrained\.safetensors: its metadata tell of no training"):
        learning_curves([path])


def test_the_command_draws_and_prints_them(
    trained: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [trained(0.25, 2.75, 0.3), trained(1.0, 2.125, 0.1)]
    picture = tmp_path / "curve.png"
    monkeypatch.setattr(sys, "argv", ["evaluate", "--learning-curve", str(picture), "--models", *map(str, files)])
    main()
    assert picture.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert all(number in printed for number in ("25", "2.750", "2.125"))


@pytest.mark.parametrize(
    ("words", "named"), [([], "--learning-curve: expected --models FILE"), (["--models", "gone.safetensors"], "gone")]
)
def test_what_cannot_be_drawn_ends_the_program(
    words: list[str], named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["evaluate", "--learning-curve", str(tmp_path / "curve.png"), *words])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2 and named in capsys.readouterr().err
