"""How fast the traffic ahead of each agent drives, far beyond the neighbours that it attends to."""

from __future__ import annotations

import torch
from torch import Tensor

from litsim_predictor.inference.joint_units import TRAFFIC_AGO, TRAFFIC_KNOTS, TRAFFIC_SOME, TRAFFIC_WIDTHS
from litsim_predictor.learned.data.batch import SceneBatch


def traffic_ahead(batch: SceneBatch) -> Tensor:
    """(..., N, TRAFFIC_CHANNELS) of what is ahead of each agent of `batch`, along its frame and in its direction.

    For one's own lane, then for all lanes, and at each inner one of :data:`.TRAFFIC_KNOTS`: how much faster the
    vehicles there are in the mean [m/s], how much faster they have become in the last second [m/s], and how many there
    are, at most 1. Vehicles count the less the farther they are from the knot and to the side, linearly, and by the
    cosine of the angle between the frames, so that nothing jumps. Where nobody is, all are 0.
    """
    x, y = batch.position.unbind(dim=-1)
    dx, dy = x[..., None, :] - x[..., None], y[..., None, :] - y[..., None]
    heading, speed = batch.heading, batch.state[..., 2]
    cos, sin = heading.cos(), heading.sin()
    ahead = cos[..., None] * dx + sin[..., None] * dy
    left = cos[..., None] * dy - sin[..., None] * dx
    along = (cos[..., None] * cos[..., None, :] + sin[..., None] * sin[..., None, :]).relu()
    along = along * batch.agent[..., None, :]
    faster = speed[..., None, :] - speed[..., None]
    seen = batch.observed[..., -1 - TRAFFIC_AGO].to(speed.dtype)
    gained = seen * (speed - batch.history[..., -1 - TRAFFIC_AGO, 3])
    found = []
    for width in TRAFFIC_WIDTHS:
        beside = along * (1.0 - left.abs() / width).relu()
        for before, knot, after in zip(TRAFFIC_KNOTS, TRAFFIC_KNOTS[1:], TRAFFIC_KNOTS[2:], strict=False):
            near = torch.minimum((ahead - before) / (knot - before), (after - ahead) / (after - knot)).relu()
            share = beside * near
            many = share.sum(dim=-1)
            known = (share * seen[..., None, :]).sum(dim=-1)
            found += [
                (share * faster).sum(dim=-1) / (many + TRAFFIC_SOME),
                (share * gained[..., None, :]).sum(dim=-1) / (known + TRAFFIC_SOME),
                many.clamp_max(1.0),
            ]
    return torch.stack(found, dim=-1)
