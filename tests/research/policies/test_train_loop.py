"""The loop of the training: what it rewards, what it keeps, and that it can be interrupted anywhere."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open

from litsim_research.policies import checkpoint, train
from litsim_research.policies.config import TrainConfig
from litsim_research.policies.critic import Critic
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import tensor
from litsim_research.predictors.checkpoint import CHECKPOINT


@pytest.fixture(scope="module")
def config(training_data) -> TrainConfig:
    """A training that takes a second."""
    values = {
        "iterations": 3,
        "transitions": 30,
        "validate_every": 1,
        "validation_episodes": 1,
        "data": training_data,
        "environment": {"steps_max": 15, "slots": 4, "sampled": 3},
        "warm_start": {"epochs": 1},
        "critic": {"updates": 2, "batch": 16},
        "ppo": {"epochs": 1, "batch": 16, "value_first": 1},
    }
    return TrainConfig(**values)


def weights(training: checkpoint.Training) -> list[torch.Tensor]:
    return [value for part in (training.policy, training.critic, training.value) for value in part.parameters()]


def count(config: TrainConfig, iterations: int, **changes: Any) -> TrainConfig:
    return config.model_copy(update={"iterations": iterations, **changes})


@pytest.fixture(autouse=True)
def _no_curves(monkeypatch) -> None:
    """They take longer than the rest."""
    monkeypatch.setattr(checkpoint, "plot_curves", lambda *_: None)


# Interruptions


@pytest.mark.parametrize("at", [1, 2])
def test_a_run_that_was_interrupted_ends_where_a_whole_one_does(config, tmp_path: Path, monkeypatch, at: int) -> None:
    """At 1 the policy of the iteration before is being validated, at 2 it has been and its files are there."""
    config = count(config, 4, validate_every=2)
    whole = train.run(config, tmp_path / "whole", progress=False)
    iterate = train._iterate

    def interrupted(*arguments: Any) -> dict[str, float]:
        found = iterate(*arguments)
        if arguments[-1] == at:
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr(train, "_iterate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train.run(config, tmp_path / "parts", progress=False)
    monkeypatch.setattr(train, "_iterate", iterate)
    resumed = train.run(config, tmp_path / "parts", resume=True, progress=False)
    assert all(torch.equal(a, b) for a, b in zip(weights(whole), weights(resumed), strict=True))
    assert left(tmp_path / "whole") == left(tmp_path / "parts")
    assert [k for k, entry in enumerate(resumed.history) if "validation_score" in entry] == [0, 2, 3]


def left(out: Path) -> tuple[Any, ...]:
    """What a run has left in `out`: its history without times, and its weights with what is said about them."""
    history = json.loads((out / checkpoint.HISTORY).read_text())
    entries = [[(name, value) for name, value in entry.items() if name != "seconds"] for entry in history]
    files = []
    for name in (checkpoint.BEST, checkpoint.LAST):
        with safe_open(out / name, "numpy") as file:
            files.append((file.metadata(), {key: file.get_tensor(key).tobytes() for key in sorted(file.keys())}))
    return entries, files


# Validation


def test_the_best_weights_are_those_of_the_best_validation_before_and_after_an_interruption(
    config, tmp_path: Path, monkeypatch
) -> None:
    def trained(iterations: int, score: float) -> bytes:
        monkeypatch.setattr(train, "validate", lambda *_: {"validation_score": score})
        train.run(count(config, iterations), tmp_path, resume=iterations > 1, progress=False)
        return (tmp_path / checkpoint.BEST).read_bytes()

    first = trained(1, -1.0)
    assert trained(2, -2.0) == first, "worse"
    assert trained(3, -0.5) != first, "better"


# What the policy is rewarded for


@pytest.mark.parametrize(("spread", "expected"), [(3.0, 0.4), (0.1, 0.04)])
def test_it_is_rewarded_for_passing_as_a_driver_and_punished_by_the_penalties(
    config, tmp_path: Path, monkeypatch, spread: float, expected: float
) -> None:
    """A critic that is sure counts as much as it may, one that hardly tells the sides apart hardly counts."""
    seen: list[tuple[list[Any], list[np.ndarray]]] = []
    calls: list[tuple[bool, bool]] = []
    make, update = checkpoint.make_batch, checkpoint.update_policy

    def batch(tracks: list[Any], rewards: list[np.ndarray], *rest: Any) -> Any:
        seen.append((tracks, rewards))
        return make(tracks, rewards, *rest)

    def updated(*arguments: Any, value_only: bool) -> Any:
        calls.append((value_only, arguments[6] is not None))
        return update(*arguments, value_only=value_only)

    collect = train.collect

    def punished(*arguments: Any) -> Any:
        tracks, rates = collect(*arguments)
        return [replace(t, penalty=t.penalty - 7.0 * (np.arange(len(t)) == 0)) for t in tracks], rates

    monkeypatch.setattr(checkpoint, "make_batch", batch)
    monkeypatch.setattr(checkpoint, "update_policy", updated)
    monkeypatch.setattr(train, "collect", punished)
    said = lambda _, pairs, limit: spread * torch.where(torch.arange(len(pairs)) % 2 == 0, 1.0, -1.0)  # noqa: E731
    monkeypatch.setattr(Critic, "reward", said)
    train.run(count(config, 2, critic_reward=0.4), tmp_path, progress=False)
    for tracks, rewards in seen:
        human = np.concatenate([r - t.penalty for r, t in zip(rewards, tracks, strict=True)])
        assert human.mean() == pytest.approx(0.0, abs=1e-6) and human.std() == pytest.approx(expected, rel=0.02)
        assert all(r[0] < -5.0 for r in rewards)
    assert calls == [(True, True), (False, True)], "at first only the value learns; drivers are always shown"


def test_iterations_are_not_each_others_repetitions(config, tmp_path: Path, monkeypatch) -> None:
    """With a policy that stays as it is, every iteration drives other episodes by other draws."""
    driven: list[list[Any]] = []
    collect = train.collect

    def noted(*arguments: Any) -> Any:
        tracks, rates = collect(*arguments)
        driven.append(tracks)
        return tracks, rates

    monkeypatch.setattr(train, "collect", noted)
    frozen = config.ppo.__class__(**{**vars(config.ppo), "value_first": 9})
    train.run(count(config, 2, ppo=frozen), tmp_path, progress=False)
    first, second = (tracks[0] for tracks in driven)
    assert not np.array_equal(first.observation[0], second.observation[0]), "the episode"
    assert not np.array_equal(first.raw[0], second.raw[0])
    size = config.observation.size
    noise = [t.raw[0] - _mean(config, tmp_path, t.observation[:1, :size]) for t in (first, second)]
    assert not np.allclose(noise[0], noise[1], atol=1e-4), "the draws"


def _mean(config: TrainConfig, out: Path, observation: np.ndarray) -> np.ndarray:
    """What the policy of the run in `out` would do before tanh."""
    policy = GaussianPolicy(config.observation)
    policy.load_state_dict(torch.load(out / CHECKPOINT, weights_only=True)["policy"])
    with torch.no_grad():
        return policy(tensor(observation))[0].numpy()
