"""Paths in a batch against each path alone, whatever the others are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_policy.motion.along_path import along_paths
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.path_batch import PathBatch
from litsim_policy.motion.reference_path import ReferencePath, pursuit_yaw_rate
from litsim_sim.core.scene import ARRAY_FIELDS, AgentTable
from litsim_sim.lane_map.lane_map import LaneMap
from made_lanes import polylines

several_paths = polylines().map(lambda lines: [ReferencePath(line) for line in lines])


def test_no_paths_and_no_places() -> None:
    assert len(PathBatch.of([]).each) == 0
    batch = PathBatch.of([np.array([[0.0, 0.0], [1.0, 0.0]])])
    assert batch.project(np.empty(0, np.int64), np.empty(0), np.empty(0)).s.shape == (0,)


@given(several_paths, st.integers(0, 2**32))
def test_in_each_of_several_scenes_vehicles_see_what_they_would_see_without_the_others(
    agent_table, paths, seed
) -> None:
    random = np.random.default_rng(seed)
    scenes = [
        agent_table(
            0,
            *(
                {"id": k, "x": x, "y": y, "yaw": yaw, "speed": speed}
                for k, (x, y, yaw, speed) in enumerate(random.normal(0.0, [60.0, 10.0, 1.0, 5.0], (size, 4)).tolist())
            ),
        )
        for size in (5, 12, 8)
    ]
    columns = {f: np.concatenate([getattr(scene, f) for scene in scenes]) for f in ARRAY_FIELDS[1:]}
    ids = np.arange(25)
    batch = PathBatch.of([path.points for path in paths])
    rows, path = random.permutation(len(ids))[:9], random.integers(len(paths), size=9)
    view = along_paths(batch, AgentTable(0, ids, **columns, scene=np.repeat(np.arange(3), (5, 12, 8))), rows, path=path)
    begin = np.array([0, 5, 17])
    for k, row in enumerate(rows.tolist()):
        at = int(np.searchsorted(begin, row, "right")) - 1
        alone = along_paths(batch, scenes[at], np.array([row - begin[at]]), path=path[k : k + 1])
        assert view.first[k] == begin[at] and (view.own_s[k], view.own_d[k]) == (alone.own_s[0], alone.own_d[0])
        for name in ("s", "d", "gap", "speed", "ahead", "aside", "in_path"):
            seen = getattr(view, name)
            assert seen.shape == (9, 12) and (seen[k, : len(scenes[at])] == getattr(alone, name)[0]).all(), name
        assert not view.ahead[k, len(scenes[at]) :].any() and (view.s[k, len(scenes[at]) :] == -np.inf).all()
    expected = [(k, column, view.first[k] + column) for k, column in np.argwhere(view.ahead).tolist()]
    assert list(view.pairs(view.ahead)) == expected


@pytest.fixture(scope="module")
def lane_map(make_scenario, track) -> LaneMap:
    return make_scenario(track(1, x=60.0)).lane_map


@given(several_paths, st.integers(0, 2**32))
def test_pursuits_are_those_of_each_vehicle_alone(lane_map, agent_table, paths, seed: int) -> None:
    random = np.random.default_rng(seed)
    agents = [
        {"id": k, "x": x, "y": y, "yaw": yaw, "speed": abs(speed)}
        for k, (x, y, yaw, speed) in enumerate(random.normal(0.0, [60.0, 10.0, 1.0, 5.0], (len(paths), 4)).tolist())
    ]
    table = agent_table(0, *agents)
    batch = PathBatch.of([path.points for path in paths])
    together = PathFollowers(lane_map, table, np.arange(len(paths)), batch)
    for row, path in enumerate(paths):
        pose = (float(values[row]) for values in (table.x, table.y, table.yaw, table.speed))
        assert together.path_yaw_rate[row] == pursuit_yaw_rate(path, *pose)
