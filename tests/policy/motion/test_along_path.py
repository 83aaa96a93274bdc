"""Who is ahead on a path, in the way, and how far."""

import numpy as np
import pytest

from litsim_policy.motion.along_path import MERGE, SIGHT, AlongPath, ahead_in_path, along_paths
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.scene import AgentTable

STRAIGHT = ReferencePath(np.column_stack([np.arange(-50.0, 400.0), np.zeros(450)]))


def along_path(path: ReferencePath, table: AgentTable, row: int, **options: float) -> AlongPath:
    """How the agent in `row`, on `path`, sees all agents; arrays (w,)."""
    return AlongPath(*(values[0] for values in along_paths(path.batch, table, np.array([row]), **options)))


def seen(agent_table, other: dict, **own: float) -> tuple[AlongPath, int]:
    """How agent 1, at the origin of a straight path along +x, sees agent 2; and the row of agent 2."""
    return along_path(STRAIGHT, agent_table(0, {"id": 1, **own}, {"id": 2, **other}), 0), 1


@pytest.mark.parametrize(
    ("what", "other", "ahead", "in_path", "gap", "speed"),
    [
        ("a leader", {"x": 20.0, "speed": 7.0}, True, True, 15.5, 7.0),
        ("a follower", {"x": -20.0, "speed": 7.0}, False, True, -24.5, 7.0),
        ("alongside, slightly ahead", {"x": 1.0, "y": 3.66, "speed": 9.0}, True, False, -3.5, 9.0),
        ("a leader in the next lane", {"x": 20.0, "y": 3.66, "speed": 9.0}, True, False, 15.5, 9.0),
        ("a mirror that reaches in", {"x": 20.0, "y": 2.1, "speed": 9.0}, True, True, 15.5, 9.0),
        ("just outside of the margin", {"x": 20.0, "y": 2.3, "speed": 9.0}, True, False, 15.5, 9.0),
        ("oncoming", {"x": 30.0, "yaw": np.pi, "speed": 6.0}, True, True, 25.5, -6.0),
        ("across the path", {"x": 20.0, "y": 3.0, "yaw": np.pi / 2, "speed": 6.0}, True, True, 16.75, 0.0),
        ("slanted by a box beside it", {"x": 20.0, "y": 2.6, "yaw": 0.5, "speed": 6.0}, True, True, 15.3, 5.27),
    ],
)
def test_golden_scenes_on_a_path(
    agent_table, what: str, other: dict, ahead: bool, in_path: bool, gap: float, speed: float
) -> None:
    view, row = seen(agent_table, other)
    assert (bool(view.ahead[row]), bool(view.in_path[row])) == (ahead, in_path), what
    assert view.gap[row] == pytest.approx(gap, abs=0.01) and view.speed[row] == pytest.approx(speed, abs=0.01)


def test_someone_beside_the_path_is_in_the_way_of_a_vehicle_that_is_off_it(agent_table) -> None:
    on_path, row = seen(agent_table, {"x": 8.0, "y": 3.5})
    off_path, _ = seen(agent_table, {"x": 8.0, "y": 3.5}, y=3.5)
    assert not on_path.in_path[row] and off_path.in_path[row]
    later, _ = seen(agent_table, {"x": 40.0, "y": 3.5}, y=3.5)
    assert not later.in_path[row], "by then it has come onto the path"


def test_gaps_run_along_a_bend(agent_table) -> None:
    angle = np.arange(0.0, 1.5, 0.01)
    bend = ReferencePath(50.0 * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]))
    at = {"x": 50.0 * np.sin(1.0), "y": 50.0 * (1.0 - np.cos(1.0)), "yaw": 1.0, "speed": 5.0}
    view = along_path(bend, agent_table(0, {"id": 1}, {"id": 2, **at}), 0)
    assert view.ahead[1] and view.in_path[1]
    assert view.gap[1] == pytest.approx(50.0 - 4.5, abs=0.05) and view.speed[1] == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize("seed", range(2))
def test_what_is_seen_is_what_each_agents_place_on_the_path_gives(agent_table, seed: int) -> None:
    random = np.random.default_rng(seed)
    turns = np.cumsum(random.normal(0.0, 0.05, 200))
    path = ReferencePath(np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]), axis=0))
    places = path.points[random.integers(0, 200, 30)] + random.normal(0.0, 4.0, (30, 2))
    agents = [
        {"id": k, "x": x, "y": y, "yaw": random.normal(0.0, 2.0), "speed": 10.0 * random.random()}
        for k, (x, y) in enumerate(places.tolist())
    ]
    table = agent_table(0, *agents)
    own = int(np.argmin(path.project(table.x, table.y)[0]))  # so that somebody is ahead
    view = along_path(path, table, own, margin=0.3)
    (own_s,), (own_d,) = path.project(table.x[[own]], table.y[[own]])
    seen = 0
    for j in range(30):
        if np.hypot(table.x[j] - table.x[own], table.y[j] - table.y[own]) >= SIGHT:
            assert not view.ahead[j] and not view.in_path[j] and view.s[j] == -np.inf
            continue
        seen += 1
        (s,), (d,) = path.project(table.x[[j]], table.y[[j]])
        turn = table.yaw[j] - path.heading(np.array([s]))[0]
        along, across = abs(np.cos(turn)), abs(np.sin(turn))
        half_along, half_across = 0.5 * (4.5 * along + 2.0 * across), 0.5 * (4.5 * across + 2.0 * along)
        assert (view.s[j], view.d[j]) == (s, d)
        assert view.gap[j] == pytest.approx(s - half_along - own_s - 2.25)
        assert view.speed[j] == pytest.approx(table.speed[j] * np.cos(turn))
        assert view.ahead[j] == (s > own_s and j != own)
        strip = own_d * min(max(1.0 - (s - own_s) / MERGE, 0.0), 1.0)
        aside = abs(d - strip) - half_across - 1.0
        assert view.aside[j] == pytest.approx(aside)
        assert view.in_path[j] == (aside < 0.3)
    assert 5 < seen < 30 and view.in_path[view.ahead].any()


@pytest.mark.parametrize("bends", [0.0, 0.05, 0.4, 1.2])
def test_who_leads_is_whom_the_whole_view_shows_ahead_and_in_the_path(agent_table, bends: float) -> None:
    """On straight paths, winding ones, and such with sharp corners; some vehicles are beside theirs."""
    random = np.random.default_rng(3)
    places = random.uniform(-60.0, 60.0, (120, 2))
    agents = [
        {"id": k, "x": x, "y": y, "yaw": random.uniform(-3.0, 3.0), "speed": 10.0 * random.random()}
        for k, (x, y) in enumerate(places.tolist())
    ]
    table, rows, paths = agent_table(0, *agents), np.arange(60), []
    for row in rows:
        turns = table.yaw[row] + np.cumsum(random.normal(0.0, bends, 60))
        steps = np.cumsum(2.0 * np.column_stack([np.cos(turns), np.sin(turns)]), axis=0)
        paths.append(places[row] + steps + random.normal(0.0, 1.0, 2))
    batch, poses = PathBatch.of(paths), (table.x[rows], table.y[rows], table.yaw[rows])
    view, (ahead, own_s, own_d) = along_paths(batch, table, rows), ahead_in_path(batch, table, rows, poses)
    np.testing.assert_array_equal(ahead.leads, view.ahead & view.in_path)
    for name in ("gap", "speed"):
        np.testing.assert_array_equal(getattr(ahead, name)[ahead.leads], getattr(view, name)[ahead.leads])
    for one, other in ((ahead.first, view.first), (own_s, view.own_s), (own_d, view.own_d)):
        np.testing.assert_array_equal(one, other)
    assert 100 < ahead.leads.sum() < 0.5 * ahead.leads.size
