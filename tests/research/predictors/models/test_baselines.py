"""Kinematic models as scene models: exact where they must be, and equal to the predictor of the node."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import torch

from litsim_predictor.forecast import Scope, Wanted
from litsim_predictor.inference.contract import HORIZON
from litsim_predictor.kinematic import KinematicConfig, KinematicPredictor
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.data.scene import cut_scene
from litsim_research.predictors.data.scenes import inputs_batch, scene_batches
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.evaluation.scores import ScoreBoard
from litsim_research.predictors.models.baselines import ConstantTurnRate, ConstantVelocity
from litsim_sim.core.scene import STEP_S, AgentTable
from litsim_sim.scenario.setting import Setting

NOW = 31  # step with more than 3 s of history
STEPS = 90


def turning(agent: int, x: float, y: float, yaw: float, speed: float, rate: float) -> pd.DataFrame:
    """Rows of an agent on a circle, in the neutral schema."""
    t = STEP_S * np.arange(STEPS)
    heading = yaw + rate * t
    return pd.DataFrame(
        {
            "vehicle_id": agent,
            "frame": np.arange(STEPS),
            "x": x + STEP_S * np.cumsum(speed * np.cos(heading)),
            "y": y + STEP_S * np.cumsum(speed * np.sin(heading)),
            "yaw": heading,
            "speed": speed,
            "length": 4.5,
            "width": 2.0,
        }
    )


def scene_now(rows: pd.DataFrame) -> SceneBatch:
    tracks = Tracks.from_table("made", rows, None)
    batches = list(scene_batches([tracks], agents_per_batch=1, stride=1))
    assert len(batches) == STEPS - 80  # each moment with the whole history and future
    return batches[NOW - 30]


def test_constant_velocity_is_exact_for_constant_velocity() -> None:
    rows = pd.concat([turning(1, 0.0, 0.0, 0.4, 12.0, 0.0), turning(2, 50.0, 0.0, -2.0, 0.0, 0.0)])
    batch = scene_now(rows)
    board = ScoreBoard()
    board.add(batch, ConstantVelocity()(batch, "all"))
    assert board.scores().samples == 2
    np.testing.assert_allclose(board.scores().rmse, 0.0, atol=1e-4)


def test_the_turning_model_is_the_kinematic_predictor(agent_table: Callable[..., AgentTable]) -> None:
    rows = pd.concat(
        [
            turning(1, 0.0, 0.0, 0.4, 12.0, 0.2),
            turning(2, 9.0, 5.0, 3.0, 6.0, -0.3),
            turning(3, -9.0, 5.0, 1.0, 8.0, 0.02),  # in the dead band
        ]
    )
    batch = scene_now(rows)
    prediction = ConstantTurnRate()(batch, "all")
    setting = cast(Setting, SimpleNamespace(ego_ids=1))
    predictor = KinematicPredictor(setting, Scope(1000.0, Wanted.ALL), KinematicConfig())
    for step, seen in rows.rename(columns={"vehicle_id": "id"}).groupby("frame"):
        if step <= NOW:
            table = agent_table(step, *seen.drop(columns="frame").to_dict("records"))
            forecast = predictor.forecast(table)
    heading = batch.heading[0].double().numpy()
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    mean = prediction.mean[0, :, 0].double().numpy()
    x = cos * mean[..., 0] - sin * mean[..., 1] + table.x[:, None]
    y = sin * mean[..., 0] + cos * mean[..., 1] + table.y[:, None]
    np.testing.assert_allclose(np.stack([x, y], axis=-1), forecast.mean, atol=1e-3)
    # The determinant of a covariance is the same in every frame.
    scale, rho = prediction.scale[0, :, 0].double().numpy(), prediction.correlation[0, :, 0].double().numpy()
    sigma = forecast.covariance.astype(np.float64)
    area = scale[..., 0] * scale[..., 1] * np.sqrt(1 - rho**2)
    np.testing.assert_allclose(area, sigma[..., 0] * sigma[..., 1] * np.sqrt(1 - sigma[..., 2] ** 2), rtol=1e-3)


def test_an_agent_that_has_just_appeared_is_expected_to_go_straight_on() -> None:
    rows = turning(1, 0.0, 0.0, 0.0, 10.0, 0.3)
    tracks = Tracks.from_table("made", rows, None)
    batch = inputs_batch([cut_scene(tracks, tracks.rows_at(2 * k)).inputs for k in range(NOW + 1)])
    assert batch.observed[0, 0].sum() == 1
    turning_on, straight_on = ConstantTurnRate()(batch).mean, ConstantVelocity()(batch).mean
    torch.testing.assert_close(turning_on[0], straight_on[0])
    assert (turning_on[NOW, 0, 0, :, 1] - straight_on[NOW, 0, 0, :, 1])[-1] > 5.0  # once it has been seen to turn
    assert straight_on.shape == (*batch.agent.shape, 1, HORIZON, 2)
