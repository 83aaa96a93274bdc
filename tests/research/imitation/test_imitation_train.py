"""Training of GAIL and RAIL: it runs, goes on where it stopped, and learns what it is rewarded for."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from command_line import refusal
from litsim_research.baselines.imitation_policy import ImitationNetwork
from litsim_research.imitation import train
from litsim_research.imitation.config import ImitationTraining
from litsim_research.imitation.critic import WassersteinConfig, update_wasserstein
from litsim_research.imitation.expert import traffic_pairs
from litsim_research.imitation.network import perceptron
from litsim_research.policies import checkpoint
from litsim_research.policies.data import prepare
from litsim_research.policies.ppo import Demonstrations
from litsim_research.policies.warm_start import WarmStart, clone
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_yaml

CONFIG = Path(__file__).parents[3] / "src" / "litsim_research" / "config"


@pytest.fixture(scope="module")
def file(training_data: dict[str, list[str]], tmp_path_factory: Any) -> Path:
    """A configuration that takes a second."""
    folder = tmp_path_factory.mktemp("imitation")
    values = {
        "iterations": 2,
        "transitions": 60,
        "horizon": 10,
        "together": 2,
        "agents": [2, 4],
        "validate_every": 1,
        "validation_scenes": 1,
        "data": training_data,
        "warm_start": {"epochs": 1},
        "critic": {"updates": 2, "batch": 32},
        "ppo": {"epochs": 2, "batch": 32, "value_first": 0},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(values))
    return folder / "config.yaml"


@pytest.fixture(autouse=True)
def _few_curves(monkeypatch: Any) -> None:
    """A picture takes longer than an iteration: drawn once there are two."""
    draw = checkpoint.plot_curves
    monkeypatch.setattr(checkpoint, "plot_curves", lambda entries, *where: len(entries) > 2 and draw(entries, *where))


def changed(file: Path, **changes: Any) -> ImitationTraining:
    return read_yaml(file, ImitationTraining).model_copy(update=changes)


def weights(training: train.Imitation) -> list[torch.Tensor]:
    return [value for part in (training.policy, training.critic, training.value) for value in part.parameters()]


def test_a_training_that_diverges_ends(file: Path, tmp_path: Path) -> None:
    values = yaml.safe_load(file.read_text())
    values["critic"]["learning_rate"] = 1e30
    (tmp_path / "fast.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(InputError, match=r"field critic.learning_rate is 1e\+30, .*expected a smaller one"):
        train.run(read_yaml(tmp_path / "fast.yaml", ImitationTraining), tmp_path / "out", progress=False)


def test_a_run_that_is_resumed_ends_where_a_whole_one_does(file: Path, tmp_path: Path) -> None:
    config = changed(file, transitions=1)
    whole = train.run(config, tmp_path / "whole", progress=False)
    agents = [entry["agents"] for entry in whole.history[1:]]
    assert agents == [4.0, 8.0], "from stage to stage more are driven: two of each of two scenes, then four"
    iterate = train._iterate

    def interrupted(*arguments: Any) -> dict[str, float]:
        if arguments[-1] == 1:
            raise KeyboardInterrupt
        return iterate(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "_iterate", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train.run(config, tmp_path / "parts", progress=False)
    resumed = train.run(config, tmp_path / "parts", resume=True, progress=False)
    assert all(torch.equal(a, b) for a, b in zip(weights(whole), weights(resumed), strict=True))
    drop = lambda entries: [{k: v for k, v in e.items() if k != "seconds"} for e in entries]  # noqa: E731
    history = json.loads((tmp_path / "parts" / checkpoint.HISTORY).read_text())
    assert drop(history) == drop(whole.history) and len(history) == 3, "the warm start and two iterations"
    assert (tmp_path / "parts" / checkpoint.CURVES).read_bytes().startswith(b"\x89PNG")
    for name in (checkpoint.LAST, checkpoint.BEST):
        ImitationNetwork.load(tmp_path / "parts" / name)


def test_drivers_are_imitated(file: Path, tmp_path: Path) -> None:
    config = changed(file)
    data = prepare(config.data, tmp_path)
    shown = traffic_pairs(data.train, config.drivers, np.random.default_rng(0), data.real).demonstrations(0.5)[1]
    policy = train.Imitation(config, data).policy

    def likelihood() -> float:
        with torch.no_grad():
            return float(policy.log_probability(shown.observation, shown.action).mean())

    before = likelihood()
    clone(policy, shown, WarmStart(epochs=60, batch=8), 0, shown.surprise)
    assert likelihood() > before + 1.0


def test_rail_takes_from_the_reward_what_was_done_wrong(file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    seen: dict[float, list[Any]] = {0.0: [], 5.0: []}
    make = checkpoint.make_batch
    for augmentation, noted in seen.items():

        def batch(tracks: Any, rewards: Any, *rest: Any, noted: list[Any] = noted) -> Any:
            noted.append((tracks, np.concatenate(rewards)))
            return make(tracks, rewards, *rest)

        monkeypatch.setattr(checkpoint, "make_batch", batch)
        train.run(changed(file, iterations=1, augmentation=augmentation), tmp_path / str(augmentation), progress=False)
    ((tracks, plain),), ((_, augmented),) = seen.values()
    fault = -np.concatenate([track.penalty for track in tracks])
    assert plain.mean() == pytest.approx(0.0, abs=1e-6) and plain.std() == pytest.approx(1.0, rel=1e-3)
    assert augmented == pytest.approx(plain - 5.0 * fault)


def test_the_critic_moves_the_sides_apart() -> None:
    torch.manual_seed(0)
    generator, critic = torch.Generator().manual_seed(0), perceptron(8, 0.2)
    optimiser = torch.optim.RMSprop(critic.parameters(), 1e-3)
    recorded = Demonstrations(torch.randn((300, 6), generator=generator) + 1.0, torch.ones(300, 2), torch.ones(300))
    driven = torch.randn((300, 8), generator=generator) - 1.0
    config = WassersteinConfig(updates=30, batch=64)
    distances = [update_wasserstein(critic, optimiser, recorded, driven, config, generator) for _ in range(3)]
    assert distances[-1] > max(distances[0], 1.0) and not critic.training


def test_packaged_configurations_differ_in_the_augmentation_only() -> None:
    plain, augmented = (read_yaml(CONFIG / f"{name}.yaml", ImitationTraining) for name in ("gail", "rail"))
    assert plain.augmentation == 0.0 < augmented.augmentation
    assert augmented.model_copy(update={"augmentation": 0.0}) == plain


def test_what_a_configuration_must_be(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "wrong.yaml").write_text("iterations: 0\ndata: {}\n")
    words = ("--config", tmp_path / "wrong.yaml", "--out", tmp_path)
    assert "field iterations" in refusal(capsys, train.main, *words)
