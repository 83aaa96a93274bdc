"""The SUMO mirror: agents stand in SUMO where the table has them.

libsumo holds one simulation per process: each test closes its own.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import libsumo
import numpy as np
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand, Kind
from litsim_sim.core.signals import SignalState
from litsim_sim.lane_map.signal_links import read_links
from litsim_sim.scenario.scenario import Scenario, packaged
from litsim_sim.scenario.signals import Signals
from litsim_sim.world.sumo import SumoMirror
from litsim_sim.world.world import World

Build = Callable[..., AgentTable]
NET = packaged("nets/us101_like.net.xml")


@pytest.fixture
def mirror() -> Iterator[SumoMirror]:
    started = SumoMirror(NET)
    yield started
    started.close()


def in_sumo(table: AgentTable) -> np.ndarray:
    return np.array([libsumo.vehicle.getPosition(str(agent)) for agent in table.id])


def front_centres(table: AgentTable) -> np.ndarray:
    ahead = np.column_stack([np.cos(table.yaw), np.sin(table.yaw)])
    return np.column_stack([table.x, table.y]) + 0.5 * table.length[:, None] * ahead


def present() -> set[str]:
    return set(libsumo.vehicle.getIDList())


def test_pedestrians_and_bicycles_are_shown_as_what_they_are(mirror: SumoMirror, agent_table: Build) -> None:
    walker = {"id": 5, "kind": Kind.PEDESTRIAN, "x": 300.0, "y": 12.0, "yaw": 1.5, "length": 0.5, "width": 0.5}
    rider = {"id": 6, "kind": Kind.BICYCLE, "x": 200.0, "y": -5.49, "length": 1.8, "width": 0.6}
    for step in range(3):
        walker["y"] = 12.0 - 0.14 * step  # beside the road, where no lane is
        table = agent_table(step, {"id": 1, "x": 100.0, "y": -5.49}, walker, rider)
        mirror.show(table)
        np.testing.assert_allclose(in_sumo(table), front_centres(table), atol=1e-6)
    assert [libsumo.vehicle.getVehicleClass(str(agent)) for agent in (1, 5, 6)] == [
        "passenger",
        "pedestrian",
        "bicycle",
    ]
    assert libsumo.vehicle.getLength("5") == 0.5
    mirror.show(agent_table(3, {"id": 1, "x": 101.0, "y": -5.49}))
    assert present() == {"1"}


def scattered(build: Build, step: int, rng: np.random.Generator, count: int = 40) -> AgentTable:
    """Agents anywhere on and off the road, at any heading, overlapping or not."""
    columns = {
        "x": rng.uniform(-30, 680, count),
        "y": rng.uniform(-40, 20, count),
        "yaw": rng.uniform(-7, 7, count),
        "speed": rng.uniform(0, 40, count),
        "length": rng.uniform(2, 20, count),
        "width": rng.uniform(0.5, 3, count),
    }
    return build(step, *({"id": 5 * i, **{f: float(v[i]) for f, v in columns.items()}} for i in range(count)))


def test_positions_in_sumo_are_the_front_centres(mirror: SumoMirror, agent_table: Build) -> None:
    rng = np.random.default_rng(5)
    for step in range(20):
        table = scattered(agent_table, step, rng)
        mirror.show(table)
        np.testing.assert_allclose(in_sumo(table), front_centres(table), rtol=0, atol=1e-9)
        assert mirror.deviation(table).shape == (40,)
        assert mirror.deviation(table).max() <= 1e-9


def test_headings_speeds_and_sizes_in_sumo(mirror: SumoMirror, agent_table: Build) -> None:
    for step, yaw in enumerate([0.0, 0.3, -0.3, np.pi / 2]):
        turned = {"yaw": yaw, "speed": 7.5 + step, "length": 6.5, "width": 2.25}
        table = agent_table(step, {"id": 1, "x": 200.0 + step, "y": -5.49, **turned})
        mirror.show(table)
        assert libsumo.vehicle.getAngle("1") == pytest.approx((90.0 - np.degrees(yaw)) % 360.0, abs=1e-9)
    assert (libsumo.vehicle.getLength("1"), libsumo.vehicle.getWidth("1")) == (6.5, 2.25)


def test_a_step_of_the_mirror_is_a_tenth_of_a_second(mirror: SumoMirror, agent_table: Build) -> None:
    for step in range(10):
        mirror.show(agent_table(step, {"id": 1, "x": 100.0 + step, "y": -5.49}))
    assert libsumo.simulation.getTime() == pytest.approx(1.0)


def test_agents_come_and_go_and_come_back(mirror: SumoMirror, agent_table: Build) -> None:
    shown = [(1, 2), (1, 2, 3), (2, 3), (2,), (), (), (1, 4), (1, 3, 4)]
    for step, agents in enumerate(shown):
        table = agent_table(step, *({"id": i, "x": 100.0 + 10 * i + step, "y": -5.49} for i in agents))
        mirror.show(table)
        assert present() == {str(i) for i in agents}
        assert mirror.deviation(table).tolist() == pytest.approx([0.0] * len(agents), abs=1e-9)


def test_agents_at_rest_overlapping_and_beyond_the_end_stay(mirror: SumoMirror, agent_table: Build) -> None:
    poses = [{"id": 1, "x": 639.0}, {"id": 2, "x": 660.0}, {"id": 3, "x": 300.0}, {"id": 4, "x": 301.0}]
    for step in range(50):
        table = agent_table(step, *({**pose, "y": -5.49, "speed": 0.0} for pose in poses))
        mirror.show(table)
        assert mirror.deviation(table).max() <= 1e-9


def test_deviation_of_an_agent_that_sumo_has_lost_is_infinite(mirror: SumoMirror, agent_table: Build) -> None:
    table = agent_table(0, {"id": 1, "x": 100.0, "y": -5.49}, {"id": 2, "x": 150.0, "y": -5.49})
    mirror.show(table)
    libsumo.vehicle.remove("1")
    libsumo.simulationStep()
    assert mirror.deviation(table)[0] == np.inf


def test_a_world_is_mirrored_throughout(make_scenario: Callable[..., Scenario], track: Callable[..., object]) -> None:
    scenario = make_scenario(
        track(1, x=100.0, speed=20.0, last=300), track(2, x=80.0, y=-9.15, last=20), track(3, x=0.0, first=15, last=60)
    )
    world = World(scenario, mirror=SumoMirror(NET))
    try:
        table, rng = world.reset(), np.random.default_rng(6)
        for step in range(scenario.total_steps):
            table = world.step(ControlTable.empty(step), EgoCommand(step, *rng.normal(0, [2.0, 0.1])))
            world.catch_up()
            assert present() == {str(agent) for agent in table.id}
        assert world.summary()["sumo_deviation_m"] <= 1e-9
    finally:
        world.close()


def test_one_simulation_follows_the_other(agent_table: Build) -> None:
    for speed, seed in ((5.0, 3), (10.0, 2**64 - 1)):  # the greatest that a run can have
        mirror = SumoMirror(NET, seed)
        table = agent_table(0, {"id": 1, "x": 100.0, "y": -5.49, "speed": speed})
        mirror.show(table)
        assert present() == {"1"}
        assert mirror.deviation(table).max() <= 1e-9
        mirror.close()


@pytest.mark.parametrize(
    "content", ["", "hello", "<net", "<routes/>", NET.read_text()[:5000], '<net version="1.20"></net>']
)
def test_a_net_that_is_none_is_an_input_error(tmp_path: Path, agent_table: Build, content: str) -> None:
    path = tmp_path / "broken.net.xml"
    path.write_text(content)
    with pytest.raises(InputError, match=r"broken\.net\.xml: "):
        SumoMirror(path)
    usable = SumoMirror(NET)  # and SUMO can still be used
    usable.show(agent_table(0, {"id": 1, "x": 100.0, "y": -5.49}))
    assert present() == {"1"}
    usable.close()


def test_lights_show_the_signals_of_the_scenario(agent_table: Build) -> None:
    net = packaged("nets/urban_like.net.xml")
    links = tuple(link for link in read_links(net) if link.from_lane.startswith("WA"))
    states = np.array([[SignalState.GREEN, SignalState.AMBER, SignalState.RED]], np.uint8)
    signals = Signals(("east",), links, np.zeros(len(links), np.int64), states)
    mirror = SumoMirror(net, signals=signals)
    try:
        for step, letter in enumerate("Gyrr"):
            mirror.show(agent_table(step))
            shown = libsumo.trafficlight.getRedYellowGreenState("A")
            assert {shown[link.index] for link in links} == {letter}
            assert shown.count("O") == len(shown) - len(links)
            assert set(libsumo.trafficlight.getRedYellowGreenState("B")) == {"O"}
    finally:
        mirror.close()


def test_without_signals_lights_are_off(agent_table: Build) -> None:
    mirror = SumoMirror(packaged("nets/urban_like.net.xml"))
    try:
        mirror.show(agent_table(0))
        assert set(libsumo.trafficlight.getRedYellowGreenState("A")) == {"O"}
    finally:
        mirror.close()
