"""Detection among those near somebody off the log gives what detection among everybody gives."""

from __future__ import annotations

import numpy as np
import pytest

from litsim_policy.conflict.detection import ConflictConfig, ConflictDetector
from litsim_policy.conflict.scene import ConflictScene
from litsim_predictor.forecast import Forecast
from litsim_sim.core.scene import AgentTable

NOW, ROI = 5, 30.0


def straight_on(table: AgentTable) -> Forecast:
    """Everybody goes on as it moves now, with a spread of 1 m by 0.5 m."""
    t = 0.2 * np.arange(1, 26)
    heading = np.stack([np.cos(table.yaw), np.sin(table.yaw)], axis=-1)
    return Forecast(
        step=table.step,
        dt=0.2,
        id=table.id,
        mean=np.stack([table.x, table.y], axis=-1)[:, None] + (table.speed[:, None] * t)[..., None] * heading[:, None],
        yaw=np.repeat(table.yaw[:, None], len(t), axis=1).astype(np.float32),
        covariance=np.full((len(table), len(t), 3), [1.0, 0.5, 0.0], np.float32),
        maneuver_probability=np.empty((len(table), 0), np.float32),
        valid=np.ones(len(table), np.bool_),
    )


class CountingDetector(ConflictDetector):
    """Notes whose futures are made."""

    def __init__(self, log, roi_m: float, config: ConflictConfig) -> None:
        super().__init__(log, roi_m, config)
        self.made: list[list[int]] = []

    def logged_future(self, table: AgentTable, lag=None):
        self.made.append(table.id.tolist())
        return super().logged_future(table, lag)


@pytest.fixture
def crowd(make_scenario, track):
    """(detector, table): sixty agents over 600 m of road, some of them faster than those ahead."""
    rng = np.random.default_rng(11)
    tracks = [
        track(i, x=10.0 * i, y=float(rng.choice([-5.49, -9.15])), speed=float(rng.uniform(5, 20))) for i in range(1, 61)
    ]
    scenario = make_scenario(*tracks)
    return CountingDetector(scenario.log, ROI, ConflictConfig()), scenario.log.table(NOW)


def test_answers_are_those_of_everybody(crowd) -> None:
    detector, table = crowd
    lag, rng = np.zeros(len(table), np.int64), np.random.default_rng(12)
    lag[rng.choice(len(table), 5, replace=False)] = 3
    logged = detector.logged_future(table, lag)
    expected = detector.expected_future(table, straight_on(table), lag == 0)
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
    assert detector.made == []
    first, far = table.id == 20, table.id == 50
    scene.detect(~first, first)
    (near,) = detector.made
    dx, dy = table.x - table.x[first], table.y - table.y[first]
    distance = np.hypot(dx, dy)
    nearer = -dx * (table.speed - table.speed[first]) / np.maximum(distance, 1e-9)  # everybody heads along x
    soon = distance - ConflictConfig().approach_time * np.maximum(nearer, 0.0)
    assert near == table.id[soon <= ROI].tolist() and (distance <= ROI).sum() < len(near) < len(table)
    scene.still_in_conflict(first, first)
    assert len(detector.made) == 1, "what is made is not made again"
    scene.detect(~far, far)
    assert set(near) < set(detector.made[1]) and 50 in detector.made[1]
