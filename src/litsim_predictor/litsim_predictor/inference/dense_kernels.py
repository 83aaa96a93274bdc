"""Layers of networks in single precision, as compiled kernels.

Each row of a result is summed in a fixed order, independent of the rows beside it: an agent's result is the same to the
last bit alone, in a scene, and among many scenes. A compiler may not change that order. Loops are therefore written
such that entries along the last dimension are independent, so that the processor computes many at a time.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
import numpy.typing as npt
from numba import types

from litsim_predictor.inference.product_blocks import (
    BLOCK_ROWS,
    LANES,
    add_block,
    add_narrow_block,
    add_narrow_row_block,
    add_row_block,
    multiply_add,
)
from litsim_sim.kernels.compiled import OutSingles2, Singles, Singles2, float32, kernel, outer

Row = Annotated[npt.NDArray[np.float32], types.Array(float32, 1, "C", readonly=True)]
"""Type of an array (n,) that lies in one piece, so that its neighbours are read at once."""

INNER = 4  # terms of a sum that are added at a time
EPSILON = 1e-5  # added to the variance of a row, as in PyTorch

# tanh(x) = x P(x^2) / Q(x^2) up to TANH_END, where it is 1 in single precision: least squares of the relative error,
# weighted until it was even; 3e-7 remain, most of it rounding.
TANH_END = 9.0
P0, P1, P2, P3, P4 = 0.999999979, 0.13381025, 0.0034955874, 2.0609071e-05, 1.33546471e-08
Q1, Q2, Q3, Q4 = 0.467143406, 0.0258769794, 0.000328563366, 7.77655213e-07


@kernel
def tanh(x: np.float32) -> np.float32:
    """The hyperbolic tangent, by arithmetic alone, so that many are computed at a time."""
    x = min(max(x, -float32(TANH_END)), float32(TANH_END))
    y = x * x
    above = multiply_add(multiply_add(float32(P4), y, float32(P3)), y, float32(P2))
    above = multiply_add(multiply_add(above, y, float32(P1)), y, float32(P0))
    below = multiply_add(multiply_add(float32(Q4), y, float32(Q3)), y, float32(Q2))
    below = multiply_add(multiply_add(below, y, float32(Q1)), y, float32(1.0))
    return x * above / below


@kernel
def exp(x: np.float32) -> np.float32:
    """The exponential of an `x` of at most 0, within 1e-7, by arithmetic alone, so that many are computed at a time."""
    half = tanh(float32(0.5) * x)
    return (float32(1.0) + half) / (float32(1.0) - half)


@kernel
def add_blocks(values: Singles2, weight: Singles2, out: OutSingles2) -> None:
    """Do as :func:`add_product`, but leave out the last columns of `out` where their number is no multiple of LANES."""
    rows, columns = out.shape
    whole, wide = rows - rows % BLOCK_ROWS, columns - columns % (2 * LANES)
    for j in range(0, wide, 2 * LANES):
        for i in range(0, whole, BLOCK_ROWS):
            add_block(values, weight, out, i, j)
        for i in range(whole, rows):
            add_row_block(values, weight, out, i, j)
    for j in range(wide, columns - columns % LANES, LANES):
        for i in range(0, whole, BLOCK_ROWS):
            add_narrow_block(values, weight, out, i, j)
        for i in range(whole, rows):
            add_narrow_row_block(values, weight, out, i, j)


@kernel
def add_product(values: Singles2, weight: Singles2, out: OutSingles2) -> None:
    """Add to `out` (m, n) the product of `values` (m, k) and `weight` (k, n)."""
    add_blocks(values, weight, out)
    rest = out.shape[1] % LANES
    if rest > 0:  # in a block of their own, whose other columns are padding
        first = out.shape[1] - rest
        weights, sums = np.zeros((len(weight), LANES), np.float32), np.zeros((len(out), LANES), np.float32)
        weights[:, :rest], sums[:, :rest] = weight[:, first:], out[:, first:]
        add_blocks(values, weights, sums)
        out[:, first:] = sums[:, :rest]


@kernel
def rectify(values: OutSingles2) -> None:
    """Replace negative `values` (m, n) by 0."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] = max(values[i, j], float32(0.0))


@outer
@kernel
def linear(values: Singles2, weight: Singles2, bias: Row, out: OutSingles2) -> None:
    """Write to `out` (m, n) the product of `values` (m, k) and `weight` (k, n) plus `bias` (n,)."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = bias[j]
    add_product(values, weight, out)


@kernel
def rectified_linear(values: Singles2, weight: Singles2, bias: Row, out: OutSingles2) -> None:
    """Write to `out` (m, n) what :func:`linear` does, with negative values replaced by 0."""
    linear(values, weight, bias, out)
    rectify(out)


@kernel
def rectified_product(weight: Singles2, values: Singles2, bias: Singles, out: OutSingles2) -> None:
    """Write to `out` (m, n) the product of `weight` (m, k) and `values` (k, n) plus `bias` (m,), negative ones as 0.

    A convolution comes to this, with `values` the inputs that each weight is multiplied with.
    """
    for i in range(out.shape[0]):
        out[i, :] = bias[i]
    add_product(weight, values, out)
    rectify(out)


@kernel
def add_and_normalise(values: Singles2, more: Singles2, gain: Row, bias: Row, out: OutSingles2) -> None:
    """Write to `out` (m, n) `values` plus `more`, normalised to mean 0 and variance 1 by row, times gain plus bias.

    Layer normalisation (Ba et al. 2016).
    """
    rows, columns = values.shape
    count = float32(columns)
    for i in range(rows):
        total, squares = float32(0.0), float32(0.0)
        for j in range(columns):
            out[i, j] = values[i, j] + more[i, j]
            total += out[i, j]
        mean = total / count
        for j in range(columns):
            out[i, j] -= mean
            squares += out[i, j] * out[i, j]
        scale = float32(1.0) / math.sqrt(squares / count + float32(EPSILON))
        for j in range(columns):
            out[i, j] = out[i, j] * scale * gain[j] + bias[j]
