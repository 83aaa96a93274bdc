"""Every learned predictor: finite whatever it is shown, indifferent to order and padding, able to learn."""

from dataclasses import fields, replace

import pytest
import torch

from litsim_predictor.inference.contract import HISTORY, HORIZON, MANEUVERS
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.models.model import SceneModel, constant_velocity, negative_log_likelihood
from litsim_research.predictors.models.registry import build

MODELS = {
    "default": ("joint", {"traffic": True}),
    "paper": ("joint", {"attention": "states", "decoder": "recurrent", "history_channels": 2}),
    "cs_lstm": ("cs_lstm", {}),
    "bat": ("bat", {}),
}


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> SceneModel:
    torch.manual_seed(0)
    return build(*MODELS[request.param], "test").eval()


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
    every, best = model(batch, "all"), model(batch, "best").mean[batch.agent]
    chosen = every.maneuver.argmax(dim=-1)[..., None, None, None].expand(-1, -1, 1, HORIZON, 2)
    assert torch.allclose(every.mean.gather(2, chosen)[batch.agent], best, atol=1e-4)
    fifth = torch.full_like(batch.maneuver, 4)
    assert torch.allclose(model(batch, fifth).mean[:, :, 0][batch.agent], every.mean[:, :, 4][batch.agent], atol=1e-4)
    assert torch.allclose(model(batch, fifth - 5).mean[batch.agent], best, atol=1e-4), "-1 stands for the best"
    assert (every.mean[:, :, 0] - every.mean[:, :, 8])[batch.agent].abs().amax() > 1e-4


@torch.no_grad()
def test_a_forecast_does_not_read_the_future(model: SceneModel, batch: SceneBatch) -> None:
    blind = {name: torch.zeros_like(getattr(batch, name)) for name in ("future", "future_known", "maneuver")}
    answer, blind_answer = model(batch), model(replace(batch, **blind))
    assert all(torch.equal(getattr(answer, f.name), getattr(blind_answer, f.name)) for f in fields(answer))


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
