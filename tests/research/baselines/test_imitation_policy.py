"""The baselines `gail` and `rail`: a network drives everybody who is listed, within its bounds and by nothing else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from litsim_policy.driving.features.traffic_observation import SIZE
from litsim_research.baselines.imitation_policy import (
    BOUNDS,
    FORMAT,
    Gail,
    ImitationConfig,
    ImitationNetwork,
    ImitationPolicy,
    largest,
)
from litsim_research.imitation.network import TrafficPolicy, save
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import ControlSource
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.scenario.policies import class_of_policy
from litsim_sim.scenario.scenario import Scenario
from made_agents import takeovers_in_region


@pytest.fixture
def scenario(make_scenario: Any, track: Any) -> Scenario:
    return make_scenario(*(track(k, x=220.0 - 20.0 * k) for k in range(1, 5)), roi_m=30.0)


def network(*bias: float, deviation: float = 0.5) -> ImitationNetwork:
    """One that always says `bias`."""
    torch.manual_seed(0)
    policy = TrafficPolicy()
    with torch.no_grad():
        last = policy.get_submodule("mean")
        last.weight.zero_()
        last.bias.copy_(torch.tensor(bias))
    sizes = [policy.get_submodule(name) for name in ("hidden0", "hidden1", "hidden2", "mean")]
    return ImitationNetwork(
        tuple(layer.weight.detach().double().numpy().T.copy() for layer in sizes),
        tuple(layer.bias.detach().double().numpy() for layer in sizes),
        np.full(2, deviation),
    )


def test_what_the_network_says_is_done_within_its_bounds(scenario: Scenario) -> None:
    table = scenario.log.table(5)
    controls = ImitationPolicy(scenario, ImitationConfig(), network(-0.5, 0.2)).act(table, takeovers_in_region(5, 2, 3))
    assert controls.id.tolist() == [2, 3] and controls.source.tolist() == [ControlSource.POLICY] * 2
    assert controls.acceleration == pytest.approx([-2.0, -2.0]) and controls.yaw_rate == pytest.approx([0.03, 0.03])
    speed = table.speed[table.rows(np.array([2, 3]))]
    assert controls.lateral_acceleration == pytest.approx(0.03 * speed)
    beyond = ImitationPolicy(scenario, ImitationConfig(), network(-7.0, 7.0)).act(table, takeovers_in_region(5, 2))
    assert (beyond.acceleration[0], beyond.yaw_rate[0]) == (-BOUNDS[0], BOUNDS[1])
    assert (
        len(ImitationPolicy(scenario, ImitationConfig(), network(0.0, 0.0)).act(table, takeovers_in_region(5)).id) == 0
    )


def test_an_action_is_a_share_of_what_is_published_or_of_what_the_vehicle_can_do() -> None:
    """Slowly it turns as tightly as a junction asks, and fast no harder than its tyres hold."""
    speed = np.array([0.0, 4.0, 24.45])
    slow, turning, fast = largest(speed, "vehicle").tolist()
    assert slow == [4.0, pytest.approx(0.2)], "at rest, an action still has a scale"
    assert turning == [4.0, pytest.approx(0.8)] and fast == [4.0, pytest.approx(0.2)]
    assert largest(speed, "published").tolist() == [[4.0, 0.15]]


@pytest.mark.parametrize("name", ["gail", "rail"])
def test_the_packaged_network_for_streets_turns_at_junctions(make_scenario: Any, track: Any, name: str) -> None:
    street, motorway = (
        ImitationConfig().network(name, make_scenario(track(1, x=x, y=y), net=net).lane_map)
        for net, x, y in (("urban_like", -150.0, -4.95), ("us101_like", 200.0, -5.49))
    )
    assert (street.turning, motorway.turning) == ("vehicle", "published")


def test_the_file_says_what_yaw_rate_action_1_is(tmp_path: Path, scenario: Scenario) -> None:
    file = tmp_path / "w.safetensors"
    save(TrafficPolicy("vehicle"), file, {})
    assert ImitationNetwork.load(file).turning == "vehicle"
    policy = ImitationPolicy(scenario, ImitationConfig(), replace(network(-0.5, 0.2), turning="vehicle"))
    table = scenario.log.table(5)
    most = largest(table.speed[table.rows(np.array([2]))], "vehicle")
    assert policy.act(table, takeovers_in_region(5, 2)).yaw_rate == pytest.approx(0.2 * most[:, 1])


def test_drawn_actions_are_the_agents_own(make_scenario: Any, track: Any) -> None:
    config, by_seed = ImitationConfig(actions="drawn"), {}
    for seed in (0, 1):
        scenario = make_scenario(*(track(k, x=220.0 - 20.0 * k) for k in range(1, 5)), seed=seed)
        policy = ImitationPolicy(scenario, config, network(0.0, 0.0))
        alone = policy.act(scenario.log.table(5), takeovers_in_region(5, 3)).acceleration
        together = policy.act(scenario.log.table(5), takeovers_in_region(5, 2, 3, 4)).acceleration
        assert together[1] == alone[0], "whoever else is driven"
        assert len(set(together.tolist())) == 3
        assert policy.act(scenario.log.table(6), takeovers_in_region(6, 3)).acceleration[0] != alone[0]
        by_seed[seed] = alone[0]
    assert by_seed[0] != by_seed[1]


def test_numpy_and_torch_say_the_same(tmp_path: Path) -> None:
    torch.manual_seed(1)
    policy = TrafficPolicy()
    with torch.no_grad():
        policy.get_submodule("mean").weight.normal_(0.0, 0.3)
        policy.log_std.copy_(torch.tensor([-0.5, -9.0]))
    save(policy, tmp_path / "w.safetensors", {"seed": "0"})
    loaded = ImitationNetwork.load(tmp_path / "w.safetensors")
    seen = np.random.default_rng(0).normal(0.0, 1.0, (9, SIZE))
    with torch.no_grad():
        expected = policy(torch.as_tensor(seen, dtype=torch.float32)).numpy()
    assert loaded.outputs(seen) == pytest.approx(expected, abs=2e-6) and np.abs(expected).max() > 0.3
    assert loaded.deviation == pytest.approx(policy.std().detach().numpy())
    rows = [loaded.outputs(row[None])[0] for row in seen]
    assert all((row == said).all() for row, said in zip(rows, loaded.outputs(seen), strict=True))


@pytest.mark.parametrize(
    ("tensors", "metadata", "said"),
    [
        ({"mean.bias": torch.zeros(3)}, {}, r"tensor mean.bias has shape \(3,\), expected \(2,\)"),
        ({"hidden2.weight": None}, {}, r"tensor hidden2.weight has shape none, expected \(64, 128\)"),
        ({"log_std": None}, {}, r"tensor log_std has shape \(0,\), expected \(2,\) finite numbers"),
        ({"hidden0.bias": torch.full((128,), float("inf"))}, {}, "tensor hidden0.bias holds non-finite"),
        ({}, {"turning": "free"}, "metadata turning is 'free', expected published or vehicle"),
        ({}, {"format": "litsim policy C, 1"}, f"expected '{FORMAT}'"),
    ],
)
def test_files_that_are_wrong(
    tmp_path: Path, scenario: Scenario, tensors: Any, metadata: dict[str, str], said: str
) -> None:
    save(TrafficPolicy(), tmp_path / "w.safetensors", {})
    contents = {**load_file(tmp_path / "w.safetensors"), **tensors}
    path = tmp_path / "wrong.safetensors"
    save_file({k: v for k, v in contents.items() if v is not None}, str(path), {"format": FORMAT} | metadata)
    with pytest.raises(InputError, match=said) as error:
        Gail(scenario, ImitationConfig(weights=str(path)))
    assert str(path) in str(error.value)


@pytest.mark.parametrize("name", ["gail", "rail"])
def test_the_shipped_networks_drive_a_column_behind_an_ego_that_follows_its_log(
    scenario: Scenario, drive: Any, name: str
) -> None:
    assert issubclass(class_of_policy(name), ImitationPolicy)
    driven = drive(scenario, lambda *_: (0.0, 0.0), policy=name)
    assert driven.life(2) == [TakeoverState.HELD]
    x, y = driven.series(2, "x"), driven.series(2, "y")
    assert scenario.lane_map.inside_road(x, y).all(), "it stays on the road"
    assert x[-1] - x[0] > 20.0, "and goes on"


def test_both_are_not_the_same(scenario: Scenario) -> None:
    plain, augmented = (ImitationConfig().network(name, scenario.lane_map) for name in ("gail", "rail"))
    assert not np.array_equal(plain.weights[-1], augmented.weights[-1])
