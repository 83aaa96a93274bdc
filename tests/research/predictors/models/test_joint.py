"""The paper's predictor: teacher forcing that hides the answer, and states relative to each agent."""

from dataclasses import replace

import pytest
import torch

from litsim_predictor.inference.contract import HORIZON, MANEUVERS
from litsim_research.predictors.data.batch import SceneBatch
from litsim_research.predictors.models.joint_attention import PairAttention
from litsim_research.predictors.models.joint_decoders import RecurrentDecoder

WIDTH, HIDDEN, REACH = 12, 16, 40.0


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


@torch.no_grad()
def test_forced_outputs_depend_on_earlier_true_positions_alone() -> None:
    decoder, maneuver = RecurrentDecoder(WIDTH, HIDDEN), torch.tensor([0, 4])
    code, base, truth = torch.randn(2, WIDTH), torch.randn(2, HORIZON, 2), 20.0 * torch.randn(2, HORIZON, 2)
    mean, raw = decoder(code, maneuver, base, truth)
    changed = truth.clone()
    changed[:, 10:] += 5.0
    mean_changed, raw_changed = decoder(code, maneuver, base, changed)
    assert torch.equal(mean[:, :11], mean_changed[:, :11]) and torch.equal(raw[:, :11], raw_changed[:, :11])
    assert ((mean - mean_changed)[:, 11:].abs() > 0.0).any(dim=-1).all()


@torch.no_grad()
def test_a_truth_that_is_its_own_forecast_forces_nothing() -> None:
    decoder, maneuver = RecurrentDecoder(WIDTH, HIDDEN), torch.arange(len(MANEUVERS))
    code, base = torch.randn(len(MANEUVERS), WIDTH), torch.randn(len(MANEUVERS), HORIZON, 2)
    mean, raw = decoder(code, maneuver, base, None)
    for free, forced in zip((mean, raw), decoder(code, maneuver, base, mean), strict=True):
        torch.testing.assert_close(free, forced, rtol=1e-4, atol=1e-4)


@torch.no_grad()
def test_states_are_relative_to_each_agent(batch: SceneBatch) -> None:
    encoder, angle = PairAttention(WIDTH, 4, 64, REACH), torch.tensor(2.0)
    turn = torch.stack([angle.cos(), angle.sin(), -angle.sin(), angle.cos()]).view(2, 2)
    elsewhere = replace(batch, position=batch.position @ turn + 300.0, heading=batch.heading + angle)
    codes, codes_elsewhere = (encoder(scenes)[batch.agent] for scenes in (batch, elsewhere))
    assert codes.shape == (int(batch.agent.sum()), WIDTH)
    torch.testing.assert_close(codes_elsewhere, codes, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("apart", "counts"), [(REACH - 1.0, True), (REACH + 1.0, False)])
@torch.no_grad()
def test_the_speed_of_others_counts_within_reach(batch: SceneBatch, apart: float, counts: bool) -> None:
    encoder, position, state = PairAttention(WIDTH, 4, 64, REACH), batch.position.clone(), batch.state.clone()
    position[0, 1] = position[0, 0] + torch.tensor([0.0, apart])
    state[0, 1, 2] += 3.0
    slow, fast = (encoder(replace(batch, position=position, state=speeds))[0, 0] for speeds in (batch.state, state))
    assert torch.equal(slow, fast) != counts
