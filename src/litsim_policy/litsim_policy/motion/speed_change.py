"""By how much people change their speed within a second, behind a leader: a density, and the chance of a gain.

The density is a mixture of Gaussians whose parameters come from a small network, the mean of several that were trained
from different seeds. ``litsim_research train reactions`` fits it to recorded car following.
"""

from __future__ import annotations

import math
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np

from litsim_policy.motion.network_file import read_network
from litsim_sim.core.errors import InputError
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import FloatArray
from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, OutFloats, OutFloats2, kernel

FORMAT = "litsim speed changes, 1"
PACKAGED = "weights/speed_change.safetensors"
LOOK_S = 1.0  # [s] over which the speed changes
INPUTS, HIDDEN, GAUSSIANS = 7, 24, 3  # sizes of the networks
FAR = 80.0  # [m] gap that stands for no leader
USUAL_HEADWAY = 1.4  # [s] that counts for drivers of whom no headway is known
LOG_SPREAD_MIN, LOG_SPREAD_MAX = -2.3, 1.5  # bounds on logarithms of standard deviations [m/s]
CHANCE_MIN = 1e-4  # least probability: beyond, the density is extrapolated
LAYERS = ("first", "second", "last")


class Situation(NamedTuple):
    """What a driver reacts to.

    Attributes:
        speed: own [m/s].
        gap: to the leader, from bumper to bumper [m]; FAR for none.
        closing: own speed less that of the leader [m/s].
        leader_acceleration: over the last half second [m/s2].
        usual_headway: gap over speed that this driver usually keeps [s].
    """

    speed: float
    gap: float
    closing: float
    leader_acceleration: float
    usual_headway: float


class SpeedChange(NamedTuple):
    """Networks, e of them, of two hidden layers; arrays (e, inputs, outputs) and (e, outputs) of each layer."""

    first: Floats3
    first_bias: Floats2
    second: Floats3
    second_bias: Floats2
    last: Floats3
    last_bias: Floats2


@cache
def packaged_speed_change() -> SpeedChange:
    """Returns the packaged density."""
    return load_speed_change(Path(str(resources.files("litsim_policy").joinpath(PACKAGED))))


def load_speed_change(path: Path) -> SpeedChange:
    """Returns the density in the file `path`.

    Raises:
        InputError: the file is missing, damaged, or holds other networks.
    """
    _, tensors = read_network(path, "the density of speed changes", FORMAT)
    sizes = (INPUTS, HIDDEN, HIDDEN, 3 * GAUSSIANS)
    arrays: list[FloatArray] = []
    for k, layer in enumerate(LAYERS):
        weight, bias = (tensors.get(f"{layer}.{part}", np.empty(0)) for part in ("weight", "bias"))
        if weight.shape[1:] != sizes[k : k + 2] or bias.shape != (len(weight), sizes[k + 1]):
            raise InputError(f"{path}: tensors {layer} have shapes {weight.shape} and {bias.shape}, expected {sizes}")
        arrays += [weight.astype(np.float64), bias.astype(np.float64)]
    return SpeedChange(*arrays)


@kernel
def write_features(situation: Situation, features: OutFloats) -> None:
    """Write what the networks read of a situation to `features` (INPUTS,); beyond the bounds, the nearest counts."""
    speed, gap = within(situation.speed, 0.0, 30.0), within(situation.gap, 0.3, FAR)
    closing = within(situation.closing, -6.0, 8.0)
    features[0] = speed / 10.0
    features[1] = math.log(gap) - 2.0
    features[2] = closing / 2.0
    features[3] = within(situation.leader_acceleration, -4.0, 3.0)
    features[4] = 3.0 * math.tanh(closing / max(gap, 1.0))
    features[5] = gap / max(speed, 2.0) - 1.5
    features[6] = within(situation.usual_headway, 0.4, 3.0) - USUAL_HEADWAY


@kernel
def features_of(
    speed: Floats, gap: Floats, closing: Floats, leader_acceleration: Floats, usual_headway: Floats
) -> OutFloats2:
    """Returns what the networks read (m, INPUTS) of m situations; arrays (m,) as in :class:`Situation`."""
    features = np.empty((len(speed), INPUTS))
    for k in range(len(speed)):
        situation = Situation(speed[k], gap[k], closing[k], leader_acceleration[k], usual_headway[k])
        write_features(situation, features[k])
    return features


@kernel
def _layer(inputs: Floats, weight: Floats2, bias: Floats, outputs: OutFloats) -> None:
    """Write what a dense layer makes of `inputs` to `outputs`."""
    for k in range(len(outputs)):
        outputs[k] = bias[k]
    for i in range(len(inputs)):
        for k in range(len(outputs)):
            outputs[k] += inputs[i] * weight[i, k]


@kernel
def _last_layer(inputs: Floats, weight: Floats2, bias: Floats, outputs: OutFloats) -> None:
    """Write what the last layer makes of `inputs` to `outputs`, three at a time: so few are faster in registers."""
    for k in range(0, 3 * GAUSSIANS, 3):
        a, b, c = bias[k], bias[k + 1], bias[k + 2]
        for i in range(HIDDEN):
            a += inputs[i] * weight[i, k]
            b += inputs[i] * weight[i, k + 1]
            c += inputs[i] * weight[i, k + 2]
        outputs[k], outputs[k + 1], outputs[k + 2] = a, b, c


@kernel
def _squash(values: OutFloats) -> None:
    """Replace `values` by their hyperbolic tangents; `math.tanh` branches by value, and takes three times as long."""
    for k in range(len(values)):
        values[k] = 1.0 - 2.0 / (math.exp(2.0 * values[k]) + 1.0)


@kernel
def _chance_of(change: float, mixture: Floats) -> float:
    """Returns the probability of at least `change` [m/s]; a mixture is logits, then means, then log-spreads."""
    top = mixture[0]
    for k in range(1, GAUSSIANS):
        top = max(top, mixture[k])
    total, chance = 0.0, 0.0
    for k in range(GAUSSIANS):
        weight = math.exp(mixture[k] - top)
        spread = math.exp(within(mixture[2 * GAUSSIANS + k], LOG_SPREAD_MIN, LOG_SPREAD_MAX))
        total += weight
        chance += weight * 0.5 * math.erfc((change - mixture[GAUSSIANS + k]) / (spread * math.sqrt(2.0)))
    return chance / total


@kernel
def log_chance(change: float, situation: Situation, density: SpeedChange) -> float:
    """Returns the logarithm of the probability that people gain at least `change` [m/s] within LOOK_S."""
    features, hidden, deep = np.empty(INPUTS), np.empty(HIDDEN), np.empty(HIDDEN)
    output = np.empty(3 * GAUSSIANS)
    write_features(situation, features)
    chance, count = 0.0, len(density.first)
    for e in range(count):
        _layer(features, density.first[e], density.first_bias[e], hidden)
        _squash(hidden)
        _layer(hidden, density.second[e], density.second_bias[e], deep)
        _squash(deep)
        _last_layer(deep, density.last[e], density.last_bias[e], output)
        chance += _chance_of(change, output)
    return math.log(max(chance / count, CHANCE_MIN))
