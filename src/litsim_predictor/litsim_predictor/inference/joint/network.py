"""The joint predictor run by compiled kernels, from its trained weights alone: without torch and without a graph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.contract import (
    DT,
    HISTORY,
    HISTORY_CHANNELS,
    HORIZON,
    MANEUVERS,
    MODE_SHARE,
    STATE_CHANNELS,
    AgentFutures,
    AgentInputs,
    FurtherFutures,
)
from litsim_predictor.inference.dense_kernels import add_and_normalise, linear, rectified_linear
from litsim_predictor.inference.joint.attention_kernels import attend, relate_neighbours
from litsim_predictor.inference.joint.kernels import (
    choose_maneuvers,
    further_maneuvers,
    read_histories,
    write_gaussians,
)
from litsim_predictor.inference.joint.map_kernels import (
    HALF_COLUMNS,
    HALF_ROWS,
    KERNEL,
    QUARTER_COLUMNS,
    QUARTER_ROWS,
    encode_maps,
    starts_apart,
    starts_in_halves,
)
from litsim_predictor.inference.joint.parameters import JointParameters
from litsim_predictor.inference.joint.units import (
    DEVIATION_UNITS,
    GAUSSIAN_CHANNELS,
    MAP_MIDDLE,
    RELATION_CHANNELS,
    RELATION_UNITS,
    RELATION_WIDTH,
    STATE_UNITS,
    TRAFFIC_CHANNELS,
    TRAFFIC_PLACES,
    TRAFFIC_UNITS,
)
from litsim_predictor.inference.map_memory import MapMemory
from litsim_predictor.inference.raster import CHANNELS
from litsim_predictor.inference.weights import Weights
from litsim_sim.core.scene import ByteArray, IntArray


def runs(weights: Weights) -> bool:
    """Whether :class:`JointNetwork` runs the model of these weights.

    Raises:
        InputError: they are of a joint predictor with parameters that it cannot have.
    """
    if weights.provenance.model != "joint":
        return False
    parameters = weights.parameters(JointParameters)
    return (parameters.attention, parameters.history, parameters.decoder) == ("codes", "direct", "direct")


class Linear:
    """A layer y = x W + b, rectified or not.

    Args:
        weight: (out, in), as trained.
        bias: (out,).
        units: (in,) by which its inputs are divided.
        rectified: whether negative values become 0.
    """

    def __init__(
        self, weight: Float32Array, bias: Float32Array, units: Sequence[float] = (1.0,), *, rectified: bool = False
    ) -> None:
        self.weight: Float32Array = np.ascontiguousarray((weight / np.array(units, np.float32)).T)
        self.bias, self._write = bias, rectified_linear if rectified else linear

    def __call__(self, values: Float32Array) -> Float32Array:
        """Returns outputs (n, out) for `values` (n, in)."""
        out = np.empty((len(values), len(self.bias)), np.float32)
        self._write(values, self.weight, self.bias, out)
        return out


class MapEncoder:
    """Encodes maps, and remembers the codes."""

    def __init__(self, arrays: Mapping[str, Float32Array]) -> None:
        channels = len(arrays["map.layers.0.bias"])
        scale = (np.float32(MAP_MIDDLE), np.float32(1.0), np.float32(1.0))
        starts = (
            starts_in_halves(CHANNELS),
            starts_apart(channels, HALF_ROWS, HALF_COLUMNS),
            starts_apart(channels, QUARTER_ROWS, QUARTER_COLUMNS),
        )
        self._convolutions: tuple[Any, ...] = ()
        for layer, unit, start in zip((0, 2, 5), scale, starts, strict=True):
            weight = (arrays[f"map.layers.{layer}.weight"] / unit).reshape(channels, -1)
            self._convolutions += (start, weight, arrays[f"map.layers.{layer}.bias"])
        self._last = Linear(arrays["map.layers.8.weight"], arrays["map.layers.8.bias"], rectified=True)
        self._memory = MapMemory(len(self._last.bias))

    def __call__(self, raster: ByteArray) -> Float32Array:
        """Returns codes (n, width) of maps (n, CHANNELS, ROWS, COLUMNS)."""
        maps = self._memory.look_up(raster)
        if not len(maps.new):
            return maps.known[maps.code_of]
        convolved = np.empty((len(maps.new), self._last.weight.shape[0]), np.float32)
        encode_maps(maps.new, convolved, *self._convolutions)
        codes = self._last(convolved)
        self._memory.keep(maps, codes)
        return np.concatenate([maps.known, codes])[maps.code_of]


class HistoryEncoder:
    """Encodes histories."""

    def __init__(self, arrays: Mapping[str, Float32Array]) -> None:
        self._first = Linear(
            arrays["history.layers.0.weight"],
            arrays["history.layers.0.bias"],
            (*DEVIATION_UNITS, 1.0) * HISTORY,
            rectified=True,
        )
        self._last = Linear(arrays["history.layers.2.weight"], arrays["history.layers.2.bias"], rectified=True)

    def __call__(self, inputs: AgentInputs) -> Float32Array:
        """Returns codes (n, width)."""
        read = np.empty((len(inputs.history), HISTORY, HISTORY_CHANNELS + 1), np.float32)
        read_histories(inputs.history, inputs.observed, DT, read)
        return self._last(self._first(read.reshape(len(read), -1)))


@dataclass
class Neighbours:
    """Neighbours of some of n agents; see :func:`.attention_kernels.relate_neighbours`."""

    index: IntArray
    many: IntArray
    relation: Float32Array


class Attention:
    """Attention of agents to their neighbours.

    Args:
        arrays: of this layer.
        heads: of it.
    """

    def __init__(self, arrays: Mapping[str, Float32Array], heads: int) -> None:
        weight, bias = arrays["query.weight"], arrays["query.bias"]
        size = len(bias) // heads
        scale = np.float32(size**-0.5)
        self._query = Linear(weight * scale, bias * scale)
        of_relation, relation_bias = arrays["relation.2.weight"], arrays["relation.2.bias"]
        self._key_value = Linear(arrays["key_value.weight"], arrays["key_value.bias"] + relation_bias)
        related = arrays["relation.0.weight"] / np.array(RELATION_UNITS, np.float32)
        of_key, of_value = of_relation.reshape(2, heads, size, -1)
        self._related: tuple[Any, ...] = (
            related,
            arrays["relation.0.bias"],
            np.ascontiguousarray(of_key.swapaxes(1, 2)),
            of_value,
        )
        self._out = Linear(arrays["out.weight"], arrays["out.bias"])
        self._norm = (arrays["norm.weight"], arrays["norm.bias"])

    def __call__(self, agents: Float32Array, near: Neighbours, rows: IntArray) -> Float32Array:
        """The codes (m, W) of the `rows` (m,) of `agents` (n, W), after attention, with residual and normalisation."""
        asking = agents[rows]
        attended, out = np.empty_like(asking), np.empty_like(asking)
        key_value = self._key_value(agents)
        attend(self._query(asking), rows, key_value, near.index, near.many, near.relation, attended, *self._related)
        add_and_normalise(asking, self._out(attended), *self._norm, out)
        return out


class JointNetwork:
    """A joint predictor for inference; equal scenes give equal bits, in every process and beside any other scenes.

    Args:
        weights: of a model for which :func:`runs` is True.

    Raises:
        InputError: the weights are not those of such a model.
    """

    def __init__(self, weights: Weights) -> None:
        parameters = weights.parameters(JointParameters)
        weights.check(shapes(parameters))
        arrays, self.source = weights.arrays, str(weights.path)
        self.sees_signals = weights.provenance.sees_signals
        self._neighbours, self._reach, self._traffic = parameters.neighbours, parameters.reach, parameters.traffic
        self._maps, self._histories = MapEncoder(arrays), HistoryEncoder(arrays)
        units = STATE_UNITS + TRAFFIC_UNITS * (TRAFFIC_PLACES * self._traffic)
        self._states = Linear(arrays["state.0.weight"], arrays["state.0.bias"], units, rectified=True)
        self._layers = [
            Attention(_part(arrays, f"relative.{layer}."), parameters.heads) for layer in range(parameters.layers)
        ]
        self._hidden, self._logits = (
            Linear(arrays[f"maneuver.{layer}.weight"], arrays[f"maneuver.{layer}.bias"], rectified=layer == 0)
            for layer in (0, 2)
        )
        self._maneuvers = arrays["decoder.maneuver.weight"]
        self._decoder = [
            Linear(
                arrays[f"decoder.layers.{layer}.weight"], arrays[f"decoder.layers.{layer}.bias"], rectified=layer < 4
            )
            for layer in (0, 2, 4)
        ]

    def __call__(self, inputs: AgentInputs, asked: IntArray, modes: int = 0) -> AgentFutures:
        """See :class:`.contract.Network`."""
        return self.of_scenes(inputs, asked, np.zeros(1, np.int64), modes)

    def of_scenes(self, inputs: AgentInputs, asked: IntArray, begins: IntArray, modes: int = 0) -> AgentFutures:
        """See :class:`.contract.NetworkOfScenes`."""
        states = np.concatenate([inputs.state, inputs.traffic], axis=1) if self._traffic else inputs.state
        agents = np.concatenate([self._maps(inputs.raster), self._histories(inputs), self._states(states)], axis=1)
        everybody = np.arange(len(agents))
        near = self._near(inputs, begins, everybody if len(self._layers) > 1 else asked)
        for layer in self._layers[:-1]:
            agents = layer(agents, near, everybody)
        return self._decoded(self._layers[-1](agents, near, asked), inputs.state[asked], modes)

    def _near(self, inputs: AgentInputs, begins: IntArray, rows: IntArray) -> Neighbours:
        """Returns the neighbours of the agents in `rows` (m,)."""
        n = len(inputs.frame)
        most = min(self._neighbours + 1, n)
        near = Neighbours(
            np.empty((n, most), np.int64), np.empty(n, np.int64), np.empty((n, most, RELATION_CHANNELS), np.float32)
        )
        speed, written = inputs.state[:, 2], (near.index, near.many, near.relation)
        relate_neighbours(inputs.frame, speed, begins, rows, self._reach, *written)
        return near

    def _decoded(self, agents: Float32Array, state: Float32Array, modes: int) -> AgentFutures:
        """Returns the futures of agents (m, W): of the most probable manoeuvre, and of at most `modes` others."""
        m = len(agents)
        maneuver, best = np.empty((m, len(MANEUVERS)), np.float32), np.empty(m, np.int64)
        choose_maneuvers(self._logits(self._hidden(agents)), maneuver, best)
        row, other = further_maneuvers(maneuver, best, min(modes, len(MANEUVERS)), MODE_SHARE)
        rows, chosen = np.concatenate([np.arange(m), row]), np.concatenate([best, other])
        raw = agents[rows] + self._maneuvers[chosen]
        for layer in self._decoder:
            raw = layer(raw)
        mean, scale = np.empty((len(rows), HORIZON, 2), np.float32), np.empty((len(rows), HORIZON, 2), np.float32)
        correlation = np.empty((len(rows), HORIZON), np.float32)
        write_gaussians(raw.reshape(len(rows), HORIZON, GAUSSIAN_CHANNELS), state[rows], DT, mean, scale, correlation)
        further = FurtherFutures(row, other, mean[m:], scale[m:], correlation[m:])
        return AgentFutures(maneuver, mean[:m], scale[:m], correlation[:m], further)


def shapes(parameters: JointParameters) -> dict[str, tuple[int, ...]]:
    """Returns the shapes of the weights of a joint predictor that kernels run, by their names in its model of torch."""
    maps, channels, hidden = parameters.map_width, parameters.map_channels, parameters.hidden
    history, state, width = parameters.history_width, parameters.state_width, parameters.width
    by_name: dict[str, tuple[int, ...]] = {}

    def layer(name: str, *shape: int) -> None:
        by_name[f"{name}.weight"], by_name[f"{name}.bias"] = shape, shape[:1]

    layer("map.layers.0", channels, CHANNELS, KERNEL, KERNEL)
    layer("map.layers.2", channels, channels, KERNEL, KERNEL)
    layer("map.layers.5", channels, channels, KERNEL, KERNEL)
    layer("map.layers.8", maps, channels * QUARTER_ROWS * QUARTER_COLUMNS)
    layer("history.layers.0", 2 * history, HISTORY * (HISTORY_CHANNELS + 1))
    layer("history.layers.2", history, 2 * history)
    layer("state.0", state, STATE_CHANNELS + TRAFFIC_CHANNELS * parameters.traffic)
    for number in range(parameters.layers):
        for name, out in (("query", width), ("key_value", 2 * width), ("out", width)):
            layer(f"relative.{number}.{name}", out, width)
        layer(f"relative.{number}.relation.0", RELATION_WIDTH, RELATION_CHANNELS)
        layer(f"relative.{number}.relation.2", 2 * width, RELATION_WIDTH)
        layer(f"relative.{number}.norm", width)
    layer("maneuver.0", hidden, width)
    layer("maneuver.2", len(MANEUVERS), hidden)
    by_name["decoder.maneuver.weight"] = (len(MANEUVERS), width)
    for number, shape in ((0, (hidden, width)), (2, (hidden, hidden)), (4, (HORIZON * GAUSSIAN_CHANNELS, hidden))):
        layer(f"decoder.layers.{number}", *shape)
    return by_name


def _part(arrays: Mapping[str, Float32Array], prefix: str) -> dict[str, Float32Array]:
    """Returns the weights whose names begin with `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
