"""Inputs and outputs of the joint predictor, as compiled kernels in single precision: see :mod:`.network`."""

from __future__ import annotations

import math

import numpy as np

from litsim_predictor.inference.dense_kernels import tanh
from litsim_predictor.inference.joint.units import CORRELATION_LIMIT, SCALE_FLOOR
from litsim_sim.kernels.compiled import (
    Bools2,
    Ints,
    OutInts,
    OutSingles2,
    OutSingles3,
    Singles2,
    Singles3,
    float32,
    kernel,
)

SOFT_UNTIL = 20.0  # beyond, log(1 + exp(x)) is x in single precision


@kernel
def read_histories(history: Singles3, observed: Bools2, dt: float, out: OutSingles3) -> None:
    """Write how histories differ from constant speed straight ahead; zeros where they are not observed.

    Args:
        history, observed: (n, T, 4) x, y [m], yaw [rad] and speed [m/s], the present last, and (n, T).
        dt: between steps [s].
        out: (n, T, 5) the differences in the four channels, and 1 where they are observed.
    """
    agents, steps, _ = history.shape
    for i in range(agents):
        now = history[i, steps - 1, 3]
        for t in range(steps):
            seen = float32(1.0) if observed[i, t] else float32(0.0)
            out[i, t, 0] = seen * (history[i, t, 0] + float32(dt) * float32(steps - 1 - t) * now)
            out[i, t, 1], out[i, t, 2] = history[i, t, 1], history[i, t, 2]
            out[i, t, 3], out[i, t, 4] = seen * (history[i, t, 3] - now), seen


@kernel
def choose_maneuvers(logits: Singles2, probability: OutSingles2, best: OutInts) -> None:
    """Write the probabilities (m, K) of manoeuvres with `logits` (m, K), and which is the most probable (m,)."""
    for i in range(len(logits)):
        best[i] = 0
        for k in range(logits.shape[1]):
            if logits[i, k] > logits[i, best[i]]:
                best[i] = k
        total = float32(0.0)
        for k in range(logits.shape[1]):
            probability[i, k] = math.exp(logits[i, k] - logits[i, best[i]])
            total += probability[i, k]
        for k in range(logits.shape[1]):
            probability[i, k] /= total


@kernel
def further_maneuvers(probability: Singles2, best: Ints, most: int, share: float) -> tuple[Ints, Ints]:
    """Return the manoeuvres that matter beside the `best` (m,): rows (q,), ascending, and manoeuvres (q,).

    Args:
        probability: (m, K).
        best: most probable manoeuvre of each row.
        most: greatest number of further ones of each row.
        share: least probability of each of them.
    """
    most = min(most, probability.shape[1] - 1)
    row, other = np.empty(len(best) * most, np.int64), np.empty(len(best) * most, np.int64)
    count = 0
    for i in range(len(best)):
        taken = np.zeros(probability.shape[1], np.bool_)
        taken[best[i]] = True
        for _ in range(most):
            next_best = -1
            for k in range(probability.shape[1]):
                if not taken[k] and (next_best < 0 or probability[i, k] > probability[i, next_best]):
                    next_best = k
            if next_best < 0 or not probability[i, next_best] >= share:
                break
            taken[next_best] = True
            row[count], other[count] = i, next_best
            count += 1
    return row[:count].copy(), other[:count].copy()


@kernel
def write_gaussians(
    raw: Singles3, state: Singles2, dt: float, mean: OutSingles3, scale: OutSingles3, correlation: OutSingles2
) -> None:
    """Turn a decoder's output into Gaussians around constant velocity.

    Args:
        raw: (m, T, GAUSSIAN_CHANNELS) velocity to be added [m/s], then two scales and a correlation, all unbounded.
        state: (m, STATE_CHANNELS).
        dt: between steps [s].
        mean, scale: (m, T, 2) in the agent frames [m].
        correlation: (m, T).
    """
    for i in range(len(raw)):
        along, aside = state[i, 2] * math.cos(state[i, 3]), state[i, 2] * math.sin(state[i, 3])
        for t in range(raw.shape[1]):
            time = float32(dt) * float32(t + 1)
            mean[i, t, 0] = along * time + time * raw[i, t, 0]
            mean[i, t, 1] = aside * time + time * raw[i, t, 1]
            for axis in range(2):
                wide = raw[i, t, 2 + axis]
                soft = wide if wide > float32(SOFT_UNTIL) else math.log1p(math.exp(wide))
                scale[i, t, axis] = soft + float32(SCALE_FLOOR)
            correlation[i, t] = float32(CORRELATION_LIMIT) * tanh(raw[i, t, 4])
