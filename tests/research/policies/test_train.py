"""Training: it runs, it goes on where it stopped, it says what is wrong with its configuration."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from safetensors import safe_open

import litsim_research
from command_line import refusal
from litsim_policy.driving.policy_network import shipped_weights
from litsim_research.policies import train
from litsim_research.policies.config import TrainConfig
from litsim_research.policies.data import REPORTED, DataConfig, RealWindow, prepare
from litsim_research.policies.expert import expert_pairs
from litsim_research.policies.network import GaussianPolicy
from litsim_research.policies.ppo import tensor
from litsim_research.policies.warm_start import WarmStart, clone
from litsim_sim.core.errors import InputError
from litsim_sim.io.yaml_input import read_yaml
from litsim_sim.scenario.recording import Recording

CONFIGS = Path(litsim_research.__file__).parent / "configs" / "policies"


@pytest.fixture(scope="module")
def file(training_data, tmp_path_factory) -> Path:
    """A configuration that takes a second."""
    folder = tmp_path_factory.mktemp("train")
    values = {
        "iterations": 2,
        "transitions": 40,
        "validate_every": 1,
        "validation_episodes": 1,
        "data": training_data,
        "environment": {"steps_max": 20, "slots": 4, "sampled": 3},
        "warm_start": {"epochs": 2},
        "critic": {"updates": 2, "batch": 32},
        "ppo": {"epochs": 2, "batch": 32},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(values))
    return folder / "config.yaml"


@pytest.mark.parametrize("name", ["critic", "paper_rate"])
def test_packaged_configurations_can_be_read(name: str) -> None:
    config = read_yaml(CONFIGS / f"{name}.yaml", TrainConfig)
    assert config.data.following
    assert (config.ppo.learning_rate, config.ppo.batch) == ((3e-4, 1024) if name == "critic" else (0.03, 32))


def with_iterations(file: Path, count: int) -> TrainConfig:
    return read_yaml(file, TrainConfig).model_copy(update={"iterations": count})


def test_drivers_are_imitated(file: Path) -> None:
    """After the warm start the policy does in the recordings what the drivers did, better than nothing would."""
    config = read_yaml(file, TrainConfig)
    data = prepare(config.data, file.parent / "data")
    random = np.random.default_rng(0)
    experts = expert_pairs(data.train, config.observation, config.expert, config.task, random)
    torch.manual_seed(0)
    policy = GaussianPolicy(config.observation)

    def error() -> float:
        with torch.no_grad():
            said = torch.tanh(policy(tensor(experts.displaced))).numpy()
        return float(np.abs(said - experts.correction)[:, 1:].mean())

    before = error()
    shown = experts.demonstrations(0.5)[1]
    clone(policy, shown, WarmStart(epochs=40), config.seed, shown.error)
    assert error() < 0.5 * before
    with pytest.raises(InputError, match=r"field warm_start.learning_rate is 1e\+30, .*expected a smaller one"):
        clone(policy, shown, WarmStart(epochs=1, learning_rate=1e30), config.seed, shown.error)


def test_a_training_that_diverges_ends(file: Path, tmp_path: Path) -> None:
    """It used to go on, and to leave weights that are not finite."""
    values = yaml.safe_load(file.read_text())
    values["ppo"]["learning_rate"] = 1e30
    (tmp_path / "fast.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(InputError, match=r"field ppo.learning_rate is 1e\+30, .*expected a smaller one"):
        train.run(read_yaml(tmp_path / "fast.yaml", TrainConfig), tmp_path / "out", progress=False)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("iterations: 0\ndata: {}\n", "field iterations: .*greater than 0"),
        ("data: {}\nlearning_rat: 1\n", "field learning_rat"),
        ("data: {}\nseed: 100000000000000\n", "field seed: .*less than 4294967296"),
        ("data: {}\nppo: {epochs: 0}\n", "field ppo.epochs: .*greater than 0"),
        ("data: {}\ncritic_reward: .inf\n", "field critic_reward: .*finite"),
        ("data: {}\nppo: {batch: 1000000000000}\n", "field ppo.batch: .*less than or equal to 1000000"),
        ("data: {}\ncritic: {updates: 0}\n", "field critic.updates: .*greater than 0"),
        ("iterations: [\n", "malformed YAML"),
        ("data: {generated: [{net: us101_like, segments: 0, seed: 1}]}\n", "field data.generated.0.segments"),
        ("data: {real: [{frames: [500, 700], local_y_m: [0, 100]}]}\n", "on which results are reported"),
    ],
)
def test_configurations_that_are_wrong(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as error:
        read_yaml(path, TrainConfig)
    assert str(path) in str(error.value)
    with pytest.raises(InputError, match="no such file"):
        read_yaml(tmp_path / "missing.yaml", TrainConfig)


def test_nothing_to_train_on(tmp_path: Path, capsys) -> None:
    (tmp_path / "empty.yaml").write_text("data: {}\n")
    words = ("--config", tmp_path / "empty.yaml", "--out", tmp_path / "out")
    assert "no scenario to train on" in refusal(capsys, train.main, *words)


def test_training_scenarios_never_stand_in_for_missing_ones_to_validate_on(file: Path, tmp_path: Path) -> None:
    data = read_yaml(file, TrainConfig).data
    with pytest.raises(InputError, match="no scenario to validate on"):
        prepare(data.model_copy(update={"validation": ()}), tmp_path)
    with pytest.raises(ValueError, match="in both scenarios and validation"):
        DataConfig(scenarios=("demo",), validation=("demo",))
    with pytest.raises(ValueError, match=r"a/../b.yaml in both scenarios and validation"):
        DataConfig(scenarios=("a/../b.yaml",), validation=("./b.yaml",))
    apart = prepare(data, tmp_path)
    assert len(apart.train) == len(apart.validation) == 1 and not set(apart.train) & set(apart.validation)


@pytest.mark.parametrize(("first", "fits"), [(543, False), (544, True)])
def test_scenarios_of_what_is_reported_on_are_refused(
    make_scenario, track, lane_centres, tmp_path: Path, first: int, *, fits: bool
) -> None:
    given = yaml.safe_load(make_scenario(track(1, x=60.0, y=lane_centres[1], last=45)).to_yaml())
    made = Recording.read(Path(given["recording"]))
    table = made.table.assign(frame=made.table["frame"] + first)
    Recording.from_table(replace(made.header, name="us101_0750"), table, "made").write(tmp_path / "us101.parquet")
    path = tmp_path / "us101.yaml"
    path.write_text(yaml.safe_dump(given | {"recording": str(tmp_path / "us101.parquet"), "start_frame": first}))
    data = DataConfig(scenarios=(str(path),), validation=("demo",))
    if fits:
        assert len(prepare(data, tmp_path).train) == 1
    else:
        with pytest.raises(InputError, match=r"us101.yaml: frames 543 to .* of us101_0750 overlap \(316, 543\)"):
            prepare(data, tmp_path)


@pytest.mark.parametrize(("frames", "fits"), [((748, 828), True), ((126, 315), True), ((126, 316), False)])
def test_what_is_reported_on_is_never_learned_from(frames: tuple[int, int], *, fits: bool) -> None:
    assert REPORTED == (316, 543)
    if fits:
        assert RealWindow(frames=frames, local_y_m=(0.0, 100.0)).frames == frames
    else:
        with pytest.raises(ValueError, match="results are reported"):
            RealWindow(frames=frames, local_y_m=(0.0, 100.0))


def test_the_packaged_weights_say_how_they_were_made() -> None:
    """By the packaged configuration, with another number of iterations; they are those whose validation is best."""
    config = read_yaml(CONFIGS / "critic.yaml", TrainConfig)
    with safe_open(shipped_weights("critic"), "np") as file:
        about = file.metadata()
    made_by = json.loads(about["config"])
    for part, retired in ((made_by, "rule_rounds"), (made_by["observation"], "residual"), (made_by["data"], "tuning")):
        assert not part.pop(retired, None)
    assert TrainConfig(**made_by | {"iterations": config.iterations}) == config
    assert about["seed"] == str(config.seed) and re.fullmatch("[0-9a-f]{64}", about["data"])
    assert 0 < int(about["iterations"]) <= made_by["iterations"]
