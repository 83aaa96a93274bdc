"""Detection among those near somebody off the log gives what detection among everybody gives."""

from __future__ import annotations

import numpy as np
import pytest
from litsim_policy.conflict.agent_futures import AgentFutures
from litsim_policy.conflict.detection import ConflictDetector
from litsim_policy.conflict.scene import ConflictScene

from constant_motion import straight_on
from litsim_policy.conflict.config import ConflictConfig
from litsim_sim.core.scene import AgentTable

NOW, ROI = 5, 30.0


class CountingFutures(AgentFutures):
    """Notes of whom futures are made."""

    def __init__(self, log, config: ConflictConfig) -> None:
        super().__init__(log, config)
        self.made: list[list[int]] = []

    def logged(self, table: AgentTable, lag=None):
        self.made.append(table.id.tolist())
        return super().logged(table, lag)


@pytest.fixture
def crowd(make_scenario, track):
    """(detector, table): sixty agents over 600 m of road, some of them faster than those ahead."""
    rng = np.random.default_rng(11)
    tracks = [
        track(i, x=10.0 * i, y=float(rng.choice([-5.49, -9.15])), speed=float(rng.uniform(5, 20))) for i in range(1, 61)
    ]
    scenario = make_scenario(*tracks)
    detector = ConflictDetector(scenario.log, ROI, ConflictConfig())
    detector.futures = CountingFutures(scenario.log, ConflictConfig())
    return detector, scenario.log.table(NOW)


def test_answers_are_those_of_everybody(crowd) -> None:
    detector, table = crowd
    lag, rng = np.zeros(len(table), np.int64), np.random.default_rng(12)
    lag[rng.choice(len(table), 5, replace=False)] = 3
    logged = detector.futures.logged(table, lag)
    expected = detector.futures.expected(table, straight_on(table), lag == 0)
    expected.put(lag > 0, logged)
    found = 0
    for _ in range(10):
        off = rng.random(len(table)) < 0.1
        scene = ConflictScene(detector, table, straight_on(table), lag, lag > 0)
        for fresh in (off | (lag > 0), rng.random(len(table)) < 0.05):
            near, everybody = scene.detect(~off, fresh), detector.detect(table, ~off, fresh, logged, expected)
            assert [(c.agent, c.opponent, c.time_to_conflict, c.overlap_probability) for c in near] == [
                (c.agent, c.opponent, c.time_to_conflict, c.overlap_probability) for c in everybody
            ]
            assert all((a.pose == b.pose).all() for a, b in zip(near, everybody, strict=True))
            found += len(near)
        still = detector.still_in_conflict(table, off, off | (lag > 0), logged, expected)
        assert scene.still_in_conflict(off, off | (lag > 0)).tolist() == still.tolist()
    assert found > 0, "the crowd holds conflicts"


def test_futures_are_made_of_those_near_alone_and_when_asked_for(crowd) -> None:
    detector, table = crowd
    lag = np.zeros(len(table), np.int64)
    scene = ConflictScene(detector, table, straight_on(table), lag, lag > 0)
    assert detector.futures.made == []
    first, far = table.id == 20, table.id == 50
    scene.detect(~first, first)
    (near,) = detector.futures.made
    dx, dy = table.x - table.x[first], table.y - table.y[first]
    distance = np.hypot(dx, dy)
    nearer = -dx * (table.speed - table.speed[first]) / np.maximum(distance, 1e-9)  # everybody heads along x
    soon = distance - ConflictConfig().approach_time * np.maximum(nearer, 0.0)
    assert near == table.id[soon <= ROI].tolist() and (distance <= ROI).sum() < len(near) < len(table)
    scene.still_in_conflict(first, first)
    assert len(detector.futures.made) == 1, "what is made is not made again"
    scene.detect(~far, far)
    assert set(near) < set(detector.futures.made[1]) and 50 in detector.futures.made[1]
