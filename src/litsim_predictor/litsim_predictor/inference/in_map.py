"""What a network answers in the frames of agents, as a forecast in frame map."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from litsim_predictor.forecast import Float32Array, Forecast, Modes
from litsim_predictor.inference.contract import DT, AgentFutures
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray
from litsim_sim.kernels.compiled import (
    Floats,
    Floats2,
    Floats3,
    OutBools,
    OutFloats2,
    OutFloats3,
    OutSingles3,
    Singles2,
    Singles3,
    float64,
    kernel,
)

MOVED = 0.1  # [m] between two steps of the horizon: agents that move less keep their heading


def forecast_in_map(futures: AgentFutures, frame: FloatArray, agents: AgentTable) -> Forecast:
    """Returns the forecast of the manoeuvres of n `agents`, whose frames are `frame` (n, 3), in frame map."""
    further, n = futures.further, len(frame)
    row = np.concatenate([np.arange(n), further.row])
    own, parts = frame[row], ((f.mean, f.scale, f.correlation) for f in (futures, further))
    gaussians = Gaussians(*map(np.concatenate, zip(*parts, strict=True)))
    mean, covariance, valid = turned_gaussians(*gaussians, own)
    yaw = headings(mean, own[:, :2], agents.yaw[row]).astype(np.float32)
    usable = valid[n:] & valid[further.row]
    modes = Modes(
        row=further.row[usable],
        probability=futures.maneuver[further.row, further.maneuver][usable],
        mean=mean[n:][usable],
        yaw=yaw[n:][usable],
        covariance=covariance[n:][usable],
    )
    return Forecast(
        step=agents.step,
        dt=DT,
        id=agents.id,
        mean=mean[:n],
        yaw=yaw[:n],
        covariance=covariance[:n],
        maneuver_probability=futures.maneuver,
        valid=valid[:n],
        modes=modes,
    )


class Gaussians(NamedTuple):
    """Gaussians (n, T, 2), (n, T, 2) and (n, T) in the frames of agents [m]; see :class:`.AgentFutures`."""

    mean: Singles3
    scale: Singles3
    correlation: Singles2


def turned_gaussians(
    mean: Float32Array, scale: Float32Array, correlation: Float32Array, frame: FloatArray
) -> tuple[FloatArray, Float32Array, BoolArray]:
    """Returns Gaussians from agent frames `frame` (n, 3) to frame map; see :func:`turn_gaussians`.

    Returns:
        means (n, T, 2) [m]; sigma_x, sigma_y [m] and correlation (n, T, 3); and (n,) whether all of these are finite.
    """
    turned, covariance = np.empty(mean.shape), np.empty((*correlation.shape, 3), np.float32)
    valid = np.empty(len(mean), np.bool_)
    cos, sin = np.cos(frame[:, 2]), np.sin(frame[:, 2])
    turn_gaussians(Gaussians(mean, scale, correlation), frame, cos, sin, turned, covariance, valid)
    return turned, covariance, valid


@kernel
def turn_gaussians(
    gaussians: Gaussians,
    frame: Floats2,
    cos: Floats,
    sin: Floats,
    turned: OutFloats3,
    covariance: OutSingles3,
    valid: OutBools,
) -> None:
    """Transform Gaussians from agent frames to frame map.

    Args:
        gaussians: in the agent frames.
        frame: (n, 3) x, y [m] and heading of these.
        cos, sin: (n,) of the headings.
        turned: (n, T, 2) means in frame map [m].
        covariance: (n, T, 3) sigma_x, sigma_y [m] and correlation there.
        valid: (n,) whether all numbers of an agent are finite.
    """
    mean, scale, correlation = gaussians
    for i in range(len(mean)):
        c, s = cos[i], sin[i]
        valid[i] = True
        for t in range(mean.shape[1]):
            ahead, left = float64(mean[i, t, 0]), float64(mean[i, t, 1])
            wide, high = float64(scale[i, t, 0]), float64(scale[i, t, 1])
            xx, yy, xy = wide * wide, high * high, float64(correlation[i, t]) * wide * high
            turned[i, t, 0] = frame[i, 0] + (c * ahead - s * left)
            turned[i, t, 1] = frame[i, 1] + (s * ahead + c * left)
            sigma_x = math.sqrt(c * c * xx - 2.0 * c * s * xy + s * s * yy)
            sigma_y = math.sqrt(s * s * xx + 2.0 * c * s * xy + c * c * yy)
            across = (c * s * (xx - yy) + (c * c - s * s) * xy) / (sigma_x * sigma_y)
            covariance[i, t, 0], covariance[i, t, 1], covariance[i, t, 2] = sigma_x, sigma_y, across
            numbers = turned[i, t, 0] + turned[i, t, 1] + sigma_x + sigma_y + across
            valid[i] &= math.isfinite(numbers)


def headings(mean: FloatArray, start: FloatArray, yaw: FloatArray) -> FloatArray:
    """Returns the headings (n, T) [rad] along trajectories `mean` (n, T, 2) [m] from `start` (n, 2) on.

    While a vehicle does not move, the heading before, `yaw` (n,), is kept.
    """
    mean, start, yaw = (np.ascontiguousarray(array, np.float64) for array in (mean, start, yaw))
    dx, dy = np.empty(mean.shape[:2]), np.empty(mean.shape[:2])
    steps_between(mean, start, dx, dy)
    along = np.arctan2(dy, dx)
    keep_headings(dx, dy, yaw, along)
    return along


@kernel
def steps_between(mean: Floats3, start: Floats2, dx: OutFloats2, dy: OutFloats2) -> None:
    """Write how far (n, T) positions `mean` (n, T, 2) are from those before them, the first from `start` (n, 2) [m]."""
    for i in range(len(mean)):
        x, y = start[i]
        for t in range(mean.shape[1]):
            dx[i, t], dy[i, t] = mean[i, t, 0] - x, mean[i, t, 1] - y
            x, y = mean[i, t]


@kernel
def keep_headings(dx: Floats2, dy: Floats2, yaw: Floats, along: OutFloats2) -> None:
    """Where a step (n, T) `dx`, `dy` is shorter than :data:`MOVED`, put the heading before it into `along` (n, T)."""
    for i in range(len(dx)):
        held = yaw[i]
        for t in range(dx.shape[1]):
            if dx[i, t] * dx[i, t] + dy[i, t] * dy[i, t] > MOVED * MOVED:
                held = along[i, t]
            along[i, t] = held
