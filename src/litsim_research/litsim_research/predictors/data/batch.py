"""Inputs and outputs of torch models: batches of whole scenes, padded to the same number of agents.

Histories and futures are given in the agent frames, see :mod:`litsim_predictor.inference.contract`; `position` and
`heading` relate these frames to each other.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from litsim_predictor.inference.contract import DT, HORIZON, LONGITUDINAL
from litsim_predictor.inference.lane_frames import NO_LANE_FRAMES, LaneFrames
from litsim_sim.core.scene import FloatArray

LATERAL_SHIFT = 1.5  # [m] in 5 s, in the agent frame, above which a manoeuvre is left or right
BRAKE_RATIO, ACCELERATE_RATIO = 0.8, 1.25  # mean speed in the next 5 s to present speed (0.8: conv-social-pooling)
SPEED_FLOOR = 1.0  # [m/s] added to both speeds of these ratios, for vehicles that are almost standing


@dataclass(frozen=True)
class SceneBatch:
    """B scenes of at most N agents.

    Attributes:
        position: (B, N, 2) box centres in the axes of frame map, relative to a point of the scene [m].
        heading: (B, N) headings of the agent frames in frame map [rad].
        history: (B, N, HISTORY, HISTORY_CHANNELS) oldest first, the present last; zeros where not observed.
        observed: (B, N, HISTORY) bool; the present is observed for every agent.
        state: (B, N, STATE_CHANNELS) present states.
        traffic: (B, N, TRAFFIC_CHANNELS) traffic ahead; see :mod:`litsim_predictor.inference.traffic`.
        raster: (B, N, C, H, W) uint8 map around each agent in its frame; see :mod:`litsim_predictor.inference.raster`.
        agent: (B, N) bool, False for padding.
        future: (B, N, HORIZON, 2) box centres in the agent frame [m]; zeros where unknown.
        future_known: (B, N, HORIZON) bool.
        maneuver: (B, N) int64, true manoeuvre as an index in :data:`MANEUVERS`, -1 where the future is not complete.
        target: (B, N) bool, the agents that losses and scores refer to.
        lane_frames: of the agents whose lanes bend; their rows are indices of agents in arrays (B * N,). Empty in
            batches for training.
    """

    position: Tensor
    heading: Tensor
    history: Tensor
    observed: Tensor
    state: Tensor
    traffic: Tensor
    raster: Tensor
    agent: Tensor
    future: Tensor
    future_known: Tensor
    maneuver: Tensor
    target: Tensor
    lane_frames: LaneFrames = NO_LANE_FRAMES

    def in_batch(self) -> SceneBatch:
        """Returns this scene, whose fields have no dimension B, as a batch with B = 1."""
        return replace(self, **{name: tensor[None] for name, tensor in self.tensors()})

    def to(self, device: torch.device | str) -> SceneBatch:
        """Returns a copy of the batch whose tensors are on `device`."""
        return replace(self, **{name: tensor.to(device, non_blocking=True) for name, tensor in self.tensors()})

    def tensors(self) -> Iterator[tuple[str, Any]]:
        """Yields names and tensors (B, N, ...) of all fields but `lane_frames`."""
        return ((f.name, getattr(self, f.name)) for f in fields(self) if f.name != "lane_frames")


@dataclass(frozen=True)
class Prediction:
    """Manoeuvre-conditioned Gaussians of every agent, in the agent frames.

    Attributes:
        maneuver: (B, N, K) logits.
        mean: (B, N, M, HORIZON, 2) [m]; M is K, or 1 if one manoeuvre per agent is decoded.
        scale: (B, N, M, HORIZON, 2) standard deviations along x and y [m].
        correlation: (B, N, M, HORIZON).
    """

    maneuver: Tensor
    mean: Tensor
    scale: Tensor
    correlation: Tensor


def numbers(values: Tensor) -> FloatArray:
    """Returns the `values` of a tensor on any device, as a numpy array of float64 of the same shape."""
    return values.detach().cpu().numpy().astype(np.float64)


def maneuvers_of(future: Tensor, future_known: Tensor, speed: Tensor) -> Tensor:
    """Returns true manoeuvres (...) int64, -1 where the future is not complete.

    Args:
        future: (..., HORIZON, 2) positions in the agent frame [m].
        future_known: (..., HORIZON) bool.
        speed: (...) present speeds [m/s].
    """
    shift = future[..., -1, 1]
    lateral = (shift > LATERAL_SHIFT).long() + 2 * (shift < -LATERAL_SHIFT).long()
    ratio = (future[..., -1, :].norm(dim=-1) / (HORIZON * DT) + SPEED_FLOOR) / (speed + SPEED_FLOOR)
    longitudinal = (ratio > ACCELERATE_RATIO).long() + 2 * (ratio < BRAKE_RATIO).long()
    return torch.where(future_known.all(dim=-1), len(LONGITUDINAL) * lateral + longitudinal, -1)
