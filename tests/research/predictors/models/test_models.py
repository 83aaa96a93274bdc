"""Every learned predictor: finite whatever it is shown, indifferent to order and padding, able to learn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
import torch

from litsim_predictor.inference.contract import HISTORY, HORIZON, MANEUVERS
from litsim_research.predictors.data.augmentation import Augmentation
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.data.scenes import training_batches
from litsim_research.predictors.data.tracks import Tracks
from litsim_research.predictors.models.model import SceneModel, constant_velocity, negative_log_likelihood
from litsim_research.predictors.models.registry import build
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.scenario import packaged

MODELS = {
    "default": ("joint", {"traffic": True}),
    "near": ("joint", {}),
    "paper": ("joint", {"relative": False, "decoder": "recurrent", "history_channels": 2}),
    "cs_lstm": ("cs_lstm", {}),
    "bat": ("bat", {}),
}


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> SceneModel:
    torch.manual_seed(0)
    return build(*MODELS[request.param], "test").eval()


@pytest.fixture
def batch(straight: Callable[..., pd.DataFrame]) -> SceneBatch:
    """Two scenes of four and two agents on the net us101_like."""
    four = straight((1, 150.0, -5.5, 10.0), (2, 165.0, -5.4, 8.0), (3, 150.0, -9.2, 12.0), (4, 190.0, -9.0, 0.0))
    two = straight((7, 300.0, -1.8, 14.0), (9, 320.0, -1.8, 13.0))
    two["frame"] += 1000
    tracks = Tracks.from_table("made", pd.concat([four, two]), packaged("nets/us101_like.net.xml"))
    return next(training_batches([(tracks, 1.0)], 99, 45, Augmentation(crop=0), np.random.default_rng(3)))


def permuted(batch: SceneBatch, order: torch.Tensor) -> SceneBatch:
    return replace(batch, **{name: tensor[:, order] for name, tensor in batch.tensors()})


@torch.no_grad()
def test_answers_are_finite_and_of_the_promised_shape(model: SceneModel, batch: SceneBatch) -> None:
    b, n = batch.agent.shape
    for decode, modes in (("best", 1), ("all", len(MANEUVERS)), (batch.maneuver, 1)):
        out = model(batch, decode)
        assert out.maneuver.shape == (b, n, len(MANEUVERS))
        assert out.mean.shape == out.scale.shape == (b, n, modes, HORIZON, 2)
        assert out.correlation.shape == (b, n, modes, HORIZON)
        assert all(bool(torch.isfinite(getattr(out, f.name)[batch.agent]).all()) for f in fields(out))
        assert (out.scale > 0).all() and (out.correlation.abs() < 1).all()


@torch.no_grad()
def test_the_best_is_the_most_probable_of_all(model: SceneModel, batch: SceneBatch) -> None:
    every, best = model(batch, "all"), model(batch, "best")
    chosen = every.maneuver.argmax(dim=-1)[..., None, None, None].expand(-1, -1, 1, HORIZON, 2)
    assert torch.allclose(every.mean.gather(2, chosen)[batch.agent], best.mean[batch.agent], atol=1e-4)


@torch.no_grad()
def test_neither_order_nor_padding_matters(model: SceneModel, batch: SceneBatch) -> None:
    out = model(batch)
    order = torch.randperm(batch.agent.shape[1], generator=torch.Generator().manual_seed(1))
    turned = model(permuted(batch, order))
    there = batch.agent[:, order]
    assert torch.allclose(out.mean[:, order][there], turned.mean[there], atol=1e-4)
    alone = SceneBatch(**{name: tensor[:1, batch.agent[0]] for name, tensor in batch.tensors()})
    assert torch.allclose(model(alone).mean[0], out.mean[0, batch.agent[0]], atol=1e-4)


@torch.no_grad()
def test_odd_scenes_are_answered(model: SceneModel, batch: SceneBatch) -> None:
    first_frame = replace(batch, observed=batch.observed & (torch.arange(HISTORY) == HISTORY - 1))
    stopped = replace(
        batch, history=torch.zeros_like(batch.history), state=batch.state * torch.tensor([1.0, 1.0, 0, 0])
    )
    on_a_heap = replace(batch, position=torch.zeros_like(batch.position))
    no_map = replace(batch, raster=torch.zeros_like(batch.raster))
    for odd in (first_frame, stopped, on_a_heap, no_map):
        out = model(odd)
        assert torch.isfinite(out.mean[batch.agent]).all() and torch.isfinite(out.scale[batch.agent]).all()


def test_what_agents_do_is_learned(model: SceneModel, batch: SceneBatch) -> None:
    """All brake at 1 m/s2, which constant velocity does not know."""
    t = 0.2 * torch.arange(1, HORIZON + 1)
    speed = batch.state[..., 2, None].clamp(min=0.5)
    until = torch.minimum(t, speed)
    braking = torch.stack([speed * until - 0.5 * until**2, torch.zeros_like(until)], dim=-1)
    batch = replace(batch, future=braking, future_known=torch.ones_like(batch.future_known))
    optimizer = torch.optim.Adam(model.parameters(), 3e-3)
    model.train()
    losses = []
    for _ in range(60):
        prediction = model(batch, batch.maneuver.clamp(min=0))
        error = ((prediction.mean - batch.future[:, :, None]) ** 2)[batch.agent].mean()
        nll = negative_log_likelihood(prediction, batch.future)[batch.agent].mean()
        optimizer.zero_grad()
        (error + 0.01 * nll).backward()
        optimizer.step()
        losses.append(float(error.detach()))
    naive = float(((constant_velocity(batch.state) - batch.future) ** 2)[batch.agent].mean())
    assert min(losses[-10:]) < 0.3 * naive


@pytest.mark.parametrize(
    ("kind", "parameters", "named"),
    [("joint", {"width": 3}, "parameters"), ("lstm", {}, "expected one of joint, cs_lstm, bat")],
)
def test_unknown_models_are_refused(kind: str, parameters: dict[str, int], named: str) -> None:
    with pytest.raises(InputError, match=named):
        build(kind, parameters, "file.yaml")
