"""The look ahead against the same said plainly: one agent, one command, one instant, one other at a time."""

import numpy as np
import pytest

from litsim_policy.driving.look_ahead import SETTLE, first_touch, rolled_out, steps_of
from litsim_sim.core.geometry import boxes_overlap, to_body
from litsim_sim.core.scene import STEP_S, AgentTable

INSTANTS, MARGIN = 15, 0.15


@pytest.fixture(params=range(3))
def crowd(request, agent_table, lane_centres) -> tuple[AgentTable, np.ndarray, np.ndarray]:
    """Twenty agents close together on three lanes, rows of six of them, and four commands for each of those."""
    random = np.random.default_rng(request.param)
    agents = [
        {
            "id": k,
            "x": 100.0 + 60.0 * random.random(),
            "y": lane_centres[k % 3] + random.normal(0.0, 0.5),
            "yaw": random.normal(0.0, 0.1) + np.pi * (random.random() < 0.1),
            "speed": 12.0 * random.random(),
            "acceleration": random.normal(0.0, 2.0),
            "width": 1.6 + random.random(),
            "length": 3.0 + 4.0 * random.random(),
        }
        for k in range(20)
    ]
    rows = np.sort(random.permutation(20)[:6])
    return agent_table(0, *agents), rows, random.normal(0.0, [3.0, 0.3], (6, 4, 2))


def one(table: AgentTable, row: int, *names: str) -> tuple[float, ...]:
    return tuple(float(getattr(table, name)[row]) for name in names)


def touch(table: AgentTable, own: int, poses: np.ndarray) -> float:
    """Time [s] of the first touch of the agent in row `own` that goes along `poses` (3, T)."""
    x, y, yaw, speed, length, width = one(table, own, "x", "y", "yaw", "speed", "length", "width")

    def hits(dx: float, dy: float, own_yaw: float, other_yaw: float, size: tuple[float, float], margin: float) -> bool:
        grown = np.array(size[0] + 2 * margin), np.array(size[1] + 2 * margin)
        angles = np.array(own_yaw), np.array(other_yaw)
        return bool(boxes_overlap(np.array(dx), np.array(dy), *angles, (np.array(length), np.array(width)), grown))

    found = np.inf
    for j in range(len(table)):
        other_x, other_y, other_yaw, other_speed = one(table, j, "x", "y", "yaw", "speed")
        (acceleration,), size = one(table, j, "acceleration"), one(table, j, "length", "width")
        ahead, left = to_body(np.array(other_x - x), np.array(other_y - y), np.array(yaw))
        behind = ahead < -0.5 * (length + size[0]) and abs(left) < 0.5 * (width + size[1])
        far = np.hypot(other_x - x, other_y - y) >= length + size[0] + (speed + other_speed) * STEP_S * INSTANTS
        now = other_x - x, other_y - y, yaw, other_yaw, size
        if j == own or far or behind or hits(*now, 0.0):
            continue
        margin = 0.0 if hits(*now, MARGIN) else MARGIN
        for k in range(INSTANTS):
            time = STEP_S * (k + 1)
            going = min(time, other_speed / -acceleration) if acceleration < -1e-3 else time
            gone = other_speed * going + 0.5 * min(acceleration, 0.0) * going**2
            dx, dy = other_x + gone * np.cos(other_yaw) - poses[0, k], other_y + gone * np.sin(other_yaw) - poses[1, k]
            if hits(dx, dy, poses[2, k], other_yaw, size, margin):
                found = min(found, time)
    return found


def test_agents_go_where_their_commands_lead(crowd) -> None:
    table, rows, commands = crowd
    poses = rolled_out(table, rows, commands, INSTANTS)
    for i, row in enumerate(rows.tolist()):
        for c, (acceleration, yaw_rate) in enumerate(commands[i].tolist()):
            x, y, yaw, speed = one(table, row, "x", "y", "yaw", "speed")
            for k in range(INSTANTS):
                time = STEP_S * (k + 1)
                heading = yaw + yaw_rate * SETTLE * (1.0 - np.exp(-time / SETTLE))
                x += STEP_S * max(0.0, speed + acceleration * time) * np.cos(heading)
                y += STEP_S * max(0.0, speed + acceleration * time) * np.sin(heading)
                assert poses[:, i, c, k] == pytest.approx([x, y, heading], abs=1e-9)


def test_the_first_touch_is_that_of_each_pair_and_instant(crowd) -> None:
    table, rows, commands = crowd
    poses = rolled_out(table, rows, commands, INSTANTS)
    found = first_touch(table, rows, poses, MARGIN)
    expected = [[touch(table, row, poses[:, i, c]) for c in range(4)] for i, row in enumerate(rows.tolist())]
    assert found == pytest.approx(np.array(expected))
    assert np.isfinite(found).any()


@pytest.mark.parametrize(("gap", "expected"), [(-0.1, np.inf), (0.05, 0.3), (0.09, 0.5), (0.19, 0.3)])
def test_who_is_nearer_than_the_margin_still_counts(agent_table, gap: float, expected: float) -> None:
    """An agent creeps at 0.2 m/s towards one that stands `gap` ahead: guarded until the boxes touch."""
    table = agent_table(0, {"id": 1, "x": 0.0, "speed": 0.2}, {"id": 2, "x": 4.5 + gap, "speed": 0.0})
    rows = np.array([0])
    poses = rolled_out(table, rows, np.zeros((1, 1, 2)), 15)
    assert first_touch(table, rows, poses, 0.15)[0, 0] == pytest.approx(expected)


def test_looking_ahead_takes_a_step_at_least() -> None:
    assert [steps_of(seconds) for seconds in (0.0, 0.1, 0.8, 1.5)] == [1, 1, 8, 15]


def test_many_at_once_touch_whom_each_touches_alone(agent_table) -> None:
    """So many that not all of them are compared with each other."""
    random = np.random.default_rng(5)
    x, y, yaw = random.uniform(0.0, 400.0, 120), random.uniform(-9.0, 9.0, 120), random.normal(0.0, 0.3, 120)
    speed = random.uniform(0.0, 20.0, 120)
    agents = ({"id": k, "x": x[k], "y": y[k], "yaw": yaw[k], "speed": speed[k]} for k in range(120))
    table, rows = agent_table(0, *agents), np.arange(100)
    poses = rolled_out(table, rows, np.zeros((100, 1, 2)), INSTANTS)
    together = first_touch(table, rows, poses, MARGIN)[:, 0]
    each = (np.ascontiguousarray(poses[:, i : i + 1]) for i in range(100))
    alone = [first_touch(table, rows[i : i + 1], own, MARGIN)[0, 0] for i, own in enumerate(each)]
    np.testing.assert_array_equal(together, alone)
    assert 5 < np.isfinite(together).sum() < 95
