"""Predicted and real conflicts of an ego that leaves its log, counted by hand."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from litsim_predictor.inference.contract import HORIZON
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.evaluation.conflicts import ConflictCounts, conflict_counts
from litsim_research.predictors.evaluation.drives import BRAKES, DriveKind, along_path, drives
from litsim_research.predictors.models.baselines import ConstantVelocity
from litsim_research.predictors.models.model import SceneModel
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import Scenario

EGO, OTHER = 1, 2
LAST = 120  # step, 12 s
HISTORY_STEPS = 30

Make = Callable[..., Scenario]


class Standing(SceneModel):
    """Expects everybody to stop at once."""

    def forward(self, batch: SceneBatch, decode: str | Tensor = "best") -> Prediction:
        b, n = batch.agent.shape
        return Prediction(
            torch.zeros(b, n, 1),
            torch.zeros(b, n, 1, HORIZON, 2),
            torch.ones(b, n, 1, HORIZON, 2),
            torch.zeros(b, n, 1, HORIZON),
        )


class Hasty(ConstantVelocity):
    """Expects twice the way."""

    def forward(self, batch: SceneBatch, decode: str | Tensor = "best") -> Prediction:
        prediction = super().forward(batch, decode)
        return Prediction(prediction.maneuver, 2.0 * prediction.mean, prediction.scale, prediction.correlation)


@pytest.fixture
def parked(make_scenario: Make, track: Any) -> Scenario:
    """The ego drives with 10 m/s towards a car that stands 80 m ahead; the boxes are 4.5 m long."""
    ego = track(EGO, x=20.0, speed=10.0, last=LAST)
    return make_scenario(ego, track(OTHER, x=100.0, speed=0.0, last=LAST), history_steps=HISTORY_STEPS)


def count(scenario: Scenario, model: SceneModel, kind: DriveKind = "keeps_speed", seed: int = 0) -> ConflictCounts:
    done: list[int] = []
    counts = conflict_counts({"it": model.eval()}, scenario, [EGO], seed, lambda: done.append(1))
    assert done == [1]
    return counts["it"][kind]


# Boxes meet 7.55 s after the start. Steps are looked at every 0.2 s from 5.0 s on, when the other is within 30 m, to
# 7.4 s, after which they have met: 13 steps, of which 5, 10 and then all see the contact within 1, 2 and 3 s. The
# drive ends at 12 s: a horizon of 5 s is known until 7.0 s only.
REAL = [5, 10, 13, 13, 11]


def test_an_exact_forecast_announces_every_conflict(parked: Scenario) -> None:
    counts = count(parked, ConstantVelocity())
    assert counts.hit.tolist() == REAL
    assert counts.false.tolist() == counts.missed.tolist() == [0] * 5
    assert counts.pairs.tolist() == [13, 13, 13, 13, 11]
    assert counts.to_json()["1"] == {"precision": 1.0, "recall": 1.0, "predicted": 5, "real": 5, "pairs": 13}


def test_a_forecast_that_stands_misses_every_conflict(parked: Scenario) -> None:
    counts = count(parked, Standing())
    assert counts.missed.tolist() == REAL
    assert counts.hit.tolist() == counts.false.tolist() == [0] * 5
    assert (counts.to_json()["5"]["precision"], counts.to_json()["5"]["recall"]) == (None, 0.0)


def test_a_forecast_that_hurries_announces_too_many(parked: Scenario) -> None:
    # Twice the way: within 1 s it goes 20 m, and meets the other from 5.6 s on: 10 steps of which 5 are real.
    counts = count(parked, Hasty())
    assert (counts.hit[0], counts.false[0], counts.missed[0]) == (5, 5, 0)
    assert counts.to_json()["1"]["precision"] == 0.5


def test_agents_beside_the_path_and_beyond_the_roi_are_in_no_conflict(
    make_scenario: Make, track: Any, lane_centres: tuple[float, ...]
) -> None:
    ego = track(EGO, x=20.0, speed=10.0, last=LAST)
    beside = track(OTHER, x=60.0, y=lane_centres[2], speed=0.0, last=LAST)
    far = track(3, x=200.0, speed=0.0, last=LAST)
    counts = count(make_scenario(ego, beside, far, history_steps=HISTORY_STEPS), ConstantVelocity())
    assert counts.pairs[0] > 0
    assert counts.hit.tolist() == counts.false.tolist() == counts.missed.tolist() == [0] * 5


def test_a_follower_by_log_runs_into_an_ego_that_brakes(make_scenario: Make, track: Any) -> None:
    ego = track(EGO, x=60.0, speed=10.0, last=LAST)
    follower = track(OTHER, x=50.0, speed=10.0, last=LAST)  # 5.5 m behind: 5 m/s less close that in 1.1 s + 1.25 s
    scenario = make_scenario(ego, follower, history_steps=HISTORY_STEPS)
    braking = count(scenario, ConstantVelocity(), "brakes")
    assert (braking.hit + braking.missed)[2] > 0
    assert braking.hit[0] > 0
    keeping = count(scenario, ConstantVelocity(), "keeps_speed")
    assert keeping.pairs[0] > 0
    assert keeping.hit.sum() == keeping.missed.sum() == keeping.false.sum() == 0


def test_counts_are_the_same_again_and_depend_on_the_seed(make_scenario: Make, track: Any) -> None:
    ego = track(EGO, x=60.0, speed=10.0, last=LAST)
    scenario = make_scenario(ego, track(OTHER, x=50.0, speed=10.0, last=LAST), history_steps=HISTORY_STEPS)
    runs = [vars(count(scenario, ConstantVelocity(), "brakes", seed)) for seed in (0, 0, 1)]
    np.testing.assert_equal(runs[0], runs[1])
    assert any((runs[0][name] != runs[2][name]).any() for name in runs[0])


# Drives


def test_a_brake_is_two_metres_per_second_squared_for_two_and_a_half_seconds(make_scenario: Make, track: Any) -> None:
    scenario = make_scenario(track(EGO, x=20.0, speed=10.0, last=LAST), history_steps=HISTORY_STEPS)
    keeps, *brakes = drives(scenario, EGO, np.random.default_rng(0))
    assert (keeps.kind, [drive.kind for drive in brakes]) == ("keeps_speed", ["brakes"] * BRAKES)
    for drive in brakes:
        start = int(np.argmax(drive.speed < 10.0)) - 1
        assert HISTORY_STEPS <= start <= LAST - 35
        assert drive.x[: start + 1].tolist() == scenario.log.x[0, : start + 1].tolist()
        assert drive.speed[start + 25 :] == pytest.approx(5.0)
        assert drive.x[start + 25] - drive.x[start] == pytest.approx(10.0 * 2.5 - 0.5 * 2.0 * 2.5**2)
        assert drive.y == pytest.approx(scenario.log.y[0, 0])
        assert len(drive.x) == LAST + 1


def test_an_ego_that_keeps_its_speed_where_its_log_brakes_ends_with_its_path(make_scenario: Make, track: Any) -> None:
    # The log goes 10 t - t^2 / 4: 84 m in 12 s.
    scenario = make_scenario(track(EGO, x=20.0, speed=10.0, acceleration=-0.5, last=LAST), history_steps=HISTORY_STEPS)
    keeps = drives(scenario, EGO, np.random.default_rng(0))[0]
    speed = 10.0 - 0.5 * 3.0
    gone_at_3 = 10.0 * 3.0 - 0.25 * 3.0**2
    whole = 10.0 * 12.0 - 0.25 * 12.0**2
    assert keeps.speed[HISTORY_STEPS:] == pytest.approx(speed)
    assert keeps.x[50] == pytest.approx(20.0 + gone_at_3 + speed * 2.0)
    assert len(keeps.x) == int((3.0 + (whole - gone_at_3) / speed) / 0.1) + 1


def test_nobody_reverses_and_a_path_with_a_stop_is_followed(make_scenario: Make, track: Any) -> None:
    scenario = make_scenario(
        track(EGO, x=20.0, speed=6.0, acceleration=-0.5, last=LAST), history_steps=HISTORY_STEPS
    )  # stands at the end
    hard = along_path(scenario.log, 0, "brakes", HISTORY_STEPS, np.full(LAST, -2.0))
    assert hard.speed.min() == 0.0
    assert (np.diff(hard.x) >= 0.0).all()
    assert hard.x[-1] == pytest.approx(hard.x[60])
    assert np.isfinite(hard.x).all() and np.isfinite(hard.yaw).all()


def test_an_ego_that_is_not_there_is_an_error(parked: Scenario) -> None:
    with pytest.raises(InputError, match="no vehicle 99"):
        drives(parked, 99, np.random.default_rng(0))
