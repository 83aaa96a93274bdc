"""Training of SimNet: it learns, it goes on where it stopped, and its weights drive."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from command_line import refusal, status
from litsim_research.baselines.simnet.network import load_network
from litsim_research.imitation import simnet_train
from litsim_research.imitation.simnet_train import SimnetConfig
from litsim_research.policies.checkpoint import CURVES, HISTORY
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_yaml


@pytest.fixture(scope="module")
def file(make_scenario: Any, track: Any, lane_centres: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration that takes a second: two lanes, the left one faster."""
    tracks = [
        track(1 + 3 * lane + k, x=60.0 + 20.0 * k, y=lane_centres[lane], speed=15.0 - 10.0 * lane, last=45)
        for lane in range(2)
        for k in range(3)
    ]
    folder = tmp_path_factory.mktemp("simnet")
    for name in ("scenario", "validation"):
        (folder / f"{name}.yaml").write_text(make_scenario(*tracks).to_yaml())
    values = {
        "batches": 15,
        "moments": 4,
        "agents": 4,
        "validate_every": 5,
        "validation_moments": 8,
        "data": {"scenarios": [str(folder / "scenario.yaml")], "validation": [str(folder / "validation.yaml")]},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(values))
    return folder / "config.yaml"


def test_it_learns_and_a_run_that_is_resumed_ends_where_a_whole_one_does(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = read_yaml(file, SimnetConfig)
    whole = simnet_train.run(config, tmp_path / "whole", progress=False)
    losses = [entry["validation"] for entry in whole.history]
    assert [entry["batches"] for entry in whole.history] == [5, 10, 15]
    assert losses[-1] < losses[0]

    written = simnet_train.SimnetTraining.write

    def interrupted(training: simnet_train.SimnetTraining, out: Path) -> None:
        written(training, out)
        raise KeyboardInterrupt

    monkeypatch.setattr(simnet_train.SimnetTraining, "write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simnet_train.run(config, tmp_path / "parts", progress=False)
    monkeypatch.undo()
    resumed = simnet_train.run(config, tmp_path / "parts", resume=True, progress=False)
    pairs = zip(whole.network.state_dict().values(), resumed.network.state_dict().values(), strict=True)
    assert all(torch.equal(a, b) for a, b in pairs)
    drop = lambda entries: [{k: v for k, v in e.items() if k != "seconds"} for e in entries]  # noqa: E731
    history = json.loads((tmp_path / "parts" / HISTORY).read_text())
    assert drop(history) == drop(whole.history)
    assert (tmp_path / "parts" / CURVES).read_bytes().startswith(b"\x89PNG")
    assert load_network(resumed.weights(tmp_path / "parts"))
    more = simnet_train.run(config.model_copy(update={"batches": 20}), tmp_path / "parts", resume=True, progress=False)
    assert [entry["batches"] for entry in more.history] == [5, 10, 15, 20]


def test_a_training_that_diverges_ends(file: Path, tmp_path: Path) -> None:
    config = read_yaml(file, SimnetConfig).model_copy(update={"learning_rate": 1e30})
    with pytest.raises(InputError, match=r"field learning_rate is 1e\+30, .*expected a smaller one"):
        simnet_train.run(config, tmp_path, progress=False)


def test_the_program(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = yaml.safe_load(file.read_text()) | {"batches": 2}
    scenario, config = yaml.safe_load(Path(values["data"]["scenarios"][0]).read_text()), tmp_path / "short.yaml"
    values["data"]["scenarios"] = [str(tmp_path / "scenario.yaml")]
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    config.write_text(yaml.safe_dump(values))
    words = ("--config", config, "--out", tmp_path / "out")
    assert status(simnet_train.main, *words) == 0
    said = capsys.readouterr().out
    assert said.startswith("best validation loss ") and str(tmp_path / "out" / "best.safetensors") in said
    assert "--device abacus: " in refusal(capsys, simnet_train.main, *words, "--device", "abacus")
    config.write_text(yaml.safe_dump(values | {"learning_rate": 0.5}))
    differs = "fields learning_rate of the configuration differ"
    assert differs in refusal(capsys, simnet_train.main, *words, "--resume")
    config.write_text(yaml.safe_dump(values))
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario | {"seed": 3}))
    differs = "trained on another field seed of training scenario 1, made: 3, expected 0"
    assert differs in refusal(capsys, simnet_train.main, *words, "--resume")


def test_configurations_that_are_wrong(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text("backbone: resnet18\ndata: {}\n")
    with pytest.raises(InputError, match="field backbone"):
        read_yaml(path, SimnetConfig)
