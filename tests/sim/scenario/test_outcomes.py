"""What happened in a run: motion, and whose log met whom; written, and read for one scene and for several."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import Controller
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.outcomes import RecordedOutcomes, file_of
from litsim_sim.scenario.scenario import Scenario

Make = Callable[..., Any]
IDS = np.array([1, 2, 3])


def three(table: Make, k: int, ego: float, second: float, controller: Controller = Controller.LOG) -> Any:
    rows = ({"id": 2, "x": second, "y": 0.0, "controller": controller}, {"id": 3, "x": 100.0, "y": 0.0})
    return table(k, {"id": 1, "x": ego, "y": 0.0}, *rows)


def test_the_log_of_one_who_yields_meets_the_ego(table: Make) -> None:
    log = [three(table, k, 50.0 + k, 2.0 * k) for k in range(60)]
    run = [three(table, k, 50.0, min(2.0 * k, 40.0), Controller.POLICY) for k in range(60)]
    found = RecordedOutcomes.of_run(IDS, run, log, ego_id=1)
    assert found.pose[1, 30].tolist() == [40.0, 0.0, 0.0] and found.there.all()
    met = found.meetings[(found.meetings[:, 0] == 1) & (found.meetings[:, 2] == 0)]
    assert met[:, 1].tolist() == [24, 25, 26], "its log passes the ego, which stands at 50 m"
    assert not (found.meetings[:, 0] == found.meetings[:, 2]).any(), "nobody meets himself"


def test_scenes_are_read_in_the_order_of_their_logs(tmp_path: Path) -> None:
    scenes = [Scenario.load("demo", simulation_s=1.0).around(ego, 0) for ego in (7, 1)]
    for k, scene in enumerate(scenes):
        agents = len(scene.log.ids)
        pose, meetings = np.full((agents, 4 + k, 3), float(k)), np.array([[k, 2, 5]])
        RecordedOutcomes(pose, np.ones((agents, 4 + k), np.bool_), meetings).write(file_of(tmp_path, scene))
    both = RecordedOutcomes.read(tmp_path, BatchedScenario.of(scenes))
    first = len(scenes[0].log.ids)
    assert both.there.shape == (2 * first, 5)
    assert not both.there[0, 4] and both.there[first, 4]
    assert both.pose[first, 0, 0] == 1.0 and both.pose[first - 1, 0, 0] == 0.0
    assert both.meetings.tolist() == [[0, 2, 5], [first + 1, 2, first + 5]]
    one = RecordedOutcomes.read(tmp_path, scenes[1])
    assert one.meetings.tolist() == [[1, 2, 5]]


def test_a_file_that_is_missing_or_of_another_log(tmp_path: Path) -> None:
    scene = Scenario.load("demo", simulation_s=1.0)
    with pytest.raises(InputError, match="cannot be read as what happened"):
        RecordedOutcomes.read(tmp_path, scene)
    RecordedOutcomes(np.zeros((2, 4, 3)), np.ones((2, 4), np.bool_), np.empty((0, 3), np.int64)).write(
        file_of(tmp_path, scene)
    )
    with pytest.raises(InputError, match=f"2 agents, expected the {len(scene.log.ids)} of the log"):
        RecordedOutcomes.read(tmp_path, scene)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    scene = Scenario.load("demo", simulation_s=1.0)
    path, agents = file_of(tmp_path, scene), len(scene.log.ids)
    RecordedOutcomes(np.ones((agents, 40, 3)), np.ones((agents, 40), np.bool_), np.empty((0, 3), np.int64)).write(path)
    whole = path.read_bytes()
    alone = tmp_path / "array.npy"
    np.save(alone, np.zeros(3))
    flipped = whole[:100] + bytes([whole[100] ^ 255]) + whole[101:]
    for content in (b"", whole[: len(whole) // 2], flipped, alone.read_bytes(), b"no archive"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="cannot be read as what happened"):
            RecordedOutcomes.read(tmp_path, scene)
