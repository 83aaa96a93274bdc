"""Measures of forecasts on cases whose answers are known."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal
from torch import Tensor

from litsim_predictor.inference.contract import DT, HISTORY, HORIZON
from litsim_predictor.inference.joint.units import TRAFFIC_CHANNELS
from litsim_research.predictors.data.batch import Prediction, SceneBatch
from litsim_research.predictors.evaluation.boxes import path_headings
from litsim_research.predictors.evaluation.scores import SCENE_SAMPLES, ScoreBoard, Scores, scored_agents
from litsim_sim.core.errors import InputError

STEPS = torch.arange(1, HORIZON + 1, dtype=torch.float32)
LENGTH, WIDTH = 4.0, 2.0


def drive(speed: float) -> Tensor:
    """(HORIZON, 2) straight ahead."""
    return torch.stack([speed * DT * STEPS, torch.zeros(HORIZON)], dim=-1)


def scenes(future: Tensor, position: Any = None, heading: Any = None) -> SceneBatch:
    """Scenes of cars with these futures (B, N, HORIZON, 2); far from each other if not said otherwise."""
    b, n = future.shape[:2]
    far = 1000.0 * torch.arange(n, dtype=torch.float32)[None, :, None] * torch.ones(b, 1, 2)
    state = torch.zeros(b, n, 4)
    state[..., 0], state[..., 1] = LENGTH, WIDTH
    state[..., 2] = future[:, :, 0].norm(dim=-1) / DT
    return SceneBatch(
        position=far if position is None else torch.tensor(position, dtype=torch.float32),
        heading=torch.zeros(b, n) if heading is None else torch.tensor(heading, dtype=torch.float32),
        history=torch.zeros(b, n, HISTORY, 4),
        observed=torch.ones(b, n, HISTORY, dtype=torch.bool),
        state=state,
        traffic=torch.zeros(b, n, TRAFFIC_CHANNELS),
        raster=torch.zeros(b, n, 1, 1, 1, dtype=torch.uint8),
        agent=torch.ones(b, n, dtype=torch.bool),
        future=future,
        future_known=torch.ones(b, n, HORIZON, dtype=torch.bool),
        maneuver=torch.zeros(b, n, dtype=torch.int64),
        target=torch.ones(b, n, dtype=torch.bool),
    )


def predict(mean: Tensor, probability: Any = None, scale: Any = (1.0, 1.0), correlation: float = 0.0) -> Prediction:
    """Forecasts (B, N, K, HORIZON, 2); probabilities broadcast to (B, N, K)."""
    k = mean.shape[:3]
    chances = torch.full(k, 1.0) if probability is None else torch.tensor(probability).expand(k)
    return Prediction(
        maneuver=chances.log(),
        mean=mean,
        scale=torch.tensor(scale).expand(mean.shape),
        correlation=torch.full(mean.shape[:-1], correlation),
    )


def score(batch: SceneBatch, prediction: Prediction, seed: int = 0) -> Scores:
    board = ScoreBoard(seed)
    board.add(batch, prediction)
    return board.scores()


# Errors


def test_a_perfect_forecast_has_no_error() -> None:
    batch = scenes(torch.stack([drive(10.0), drive(3.0)])[None])
    scores = score(batch, predict(batch.future[:, :, None]))
    assert scores.rmse.tolist() == [0.0] * 5
    assert (scores.ade, scores.min_ade, scores.joint_ade) == (0.0, 0.0, 0.0)
    assert scores.calibration == {"50": 1.0, "90": 1.0}
    assert scores.nll == pytest.approx(math.log(2.0 * math.pi))
    assert (scores.samples, scores.scenes) == (2, 1)


def test_seconds_are_every_fifth_step() -> None:
    batch = scenes(drive(0.0)[None, None])
    off = torch.stack([STEPS, torch.zeros(HORIZON)], dim=-1)[None, None, None]  # step t is off by t metres
    scores = score(batch, predict(off))
    assert scores.rmse.tolist() == pytest.approx([5.0, 10.0, 15.0, 20.0, 25.0])
    assert scores.ade == pytest.approx(13.0)
    assert list(scores.to_json()["rmse"]) == ["1", "2", "3", "4", "5"]


def test_rmse_is_the_root_of_the_mean_of_squares_over_all_batches() -> None:
    batch = scenes(drive(10.0)[None, None])
    board = ScoreBoard()
    for off in (0.0, 2.0):
        board.add(batch, predict(batch.future[:, :, None] + torch.tensor([off, 0.0])))
    assert board.scores().rmse.tolist() == pytest.approx([math.sqrt(2.0)] * 5)
    assert board.scores().ade == pytest.approx(1.0)


def test_the_most_probable_manoeuvre_counts_though_another_is_right() -> None:
    batch = scenes(drive(10.0)[None, None])
    mean = torch.stack([drive(10.0), drive(10.0) + 1.0], dim=0)[None, None]
    scores = score(batch, predict(mean, [0.4, 0.6]))
    assert scores.rmse.tolist() == pytest.approx([math.sqrt(2.0)] * 5)
    assert scores.ade == pytest.approx(math.sqrt(2.0))
    assert scores.min_ade == 0.0


@pytest.mark.parametrize("missing", ["agent", "target", "observed", "future_known"])
def test_agents_without_a_full_history_and_future_are_not_scored(missing: str) -> None:
    batch = scenes(torch.stack([drive(10.0), drive(10.0)])[None])
    mask = getattr(batch, missing).clone()
    mask[0, 1].view(-1)[0] = False
    batch = replace(batch, **{missing: mask})
    assert scored_agents(batch).tolist() == [[True, False]]
    mean = batch.future[:, :, None].clone()
    mean[0, 1] += 100.0
    scores = score(batch, predict(mean))
    assert (scores.samples, scores.rmse.tolist()) == (1, [0.0] * 5)


def test_nothing_to_score_is_an_error() -> None:
    with pytest.raises(InputError, match="3 s of history and 5 s of future"):
        ScoreBoard().scores()


@pytest.mark.parametrize("field", ["mean", "scale", "maneuver"])
def test_a_forecast_that_is_not_finite_is_an_error(field: str) -> None:
    batch = scenes(drive(10.0)[None, None])
    prediction = predict(batch.future[:, :, None])
    bad = getattr(prediction, field).clone()
    bad.view(-1)[0] = math.nan
    with pytest.raises(InputError, match="not finite"):
        score(batch, replace(prediction, **{field: bad}))


# Scenes as a whole


def one_right_one_wrong(count: int) -> tuple[SceneBatch, Prediction]:
    """Scenes of two cars, for each of which the less probable of two manoeuvres, by a hair, is right."""
    batch = scenes(drive(10.0).expand(count, 2, HORIZON, 2))
    mean = torch.stack([drive(10.0) + torch.tensor([0.0, 1.0]), drive(10.0)]).expand(count, 2, 2, HORIZON, 2)
    return batch, predict(mean, [0.500001, 0.499999])


def test_joint_ade_is_that_of_the_best_sample_of_the_whole_scene() -> None:
    # A drawn sample is off by 0, 0.5 or 1 m on average with probabilities 1/4, 1/2, 1/4; sample 0 by 1 m.
    draws = SCENE_SAMPLES - 1
    expected = 0.5 * (0.75**draws - 0.25**draws) + 0.25**draws
    batch, prediction = one_right_one_wrong(8000)
    scores = score(batch, prediction)
    assert scores.joint_ade == pytest.approx(expected, abs=0.01)
    assert (scores.min_ade, scores.ade) == (0.0, pytest.approx(1.0))


def test_the_first_sample_of_a_scene_is_the_most_probable_one() -> None:
    batch = scenes(drive(10.0)[None, None])
    mean = torch.stack([drive(10.0) + torch.tensor([0.0, 1.0]), drive(10.0) + torch.tensor([0.0, 3.0])])[None, None]
    for seed in range(20):
        assert score(batch, predict(mean, [0.51, 0.49]), seed).joint_ade == pytest.approx(1.0)


def test_samples_do_not_depend_on_batches_or_padding() -> None:
    batch, prediction = one_right_one_wrong(50)
    whole = score(batch, prediction, seed=3)
    board = ScoreBoard(3)
    for k in range(50):
        part = slice(k, k + 1)
        padded = {name: torch.cat([value[part], value[part]], dim=1) for name, value in batch.tensors()}
        padded["agent"][:, 2:] = False
        double = {name: torch.cat([value[part], value[part]], dim=1) for name, value in vars(prediction).items()}
        board.add(SceneBatch(**padded), Prediction(**double))
    assert board.scores().joint_ade == pytest.approx(whole.joint_ade)
    assert score(batch, prediction, seed=4).joint_ade != whole.joint_ade


# Likelihood and calibration


def test_nll_is_that_of_a_correlated_gaussian() -> None:
    batch = scenes(drive(0.0)[None, None])
    mean = torch.tensor([0.7, -1.1]).expand(1, 1, 1, HORIZON, 2)
    scores = score(batch, predict(mean, scale=(0.5, 2.0), correlation=0.6))
    covariance = [[0.25, 0.6], [0.6, 4.0]]
    expected = -multivariate_normal([0.7, -1.1], covariance).logpdf([0.0, 0.0])
    assert scores.nll == pytest.approx(expected, rel=1e-5)
    assert scores.nll_at.tolist() == pytest.approx([expected] * 5, rel=1e-5)


def test_nll_is_that_of_the_mixture() -> None:
    batch = scenes(drive(0.0)[None, None])
    mean = torch.stack([torch.zeros(HORIZON, 2), torch.tensor([2.0, 0.0]).expand(HORIZON, 2)])[None, None]
    density = (0.25 + 0.75 * math.exp(-2.0)) / (2.0 * math.pi)
    assert score(batch, predict(mean, [0.25, 0.75])).nll == pytest.approx(-math.log(density), rel=1e-5)


@pytest.mark.parametrize(("shrunk", "shares"), [(1.0, (0.5, 0.9)), (0.5, (1.0 - 0.5**0.25, 1.0 - 0.1**0.25))])
def test_truth_drawn_from_the_forecast_lies_in_its_ellipses(shrunk: float, shares: tuple[float, float]) -> None:
    """Where the forecast's deviations are half of the true ones, ellipses hold 1 - q ** (1/4) instead of 1 - q."""
    scale, rho = np.array([0.5, 2.0]), -0.7
    covariance = np.array([[1.0, rho], [rho, 1.0]]) * scale[:, None] * scale
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal([3.0, 1.0], covariance, size=(1, 2000, HORIZON))
    batch = scenes(torch.tensor(draws, dtype=torch.float32))
    mean = torch.tensor([3.0, 1.0]).expand(1, 2000, 1, HORIZON, 2)
    scores = score(batch, predict(mean, scale=tuple((shrunk * scale).tolist()), correlation=rho))
    assert scores.calibration["50"] == pytest.approx(shares[0], abs=0.01)
    assert scores.calibration["90"] == pytest.approx(shares[1], abs=0.01)
    assert scores.calibration_at["90"].tolist() == pytest.approx([shares[1]] * 5, abs=0.03)


# Overlaps of forecasts


def test_forecasts_that_cross_at_one_instant_overlap_and_the_truth_does_not() -> None:
    # Both would be at (20, 0) after 2 s; in truth the second one waits.
    batch = scenes(
        torch.stack([drive(10.0), drive(0.0)])[None],
        position=[[[0.0, 0.0], [20.0, -20.0]]],
        heading=[[0.0, math.pi / 2]],
    )
    mean = torch.stack([drive(10.0), drive(10.0)])[None, :, None]
    scores = score(batch, predict(mean))
    assert (scores.overlap_rate, scores.overlap_rate_truth) == (1.0, 0.0)
    scores = score(replace(batch, future=mean[:, :, 0]), predict(mean))
    assert (scores.overlap_rate, scores.overlap_rate_truth) == (1.0, 1.0)


def test_passing_the_same_place_at_different_times_is_no_overlap() -> None:
    batch = scenes(
        torch.stack([drive(10.0), drive(10.0)])[None],
        position=[[[0.0, 0.0], [20.0, -30.0]]],
        heading=[[0.0, math.pi / 2]],
    )
    assert score(batch, predict(batch.future[:, :, None])).overlap_rate == 0.0


def test_boxes_and_not_points_overlap() -> None:
    for gap, rate in ((WIDTH - 0.01, 1.0), (WIDTH + 0.01, 0.0)):
        batch = scenes(drive(10.0).expand(1, 2, HORIZON, 2), position=[[[0.0, 0.0], [0.0, gap]]])
        assert score(batch, predict(batch.future[:, :, None])).overlap_rate == rate


def test_agents_of_different_scenes_do_not_overlap() -> None:
    batch = scenes(drive(10.0).expand(2, 1, HORIZON, 2), position=[[[0.0, 0.0]], [[0.0, 0.0]]])
    assert score(batch, predict(batch.future[:, :, None])).overlap_rate == 0.0


def test_partners_need_not_be_scored_but_must_be_there() -> None:
    batch = scenes(drive(10.0).expand(1, 3, HORIZON, 2), position=[[[0.0, 0.0], [1.0, 0.0], [0.0, 50.0]]])
    target = torch.tensor([[True, False, True]])
    prediction = predict(batch.future[:, :, None])
    assert score(replace(batch, target=target), prediction).overlap_rate == 0.5
    assert score(replace(batch, agent=target), prediction).overlap_rate == 0.0
    gone = batch.future_known.clone()
    gone[0, 1, 1:] = False
    assert score(replace(batch, future_known=gone), prediction).overlap_rate == 0.5  # at the first step still
    gone[0, 1] = False
    assert score(replace(batch, future_known=gone), prediction).overlap_rate == 0.0


# Boxes along paths


def test_headings_follow_the_path_and_stay_where_it_stands() -> None:
    path = np.array([[0.0, 1.0], [1.0, 1.0], [1.01, 1.05], [1.01, 1.05], [0.0, 1.05]])
    expected = [math.pi / 2, 0.0, 0.0, 0.0, math.pi]
    assert path_headings(path, np.array(0.3)) == pytest.approx(expected, abs=1e-9)
    assert path_headings(np.zeros((3, 2)), np.array(0.3)).tolist() == [0.3] * 3
