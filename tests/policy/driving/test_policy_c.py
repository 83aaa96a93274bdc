"""Policy C's network: the same in numpy and torch, from a file that is what it says, in the loop."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file

from litsim_policy.driving.action import HIGH, LOW, consistent, executed_yaw_rate, normalised, physical
from litsim_policy.driving.features.observation import ObservationConfig
from litsim_policy.driving.features.scales import ACCELERATION
from litsim_policy.driving.policy_c import PolicyC, PolicyCConfig
from litsim_policy.driving.policy_network import FORMAT, PACKAGED, PolicyNetwork
from litsim_policy.driving.safety.layer import SafetyConfig
from litsim_research.policies.network import GaussianPolicy, driving_network, pedal_bounds, save
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, ControlSource
from litsim_sim.core.takeover import TakeoverTable
from made_agents import takeover


@pytest.fixture
def policy() -> GaussianPolicy:
    torch.manual_seed(0)
    made = GaussianPolicy(ObservationConfig())
    torch.nn.init.normal_(made.mean.weight, std=0.3)  # a fresh one says next to nothing
    return made


@pytest.fixture
def seen() -> np.ndarray:
    return np.random.default_rng(0).uniform(-2.0, 2.0, (7, ObservationConfig().size))


# Actions


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_actions_there_and_back(values: list[float]) -> None:
    action = np.array([values])
    command = physical(action)
    assert (command >= LOW - 1e-12).all() and (command <= HIGH + 1e-12).all()
    assert normalised(command) == pytest.approx(action, abs=1e-12)


@given(st.floats(0.0, 40.0), st.floats(-0.5, 0.5))
def test_lateral_actions_that_agree_are_executed(speed: float, yaw_rate: float) -> None:
    command = consistent(np.array([0.0]), np.array([yaw_rate]), np.array([speed]))
    assert executed_yaw_rate(command, np.array([speed])) == pytest.approx([yaw_rate], abs=1e-12)


def test_lateral_actions_that_disagree() -> None:
    command = np.array([[0.0, 2.0, 0.0]])
    at_rest, slow, fast = (float(executed_yaw_rate(command, np.array([v]))[0]) for v in (0.0, 1.0, 30.0))
    assert at_rest == 0.0 and 0.0 < slow < 0.03
    assert fast * 30.0 == pytest.approx(2.0, rel=0.15)


# The network


def test_numpy_and_torch_say_the_same(policy, seen) -> None:
    with torch.no_grad():
        expected = torch.tanh(policy(torch.as_tensor(seen, dtype=torch.float32))).numpy()
    assert driving_network(policy).mean(seen) == pytest.approx(expected, abs=2e-6)
    assert np.abs(expected).max() > 0.3


def test_agents_do_not_change_each_others_last_bits(policy, seen) -> None:
    network = driving_network(policy)
    together = network.mean(seen)
    assert all((network.mean(row[None])[0] == expected).all() for row, expected in zip(seen, together, strict=True))
    assert network.mean(seen[:0]).shape == (0, 3)


@pytest.mark.parametrize("acceleration", [0.0, -1.5, -6.0, 2.4])  # [m/s2] of the step before
def test_densities_and_the_masses_beyond_the_bounds_on_jerk_sum_to_one(policy, acceleration: float) -> None:
    """Over the first action, for the squashed density."""
    seen = np.zeros((1, ObservationConfig().size))
    seen[0, 3] = acceleration / ACCELERATION
    low, high = (float(bound[0]) for bound in pedal_bounds(seen))
    inside = torch.linspace(np.tanh(low), np.tanh(high), 20001, dtype=torch.float64)[1:-1]
    first = torch.cat([torch.tensor([low - 1.0, high + 1.0], dtype=torch.float64), torch.atanh(inside)])
    observation = torch.as_tensor(np.repeat(seen, len(first), axis=0), dtype=torch.float32)
    with torch.no_grad():
        mean = policy(observation)
        raw = torch.cat([first[:, None].float(), mean[:, 1:]], dim=1)
        lateral = -torch.log(policy.std()[1:] * (2 * np.pi) ** 0.5) - torch.log(1 - torch.tanh(mean[0, 1:]) ** 2)
        density = torch.exp(policy.log_probability(observation, raw) - lateral.sum()).double()
    assert float(density[:2].sum() + torch.trapezoid(density[2:], inside)) == pytest.approx(1.0, abs=1e-3)
    assert float(density[:2].sum()) > 0.1  # many draws are cut


def test_accelerations_beyond_the_bounds_on_jerk_are_all_as_likely(policy) -> None:
    """What they are is not executed, so nothing is to be learned from it; `safety.comfort` has the bounds."""
    seen = np.zeros((3, ObservationConfig().size))
    low, high = pedal_bounds(seen)
    assert physical(np.tanh(np.column_stack([low, low, low])))[0, 0] == pytest.approx(-0.837)
    assert physical(np.tanh(np.column_stack([high, high, high])))[0, 0] == pytest.approx(0.413)
    raw = torch.zeros((3, 3))
    raw[:, 0] = torch.tensor([low[0] - 0.1, low[0] - 0.5, low[0] + 0.01])
    below, far_below, inside = policy.log_probability(torch.as_tensor(seen, dtype=torch.float32), raw).tolist()
    assert below == far_below != inside


# Files


def test_weights_come_back(policy, seen, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save(policy, path)
    again = PolicyNetwork.load(path)
    assert (again.mean(seen) == driving_network(policy).mean(seen)).all()
    assert again.observation == policy.observation


@pytest.mark.parametrize("config", [ObservationConfig(5, 40.0), ObservationConfig(ahead=True)])
def test_what_is_observed_comes_back(tmp_path: Path, config: ObservationConfig) -> None:
    path = tmp_path / "w.safetensors"
    save(GaussianPolicy(config), path)
    assert PolicyNetwork.load(path).observation == config


def changed(path: Path, out: Path, tensors: dict[str, torch.Tensor | None], **metadata: str) -> Path:
    """A copy of a weights file with some tensors replaced (None: left out) and metadata overridden."""
    found = {**load_file(path), **tensors}
    about = {"format": FORMAT, "observation.arrange": "sector", "observation.slots": "8", "observation.sight": "60.0"}
    save_file({k: v for k, v in found.items() if v is not None}, str(out), about | metadata)
    return out


@pytest.mark.parametrize(
    ("tensors", "metadata", "said"),
    [
        ({"mean.bias": torch.zeros(2)}, {}, r"tensor mean.bias has shape \(2,\), expected \(3,\)"),
        ({"hidden1.weight": None}, {}, r"tensor hidden1.weight has shape none, expected \(128, 128\)"),
        ({"mean.bias": torch.full((3,), float("nan"))}, {}, "tensor mean.bias holds non-finite"),
        ({}, {"format": "something else"}, "expected 'litsim policy C, 1'"),
        ({}, {"observation.slots": "9"}, r"hidden0.weight has shape .* expected \(128, 88\)"),
        ({}, {"observation.arrange": "by colour"}, "observation.arrange is 'by colour', expected 'sector'"),
        ({}, {"observation.residual": "True"}, "observation.residual is 'True', expected 'False'"),
        ({}, {"observation.slots": "many"}, "expected slots a number"),
        ({}, {"observation.ahead": "perhaps"}, "ahead True or False"),
        ({}, {"observation.ahead": "True"}, r"hidden0.weight has shape .* expected \(128, 87\)"),
    ],
)
def test_files_that_do_not_fit(policy, tmp_path: Path, tensors, metadata, said: str) -> None:
    good, bad = tmp_path / "good.safetensors", tmp_path / "bad.safetensors"
    save(policy, good)
    with pytest.raises(InputError, match=said) as error:
        PolicyNetwork.load(changed(good, bad, tensors, **metadata))
    assert str(bad) in str(error.value)


@pytest.mark.parametrize("content", [b"", b"no weights at all", None])
def test_files_that_are_damaged(policy, tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "w.safetensors"
    save(policy, path)
    path.write_bytes(path.read_bytes()[:-100] if content is None else content)
    with pytest.raises(InputError, match="not a readable safetensors file"):
        PolicyNetwork.load(path)
    with pytest.raises(InputError, match="no such weights"):
        PolicyNetwork.load(tmp_path / "nowhere.safetensors")


# In the loop


@pytest.mark.parametrize("weights", PACKAGED)
def test_shipped_weights_drive(make_scenario, track, drive, weights: str) -> None:
    ego, follower = track(1, x=200.0, last=110), track(2, x=170.0, last=110)
    scenario = make_scenario(ego, follower)
    run = drive(
        scenario,
        lambda table, _: (-3.0 if table.step < 40 else 0.5, 0.0),
        policy="litsim",
        parameters={"policy": {"weights": weights}},
    )
    assert run.world.contacts == {} and run.takeovers(2)
    sources = {s for r in run.results if r.controls is not None for s in r.controls.source.tolist()}
    assert sources & {ControlSource.POLICY, ControlSource.GUARDED}
    assert all((np.diff(r.controls.id) > 0).all() for r in run.results if r.controls is not None)


@pytest.mark.parametrize(("guard", "collides"), [(False, True), (True, False)])
def test_without_network_and_rules_only_the_guard_brakes(
    make_scenario, track, drive, *, guard: bool, collides: bool
) -> None:
    """The ego ahead brakes to a stand; agent 2 would drive on."""
    scenario = make_scenario(track(1, x=200.0, last=110), track(2, x=170.0, last=110))
    parameters = {"policy": {"drivers": "none", "rules": False, "safety.contact": guard}}
    run = drive(scenario, lambda *_: (-5.0, 0.0), policy="litsim", parameters=parameters)
    assert ((1, 2) in run.world.contacts) == collides


@pytest.mark.parametrize("lag", [0, 10])
def test_without_network_it_drives_on_as_its_log_does(make_scenario, track, placed, lane_centres, lag: int) -> None:
    y = lane_centres[1]
    scenario = make_scenario(track(1, x=300.0), track(2, x=100.0, y=y, speed=8.0, acceleration=0.7))
    config = PolicyCConfig(rules=False, safety=SafetyConfig(contact=False))
    then, path = scenario.log.table(20 - lag), np.array([[90.0, y], [400.0, y]])
    own = {name: float(getattr(then, name)[then.row(2)]) for name in ("x", "speed", "acceleration")}
    table = placed(scenario.log.table(20), 2, **own)
    held = TakeoverTable(20, (takeover(2, reference_path=path, time_shift=lag * STEP_S),))
    controls = PolicyC(scenario, config).act(table, held)
    assert controls.acceleration[0] == pytest.approx(0.7, abs=1e-6)
    assert controls.yaw_rate[0] == pytest.approx(0.0, abs=1e-9)
