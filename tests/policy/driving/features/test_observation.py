"""What policy C sees, on a straight road where every number can be told."""

from dataclasses import replace

import numpy as np
import pytest

from litsim_policy.driving.features.lanes import ROAD
from litsim_policy.driving.features.observation import CORE, ObservationConfig, Observer
from litsim_policy.driving.features.scales import (
    ACCELERATION,
    DISTANCE,
    EDGE,
    HEADING,
    LATERAL,
    LENGTH,
    LIMIT,
    SPEED,
    TIME,
    WIDTH,
)
from litsim_policy.driving.features.surrounding import SLOT
from litsim_policy.driving.features.way import AHEAD, AHEAD_FEATURES, WAY_FEATURES
from litsim_policy.driving.safety import comfort
from litsim_policy.driving.task import DrivingTask
from litsim_policy.motion.reference_path import ReferencePath, window
from litsim_sim.scenario.scenario import Scenario

NOW = 20


@pytest.fixture(scope="module")
def scenario(make_scenario, track) -> Scenario:
    return make_scenario(track(1, x=200.0), track(2, x=60.0))


def straight(y: float) -> ReferencePath:
    return ReferencePath.through(np.column_stack([np.arange(0.0, 300.0), np.full(300, y)]))


def task(agent: int, y: float, goal_x: float = 150.0, due: int = NOW + 25, opponent: int = -1) -> DrivingTask:
    return DrivingTask(agent, straight(y), np.array([goal_x, y]), due, opponent)


def groups(features: np.ndarray, slots: int = 8) -> dict[str, np.ndarray]:
    """The features of one agent by group; surrounding (slots, SLOT)."""
    ends = np.cumsum([CORE, SLOT * slots, ROAD])
    core, around, road, way = np.split(features, ends)
    return {"core": core, "around": around.reshape(slots, SLOT), "road": road, "way": way}


def way(features: np.ndarray, slots: int = 8) -> dict[str, float]:
    return dict(zip(WAY_FEATURES, groups(features, slots)["way"].tolist(), strict=True))


def test_core_and_road(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[1] + 0.5
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y, "yaw": 0.1, "speed": 12.0, "acceleration": -1.5})
    observer = Observer(scenario.lane_map)
    seen = groups(observer.observe(table, [task(2, lane_centres[1])])[0])
    assert seen["core"] == pytest.approx([4.5 / LENGTH, 2.0 / WIDTH, 12.0 / SPEED, -1.5 / ACCELERATION])
    left, right, road_left, road_right, offset, curvature, heading = seen["road"]
    assert left * LATERAL == pytest.approx(1.83 - 0.5, abs=0.02)
    assert right * LATERAL == pytest.approx(1.83 + 0.5, abs=0.02)
    assert road_left * EDGE == pytest.approx(-y, abs=0.05)  # the left edge of the road is at y = 0
    assert road_right * EDGE > 3.0 * 3.6
    assert offset * LATERAL == pytest.approx(0.5, abs=0.02)
    assert curvature == pytest.approx(0.0, abs=1e-6) and heading * HEADING == pytest.approx(0.1, abs=1e-6)


def test_sectors_begin_ahead_and_go_counter_clockwise(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[2]
    others = [
        {"id": 1, "x": 130.0, "y": y, "speed": 6.0},  # ahead
        {"id": 3, "x": 145.0, "y": y},  # ahead as well, but farther: not seen
        {"id": 4, "x": 100.0, "y": lane_centres[1], "yaw": 0.2},  # left
        {"id": 5, "x": 80.0, "y": y},  # behind
        {"id": 6, "x": 100.0, "y": lane_centres[3]},  # right
    ]
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y}, *others)
    around = groups(Observer(scenario.lane_map).observe(table, [task(2, y)])[0])["around"]
    assert np.flatnonzero(around[:, 0]).tolist() == [0, 2, 4, 6]
    assert (around[[1, 3, 5, 7]] == 0.0).all()
    assert around[0, 1] * DISTANCE == pytest.approx(30.0) and around[0, 2] * SPEED == pytest.approx(6.0)
    assert around[0, 3:5] == pytest.approx([0.0, 1.0])
    assert around[2, 3:5] == pytest.approx([1.0, 0.0], abs=1e-9)
    assert around[2, 5:7] == pytest.approx([np.sin(0.2), np.cos(0.2)])
    assert around[6, 3] == pytest.approx(-1.0)


def test_the_way(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[2]
    table = agent_table(
        NOW,
        {"id": 2, "x": 100.0, "y": y - 0.6, "yaw": 0.05, "speed": 10.0},
        {"id": 1, "x": 120.0, "y": y, "speed": 4.0},
        {"id": 7, "x": 110.0, "y": lane_centres[1], "speed": 13.0},
    )
    seen = way(Observer(scenario.lane_map).observe(table, [task(2, y, opponent=7)])[0])
    assert seen["offset from the path"] * LATERAL == pytest.approx(-0.6)
    assert seen["heading to the path"] * HEADING == pytest.approx(-0.05)
    assert seen["gap to the leader"] * DISTANCE == pytest.approx(20.0 - 4.5)
    assert seen["speed of the leader less the own"] * SPEED == pytest.approx(-6.0)
    assert seen["distance to the goal along the path"] * DISTANCE == pytest.approx(50.0)
    assert seen["time until the agent was expected at the goal"] * TIME == pytest.approx(2.5)
    assert seen["opponent present"] == 1.0 and seen["opponent to the left"] > 0.8
    alone = way(Observer(scenario.lane_map).observe(table, [task(2, y, opponent=99)])[0])
    assert alone["opponent present"] == alone["opponent ahead"] == 0.0


def test_how_those_ahead_drive(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[2]
    config = ObservationConfig(ahead=True)
    others = [
        {"id": 1, "x": 120.0, "y": y, "speed": 8.0, "acceleration": -2.0},  # first, from 2.25 m ahead of the agent on
        {"id": 3, "x": 121.0, "y": y + 1.0, "speed": 8.0, "acceleration": 1.0},  # beside the first: no second
        {"id": 4, "x": 135.0, "y": y, "speed": 6.0, "acceleration": -3.0},  # second
        {"id": 5, "x": 150.0, "y": y, "speed": 1.0, "acceleration": -4.0},
    ]
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y, "speed": 10.0}, *others)
    observer = Observer(scenario.lane_map, config)
    row = observer.observe(table, [task(2, y)])[0]
    seen = dict(zip(AHEAD_FEATURES, row[config.ahead_at : config.ahead_at + AHEAD].tolist(), strict=True))
    assert seen["acceleration of the leader"] * ACCELERATION == pytest.approx(-2.0)
    assert seen["second leader present"] == 1.0
    assert seen["gap to the second leader"] * DISTANCE == pytest.approx(35.0 - 4.5)
    assert seen["speed of the second leader less the own"] * SPEED == pytest.approx(-4.0)
    assert seen["acceleration of the second leader"] * ACCELERATION == pytest.approx(-3.0)
    usual = Observer(scenario.lane_map).observe(table, [task(2, y)])[0]
    assert (np.delete(row, np.s_[config.ahead_at : config.ahead_at + AHEAD]) == usual).all()
    # the leader stops after 16 m, so that 10 m/s have to be lost on 15.5 - 1 + 16 m
    allowed = seen["safe acceleration behind the leaders"] * ACCELERATION
    assert allowed == pytest.approx(-(10.0**2) / (2.0 * (15.5 - 1.0 + 8.0**2 / (2.0 * 2.0))), abs=0.01)


def test_where_nobody_is_ahead_nobody_brakes(scenario, agent_table, lane_centres) -> None:
    y, config = lane_centres[2], ObservationConfig(ahead=True)
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y}, {"id": 1, "x": 80.0, "y": y, "acceleration": -4.0})
    row = Observer(scenario.lane_map, config).observe(table, [task(2, y)])[0]
    seen = row[config.ahead_at : config.ahead_at + AHEAD]
    assert seen.tolist() == [0.0, comfort.ACCELERATION_MAX / ACCELERATION, 0.0, 0.0, 0.0, 0.0]


def test_features_are_cut(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[2]
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y, "speed": 90.0, "length": 40.0})
    seen = Observer(scenario.lane_map).observe(table, [task(2, y, goal_x=100_000.0, due=10**6)])
    assert np.isfinite(seen).all() and np.abs(seen).max() == LIMIT


def test_nobody_to_observe(scenario, agent_table) -> None:
    table = agent_table(NOW, {"id": 2})
    assert Observer(scenario.lane_map).observe(table, []).shape == (0, ObservationConfig().size)


def test_a_window_of_a_path_changes_nothing_near(scenario, agent_table, lane_centres) -> None:
    y = lane_centres[2]
    table = agent_table(NOW, {"id": 2, "x": 100.0, "y": y + 0.4}, {"id": 1, "x": 125.0, "y": y})
    whole = task(2, y)
    part = replace(whole, path=window(whole.path, 100.0, y))
    assert len(part.path.s) < len(whole.path.s)
    observer = Observer(scenario.lane_map)
    assert observer.observe(table, [part]) == pytest.approx(observer.observe(table, [whole]))


@pytest.mark.parametrize("seed", range(2))
def test_the_surrounding_is_what_going_through_all_others_one_by_one_gives(
    scenario, agent_table, lane_centres, seed: int
) -> None:
    random, config = np.random.default_rng(seed), ObservationConfig(6, 40.0)
    places = np.column_stack([100.0 + 60.0 * random.random(25), random.choice(lane_centres, 25)])
    agents = [
        {"id": k, "x": x, "y": y, "yaw": random.normal(0.0, 0.3), "speed": 10.0 * random.random()}
        for k, (x, y) in enumerate(places.tolist())
    ]
    table = agent_table(NOW, *agents)
    tasks = [task(k, lane_centres[1]) for k in range(0, 25, 4)]
    features = Observer(scenario.lane_map, config).observe(table, tasks)
    for own, row in zip(range(0, 25, 4), features, strict=True):
        expected = np.zeros((6, SLOT))
        near: list[tuple[float, int, list[float]]] = []
        for j in range(25):
            dx, dy, yaw = table.x[j] - table.x[own], table.y[j] - table.y[own], table.yaw[own]
            if j == own or np.hypot(dx, dy) > 40.0:
                continue
            ahead, left = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
            turn, bearing = table.yaw[j] - yaw, np.arctan2(left, ahead)
            apart = np.hypot(ahead + 2.25 * np.cos(turn) - 2.25, left + 2.25 * np.sin(turn))
            directions = [np.sin(bearing), np.cos(bearing), np.sin(turn), np.cos(turn)]
            sector = int(np.floor(bearing / (2 * np.pi / 6) + 0.5)) % 6
            near.append((apart, sector, [1.0, apart / DISTANCE, table.speed[j] / SPEED, *directions]))
        near.sort(key=lambda found: found[0])
        for _, sector, values in reversed(near):
            expected[sector] = values
        assert groups(row, 6)["around"] == pytest.approx(expected, abs=1e-12)
