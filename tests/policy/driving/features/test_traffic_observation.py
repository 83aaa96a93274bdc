"""What `gail` and `rail` see: beams that end at boxes, the lane, and where the route leads."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from litsim_policy.driving.features.scales import HEADING, LATERAL, LENGTH, SPEED, WIDTH
from litsim_policy.driving.features.traffic_observation import BEAM, BEAMS, OWN, RATE, ROAD, SIZE, WAY, TrafficObserver
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario

STRAIGHT = np.array([[0.0, -5.49], [900.0, -5.49]])


@pytest.fixture(scope="module")
def scenario(make_scenario: Any, track: Any) -> Scenario:
    return make_scenario(track(1, x=100.0))


def seen(
    scenario: Scenario, table: AgentTable, rows: IntArray | None = None, path: FloatArray = STRAIGHT
) -> FloatArray:
    rows = np.array([0]) if rows is None else rows
    agents = PathFollowers(scenario.lane_map, table, rows, PathBatch.of([path] * len(rows)))
    found = TrafficObserver(scenario.lane_map).observe(agents)
    assert found.shape == (len(rows), SIZE) and np.isfinite(found).all()
    return found


def beams(found: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances [m] and their rates [m/s], each (m, BEAMS)."""
    rest = found[:, OWN + ROAD + WAY :]
    return rest[:, :BEAMS] * BEAM, rest[:, BEAMS:] * RATE


def test_a_vehicle_ahead_and_one_beside(scenario: Scenario, agent_table: Any) -> None:
    own = {"id": 1, "x": 100.0, "y": -5.49, "yaw": 0.0, "speed": 10.0}
    ahead = {"id": 2, "x": 120.0, "y": -5.49, "yaw": 0.0, "speed": 7.0, "length": 4.0}
    beside = {"id": 3, "x": 100.0, "y": -2.0, "yaw": 0.0, "speed": 10.0, "width": 2.0}
    distance, rate = beams(seen(scenario, agent_table(0, own, ahead, beside)))
    assert distance[0, 0] == pytest.approx(18.0) and rate[0, 0] == pytest.approx(-3.0), "ahead, coming nearer"
    left = BEAMS // 4
    assert distance[0, left] == pytest.approx(3.49 - 1.0) and rate[0, left] == pytest.approx(0.0)
    assert distance[0, BEAMS // 2] == BEAM and rate[0, BEAMS // 2] == 0.0, "nobody is behind"


def test_beams_end_where_a_walk_along_them_enters_a_box(scenario: Scenario, agent_table: Any) -> None:
    random = np.random.default_rng(3)
    for _ in range(5):
        agents = [
            {
                "id": k + 1,
                "x": 100.0 + random.uniform(-30.0, 30.0),
                "y": -5.0 + random.uniform(-15.0, 15.0),
                "yaw": random.uniform(-3.0, 3.0),
                "speed": random.uniform(0.0, 15.0),
            }
            for k in range(6)
        ]
        table = agent_table(0, *agents)
        distance, rate = beams(seen(scenario, table, np.arange(6)))
        way = np.arange(0.0, BEAM, 0.02)
        for i in range(6):
            for k in range(BEAMS):
                turn = table.yaw[i] + 2.0 * np.pi * k / BEAMS
                x, y = table.x[i] + way * np.cos(turn), table.y[i] + way * np.sin(turn)
                hits = np.full(6, BEAM)
                for j in range(6):
                    cos, sin = np.cos(table.yaw[j]), np.sin(table.yaw[j])
                    along, left = (
                        (x - table.x[j]) * cos + (y - table.y[j]) * sin,
                        (y - table.y[j]) * cos - (x - table.x[j]) * sin,
                    )
                    inside = (np.abs(along) <= table.length[j] / 2) & (np.abs(left) <= table.width[j] / 2)
                    if j != i and inside.any():
                        hits[j] = way[np.argmax(inside)]
                assert distance[i, k] == pytest.approx(hits.min(), abs=0.05)
                if hits.min() < BEAM and np.sort(hits)[1] - hits.min() > 0.1:
                    j = int(np.argmin(hits))
                    apart = table.speed[[j, i]] * np.exp(1j * (table.yaw[[j, i]] - turn))
                    assert rate[i, k] == pytest.approx(apart[0].real - apart[1].real, abs=1e-9)


def test_nobody_sees_into_another_scene(scenario: Scenario, agent_table: Any) -> None:
    table = agent_table(0, {"id": 1, "x": 100.0, "y": -5.49}, {"id": 2, "x": 110.0, "y": -5.49})
    apart = replace(table, scene=np.arange(2))
    assert beams(seen(scenario, table))[0][0, 0] < BEAM
    assert (beams(seen(scenario, apart, np.arange(2)))[0] == BEAM).all()


def test_the_own_vehicle_its_lane_and_its_route(scenario: Scenario, agent_table: Any) -> None:
    own = {"id": 1, "x": 100.0, "y": -5.19, "yaw": 0.1, "speed": 9.0, "length": 4.0, "width": 1.8}
    (found,) = seen(scenario, agent_table(0, own))
    assert found[:OWN] == pytest.approx([4.0 / LENGTH, 1.8 / WIDTH, 9.0 / SPEED])
    assert found[OWN + 4] == pytest.approx(0.3 / LATERAL, abs=1e-6)
    assert found[OWN + 6] == pytest.approx(0.1 / HEADING, abs=1e-6)
    assert found[OWN + ROAD : OWN + ROAD + WAY] == pytest.approx([-0.1 / HEADING] * 2)
    bend = np.array([[0.0, -5.49], [107.0, -5.49], [107.0, 60.0]])
    (turns,) = seen(scenario, agent_table(0, own), path=bend)
    near, far = turns[OWN + ROAD : OWN + ROAD + WAY] * HEADING
    assert near == pytest.approx(-0.1) and far == pytest.approx(3.0 * HEADING), "to the left, as far as is told"


def test_nobody_to_look() -> None:
    table = AgentTable.empty(0)
    assert TrafficObserver(Scenario.load("demo").lane_map).observe(
        PathFollowers(Scenario.load("demo").lane_map, table, np.empty(0, np.int64), PathBatch.of([]))
    ).shape == (0, SIZE)
