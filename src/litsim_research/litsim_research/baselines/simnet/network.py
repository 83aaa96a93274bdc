"""SimNet's network in the loop, without torch, by compiled kernels.

An agent's outputs depend on its raster alone, to the last bit, and neither on other agents nor on the process.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from litsim_policy.motion.network_file import read_network
from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.dense_kernels import linear, rectified_product, rectify
from litsim_research.baselines.simnet.output import FORMAT, OUTPUTS, SMALL_HIDDEN, SMALL_WIDTHS
from litsim_research.baselines.simnet.raster import CHANNELS, SMALL, Rasters
from litsim_sim.core.errors import InputError
from litsim_sim.kernels.compiled import OutSingles2, Singles, Singles2, Singles3, float32, kernel

KERNEL = 3  # cells along each side of a convolution's kernel; its stride is two


class SimnetNetwork:
    """Four convolutions and two linear layers, all but the last rectified.

    Weights are arrays as :func:`litsim_research.imitation.simnet_network.save` writes them.
    """

    def __init__(self, arrays: Mapping[str, Float32Array], source: Path) -> None:
        self.source = source
        rows, columns = SMALL.rows, SMALL.columns
        self._convolutions: list[tuple[Float32Array, Float32Array, Float32Array, Float32Array]] = []
        for number in range(len(SMALL_WIDTHS)):
            weight, bias = (arrays[f"convolution.{number}.{what}"] for what in ("weight", "bias"))
            rows, columns = rows // 2, columns // 2
            # buffers are reused, since allocating memory costs more than the sums
            patches = np.empty((weight.shape[1], rows * columns), np.float32)
            self._convolutions.append((weight, bias, patches, np.empty((len(bias), rows, columns), np.float32)))
        self._dense = [(arrays[f"{layer}.weight"], arrays[f"{layer}.bias"]) for layer in ("hidden", "last")]

    def __call__(self, rasters: Rasters) -> Float32Array:
        """Returns outputs (m, OUTPUTS) for rasters (m, CHANNELS, rows, columns), see :data:`.output.OUTPUTS`."""
        codes = np.empty((len(rasters), len(self._dense[0][0])), np.float32)
        for raster, code in zip(rasters, codes, strict=True):
            values = raster
            for weight, bias, patches, out in self._convolutions:
                convolve(values, weight, bias, patches, out.reshape(len(out), -1))
                values = out
            code[:] = values.ravel()
        (weight, bias), last = self._dense
        hidden, outputs = np.empty((len(codes), len(bias)), np.float32), np.empty((len(codes), OUTPUTS), np.float32)
        linear(codes, weight, bias, hidden)
        rectify(hidden)
        linear(hidden, *last, outputs)
        return outputs


@kernel
def convolve(values: Singles3, weight: Singles2, bias: Singles, patches: OutSingles2, out: OutSingles2) -> None:
    """A rectified convolution that halves rows and columns, beyond which there are zeros.

    Args:
        values: (channels, rows, columns), an even number of rows and columns.
        weight: (n, channels * KERNEL * KERNEL), by channel, then row of the kernel, then column.
        bias: (n,).
        patches: (channels * KERNEL * KERNEL, rows / 2 * columns / 2), a buffer.
        out: (n, rows / 2 * columns / 2), written to.
    """
    channels, rows, columns = values.shape
    half_rows, half_columns = rows // 2, columns // 2
    for channel in range(channels):
        for i in range(KERNEL):
            for j in range(KERNEL):
                patch = patches[(channel * KERNEL + i) * KERNEL + j]
                for r in range(half_rows):
                    # rows and columns are even: a kernel reaches beyond the first ones, and never beyond the last
                    row, begin = 2 * r + i - 1, r * half_columns
                    first = 1 if j == 0 else 0
                    if row < 0:
                        patch[begin : begin + half_columns] = float32(0.0)
                        continue
                    patch[begin] = float32(0.0)
                    for c in range(first, half_columns):
                        patch[begin + c] = values[channel, row, 2 * c + j - 1]
    rectified_product(weight, patches, bias, out)


def load_network(path: Path) -> SimnetNetwork:
    """Read what ``litsim_research train simnet`` has written.

    Raises:
        InputError: the file is missing, damaged, or holds another network than this version drives with.
    """
    _, arrays = read_network(path, "simnet", FORMAT)
    for name, shape in shapes().items():
        array = arrays.get(name)
        if array is None or array.shape != shape or array.dtype != np.float32:
            actual = "none" if array is None else f"{array.dtype} {array.shape}"
            raise InputError(f"{path}: tensor {name} is {actual}, expected float32 {shape}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: tensor {name} holds non-finite numbers, expected finite ones")
    return SimnetNetwork(arrays, path)


def shapes() -> dict[str, tuple[int, ...]]:
    """Returns shapes of the weights of the network."""
    weights: dict[str, tuple[int, ...]] = {}
    before = CHANNELS
    for number, width in enumerate(SMALL_WIDTHS):
        weights[f"convolution.{number}.weight"] = (width, before * KERNEL * KERNEL)
        weights[f"convolution.{number}.bias"] = (width,)
        before = width
    halved = 2 ** len(SMALL_WIDTHS)
    cells = (SMALL.rows // halved) * (SMALL.columns // halved)
    weights["hidden.weight"], weights["hidden.bias"] = (before * cells, SMALL_HIDDEN), (SMALL_HIDDEN,)
    weights["last.weight"], weights["last.bias"] = (SMALL_HIDDEN, OUTPUTS), (OUTPUTS,)
    return weights
