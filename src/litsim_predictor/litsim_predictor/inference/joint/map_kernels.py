"""The joint predictor's encoder of maps, as compiled kernels in single precision: see :mod:`.network`.

Planes of a map have borders and lie behind each other in one array: each cell of a convolution's kernel is the whole
plane, shifted, and a convolution the product of its weights with all of these.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt

from litsim_predictor.inference.dense_kernels import Row, rectified_product
from litsim_predictor.inference.joint.units import MAP_MIDDLE
from litsim_predictor.inference.raster import CHANNELS, COLUMNS, ROWS
from litsim_sim.core.scene import IntArray
from litsim_sim.kernels.compiled import (
    Ints,
    OutSingles,
    OutSingles2,
    Singles,
    Singles2,
    float32,
    kernel,
    read_array,
    uint8,
)

Bytes3 = Annotated[npt.NDArray[np.uint8], read_array(uint8, 3)]
Bytes4 = Annotated[npt.NDArray[np.uint8], read_array(uint8, 4)]
KERNEL = 3  # cells along each side of a convolution's kernel
HALF_ROWS, HALF_COLUMNS = ROWS // 2, COLUMNS // 2
QUARTER_ROWS, QUARTER_COLUMNS = ROWS // 4, COLUMNS // 4
HALVES = 4 * (HALF_ROWS + 1) * (HALF_COLUMNS + 1)
"""Cells of a channel whose even and odd rows and columns are planes of their own, with a border before them alone."""

PIECE = 16
"""Cells that are convolved at a time: rows have whole pieces, and planes as many cells more."""


@kernel
def in_pieces(cells: int) -> int:
    """Return the number `cells`, rounded up to whole pieces."""
    return (cells + PIECE - 1) // PIECE * PIECE


@kernel
def convolve(
    planes: Row, starts: Ints, weight: Singles2, bias: Singles, shifted: OutSingles2, out: OutSingles2
) -> None:
    """Write to `out` (o, p) `bias` (o,) and the sum over r of `weight` (o, r) times `planes` from `starts` (r,) on.

    Negative values become 0. `shifted` (r, p) is a buffer for the planes from each start on.
    """
    cells = out.shape[1]
    for r in range(len(starts)):
        plane, row = planes[starts[r] :], shifted[r]
        for p in range(cells):
            row[p] = plane[p]
    rectified_product(weight, shifted, bias, out)


@kernel
def split_halves(raster: Bytes3, planes: OutSingles) -> None:
    """Write a map (CHANNELS, ROWS, COLUMNS) into planes for a convolution with a stride of 2; see :data:`HALVES`."""
    for c in range(CHANNELS):
        for y in range(ROWS):
            for x in range(COLUMNS):
                plane = 4 * c + 2 * (y % 2) + x % 2
                cell = (plane * (HALF_ROWS + 1) + y // 2 + 1) * (HALF_COLUMNS + 1) + x // 2 + 1
                planes[cell] = float32(raster[c, y, x]) - float32(MAP_MIDDLE)


@kernel
def with_borders(convolved: Singles2, stride: int, planes: OutSingles) -> None:
    """Write a convolution's output, (channels, ...) with rows `stride` apart, into planes with borders of 1."""
    for c in range(len(convolved)):
        for y in range(HALF_ROWS):
            for x in range(HALF_COLUMNS):
                planes[(c * (HALF_ROWS + 2) + y + 1) * (HALF_COLUMNS + 2) + x + 1] = convolved[c, y * stride + x]


@kernel
def pooled(convolved: Singles2, stride: int, planes: OutSingles) -> None:
    """Write the largest of each 2 by 2 cells of a convolution's output into planes with borders of 1."""
    for c in range(len(convolved)):
        for y in range(QUARTER_ROWS):
            for x in range(QUARTER_COLUMNS):
                cell = 2 * y * stride + 2 * x
                upper = max(convolved[c, cell], convolved[c, cell + 1])
                lower = max(convolved[c, cell + stride], convolved[c, cell + stride + 1])
                planes[(c * (QUARTER_ROWS + 2) + y + 1) * (QUARTER_COLUMNS + 2) + x + 1] = max(upper, lower)


@kernel
def encode_maps(  # noqa: PLR0917 - a kernel takes arrays and numbers
    rasters: Bytes4,
    out: OutSingles2,
    starts1: Ints,
    weight1: Singles2,
    bias1: Singles,
    starts2: Ints,
    weight2: Singles2,
    bias2: Singles,
    starts3: Ints,
    weight3: Singles2,
    bias3: Singles,
) -> None:
    """Convolve, convolve, pool and convolve maps, each time rectified.

    Args:
        rasters: (u, CHANNELS, ROWS, COLUMNS).
        out: (u, channels * QUARTER_ROWS * QUARTER_COLUMNS).
        starts1, weight1, bias1: of the first convolution, see :func:`convolve`; then of the others.
    """
    channels = len(bias1)
    wide1, wide2, wide3 = HALF_COLUMNS + 1, HALF_COLUMNS + 2, QUARTER_COLUMNS + 2
    cells1, cells2 = (
        in_pieces((HALF_ROWS - 1) * wide1 + HALF_COLUMNS),
        in_pieces((HALF_ROWS - 1) * wide2 + HALF_COLUMNS),
    )
    cells3 = in_pieces((QUARTER_ROWS - 1) * wide3 + QUARTER_COLUMNS)
    planes1 = np.zeros(CHANNELS * HALVES + PIECE, np.float32)
    planes2 = np.zeros(channels * (HALF_ROWS + 2) * wide2 + PIECE, np.float32)
    planes3 = np.zeros(channels * (QUARTER_ROWS + 2) * wide3 + PIECE, np.float32)
    shifted1 = np.empty((len(starts1), cells1), np.float32)
    shifted2 = np.empty((len(starts2), cells2), np.float32)
    shifted3 = np.empty((len(starts3), cells3), np.float32)
    out1 = np.empty((channels, cells1), np.float32)
    out2 = np.empty((channels, cells2), np.float32)
    out3 = np.empty((channels, cells3), np.float32)
    for i in range(len(rasters)):
        split_halves(rasters[i], planes1)
        convolve(planes1, starts1, weight1, bias1, shifted1, out1)
        with_borders(out1, wide1, planes2)
        convolve(planes2, starts2, weight2, bias2, shifted2, out2)
        pooled(out2, wide2, planes3)
        convolve(planes3, starts3, weight3, bias3, shifted3, out3)
        for c in range(channels):
            for y in range(QUARTER_ROWS):
                for x in range(QUARTER_COLUMNS):
                    out[i, (c * QUARTER_ROWS + y) * QUARTER_COLUMNS + x] = out3[c, y * wide3 + x]


def starts_apart(channels: int, rows: int, columns: int) -> IntArray:
    """Where each cell of a kernel (channels, KERNEL, KERNEL) starts, in planes of (rows, columns) with borders of 1."""
    c, y, x = np.ogrid[:channels, :KERNEL, :KERNEL]
    return np.asarray((c * (rows + 2) + y) * (columns + 2) + x).ravel()


def starts_in_halves(channels: int) -> IntArray:
    """Where each cell of a kernel (channels, KERNEL, KERNEL) starts, in the planes of :data:`HALVES`."""
    c, y, x = np.ogrid[:channels, :KERNEL, :KERNEL]
    plane = 4 * c + 2 * (y != 1) + (x != 1)
    return np.asarray((plane * (HALF_ROWS + 1) + (y > 0)) * (HALF_COLUMNS + 1) + (x > 0)).ravel()
