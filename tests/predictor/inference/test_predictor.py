"""A learned model in a running scene: what the node publishes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from litsim_predictor.forecast import Forecast, Scope, Wanted
from litsim_predictor.inference import SHIPPED
from litsim_predictor.inference.contract import HORIZON, MANEUVERS
from litsim_predictor.inference.predictor import LearnedPredictor
from litsim_predictor.inference.raster import MapRaster, raster_of_net
from litsim_predictor.inference.weights import weights_path
from litsim_predictor.models import make_predictor, network
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import AgentTable, Kind
from litsim_sim.scenario.scenario import Scenario

Build = Callable[..., AgentTable]
EGO, ROI = 1, 30.0
EVERYBODY = Scope(ROI, Wanted.ALL)


@pytest.fixture(params=SHIPPED)
def predictor(request: pytest.FixtureRequest) -> LearnedPredictor:
    return LearnedPredictor(network(request.param), EGO, EVERYBODY, *raster_of_net(Scenario.load("demo").net_path))


def drive(
    predictor: LearnedPredictor, build: Build, *agents: dict[str, Any], steps: int = 40, first: int = 0
) -> Forecast:
    """The last forecast while agents drive on along x at their speeds."""
    for step in range(first, first + steps):
        moved = [{**a, "x": a["x"] + 0.1 * step * a["speed"]} for a in agents if step >= a.get("since", 0)]
        out = predictor.forecast(build(step, *({k: v for k, v in a.items() if k != "since"} for a in moved)))
    return out


def agent(number: int, x: float, y: float = -5.5, speed: float = 10.0, **other: Any) -> dict[str, Any]:
    return {"id": number, "x": x, "y": y, "speed": speed, "yaw": 0.0, **other}


def assert_sane(out: Forecast, ids: list[int]) -> None:
    n = len(ids)
    assert out.id.tolist() == ids
    assert out.mean.shape == (n, HORIZON, 2) and out.yaw.shape == (n, HORIZON)
    assert out.covariance.shape == (n, HORIZON, 3) and out.maneuver_probability.shape == (n, len(MANEUVERS))
    assert out.valid.all()
    for array in (out.mean, out.yaw, out.covariance, out.maneuver_probability):
        assert np.isfinite(array).all()
    assert (out.covariance[..., :2] > 0).all() and (np.abs(out.covariance[..., 2]) < 1).all()
    assert out.maneuver_probability.sum(axis=1) == pytest.approx(np.ones(n), abs=1e-5)


def test_odd_scenes_are_answered(predictor: LearnedPredictor, agent_table: Build) -> None:
    assert_sane(drive(predictor, agent_table, agent(1, 100.0), steps=1), [1])
    stopped = [agent(k, 100.0 + 7.0 * k, speed=0.0) for k in range(1, 5)]
    assert_sane(drive(predictor, agent_table, *stopped, first=100), [1, 2, 3, 4])
    crowd = [agent(k, 100.0 + 0.05 * k, y=-0.05 * k) for k in range(1, 121)]
    assert_sane(drive(predictor, agent_table, *crowd, steps=3, first=200), list(range(1, 121)))
    beyond = [agent(1, -500.0, y=900.0), agent(2, -490.0, y=900.0, kind=255)]
    assert_sane(drive(predictor, agent_table, *beyond, first=300), [1, 2])


def test_who_has_just_appeared_is_forecast(predictor: LearnedPredictor, agent_table: Build) -> None:
    out = drive(predictor, agent_table, agent(1, 100.0), agent(2, 115.0, since=39))
    assert_sane(out, [1, 2])


def test_neither_the_order_of_agents_nor_far_away_ones_matter(predictor: LearnedPredictor, agent_table: Build) -> None:
    near = [agent(1, 100.0), agent(2, 115.0, y=-9.0), agent(7, 90.0)]
    out = drive(predictor, agent_table, *near)
    again = drive(predictor, agent_table, *near[::-1], first=100)
    for step_shift in (out, again):
        assert_sane(step_shift, [1, 2, 7])
    far = drive(predictor, agent_table, *near, agent(3, 400.0), agent(9, 100.0, y=-300.0), first=200)
    # The scene is the same but for where it is: 10 m per second further.
    local = out.mean - out.mean[:1, :1]
    assert np.allclose(again.mean - again.mean[:1, :1], local, atol=0.5)
    same = drive(predictor, agent_table, *near, first=200)
    assert np.array_equal(far.mean, same.mean) and np.array_equal(far.covariance, same.covariance)


def test_traffic_beyond_the_region_of_interest_is_read_and_not_forecast(agent_table: Build) -> None:
    """Vehicles that stand 70 m ahead make drivers slower, whatever region is looked at closely; people there do not."""
    near = [agent(1, 100.0, speed=14.0), agent(2, 115.0, y=-9.0, speed=14.0)]
    jam = [agent(number, 165.0 + 8.0 * number, speed=0.0) for number in range(3, 8)]

    def driven(roi_m: float, *others: dict[str, Any]) -> Forecast:
        net = raster_of_net(Scenario.load("demo").net_path)
        predictor = LearnedPredictor(network("default"), EGO, Scope(roi_m, Wanted.EGO), *net)
        return drive(predictor, agent_table, *near, *others, steps=20)

    free, held, seen = driven(ROI), driven(ROI, *jam), driven(1000.0, *jam)
    assert_sane(held, [1])
    reached = [each.mean[0, -1, 0] for each in (free, held, seen)]
    assert reached[1] < reached[0] - 3.0 and reached[2] < reached[0] - 3.0
    people = driven(ROI, *({**each, "kind": Kind.PEDESTRIAN} for each in jam))
    assert np.array_equal(people.mean, free.mean)


def test_weights_that_overflow_are_named(tmp_path: Path) -> None:
    file = tmp_path / "mine.safetensors"
    with safe_open(weights_path("default"), "np") as shipped:
        huge = {key: np.float32(1e18) * shipped.get_tensor(key) for key in shipped.keys()}  # noqa: SIM118 - no mapping
        save_file(huge, file, shipped.metadata())
    scenario = Scenario.load("demo")
    table = scenario.log.table(0)
    asked = make_predictor("default", scenario).forecast(table)
    with pytest.raises(InputError) as raised:
        make_predictor(str(file), scenario).forecast(table)
    assert str(raised.value).startswith(f"{file}: none of the forecasts of {len(asked.id)} agents at step 0 is finite")


def test_covariances_turn_with_the_scene(agent_table: Build) -> None:
    """Without a map, a scene that is turned by a right angle has forecasts that are turned by one."""
    along = LearnedPredictor(network("default"), EGO, EVERYBODY, None, MapRaster(None))
    for step in range(20):
        out = along.forecast(agent_table(step, {"id": 1, "x": step * 1.0, "y": 0.0, "yaw": 0.0, "speed": 10.0}))
    for step in range(100, 120):
        up = along.forecast(
            agent_table(step, {"id": 1, "x": 0.0, "y": (step - 100) * 1.0, "yaw": np.pi / 2, "speed": 10.0})
        )
    assert up.mean[..., 1] == pytest.approx(out.mean[..., 0], abs=1e-3)
    assert up.mean[..., 0] == pytest.approx(-out.mean[..., 1], abs=1e-3)
    assert up.covariance[..., 1] == pytest.approx(out.covariance[..., 0], rel=1e-3)
    assert up.covariance[..., 2] == pytest.approx(-out.covariance[..., 2], abs=1e-3)
