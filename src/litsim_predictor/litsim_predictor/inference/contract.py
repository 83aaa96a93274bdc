"""What every learned predictor reads and answers: rates, lengths and channels, for training and driving alike.

Each agent has a frame of its own: origin at its box centre now, x along the lane it drives on (along its own heading
where it is on none), y to the left, metres. Histories and futures are given in it, so that a model never sees where on
the earth a scene is.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from litsim_predictor.forecast import Float32Array
from litsim_sim.core.quantities import Whole
from litsim_sim.core.scene import STEP_S, BoolArray, ByteArray, FloatArray, IntArray

DT = 0.2
"""[s] between steps of history and future: NGSIM's 10 Hz subsampled to 5 Hz, as is usual in prediction."""
STRIDE = round(DT / STEP_S)
"""Steps of the simulation, or frames of a recording, between two steps of a model."""
HISTORY = 16
"""Steps of history, the present included: 3 s."""
HORIZON = 25
"""Steps of the future: 5 s."""
SECONDS = tuple(range(1, round(HORIZON * DT) + 1))
"""Horizons for which measures are reported [s]."""
AT_SECONDS = slice(round(1.0 / DT) - 1, None, round(1.0 / DT))
"""The steps of the future at :data:`SECONDS`."""
HISTORY_CHANNELS = 4
"""x [m], y [m], yaw relative to the agent frame [rad], speed [m/s]."""
SPEED_CHANNEL = 3
STATE_CHANNELS = 4
"""length [m], width [m], speed [m/s], yaw relative to the agent frame [rad]."""
LATERAL = ("keep", "left", "right")
LONGITUDINAL = ("keep", "accelerate", "brake")
MANEUVERS = tuple(f"{lateral}/{longitudinal}" for lateral in LATERAL for longitudinal in LONGITUDINAL)
"""Manoeuvre m is LATERAL[m // 3] with LONGITUDINAL[m % 3]."""
MODE_SHARE = 0.05
"""Least probability of a further manoeuvre that is forecast.

Three of these give some 8 points more recall of conflicts at equal precision, at no measurable cost."""
LayerWidth = Annotated[Whole, Field(gt=0, le=1024)]
"""Outputs of a layer of a network, in configurations; no network of such layers exceeds the memory."""


@dataclass
class AgentInputs:
    """What a model reads of the n agents of a scene.

    Attributes:
        frame: (n, 3) origin x, y [m] and heading [rad] of the agent frames in frame map.
        history: (n, HISTORY, HISTORY_CHANNELS) oldest first, the present last; zeros where not observed.
        observed: (n, HISTORY); the present is observed for every agent.
        state: (n, STATE_CHANNELS).
        raster: (n, C, H, W) map around each agent in its frame; see :mod:`.raster`.
        traffic: (n, TRAFFIC_CHANNELS) ahead of each agent; see :mod:`.traffic`.
    """

    frame: FloatArray
    history: Float32Array
    observed: BoolArray
    state: Float32Array
    raster: ByteArray
    traffic: Float32Array

    def take(self, rows: IntArray | BoolArray | slice) -> AgentInputs:
        """Returns the inputs of the agents in `rows`."""
        return AgentInputs(*(getattr(self, column.name)[rows] for column in fields(AgentInputs)))


@dataclass
class FurtherFutures:
    """What a model answers beside the most probable manoeuvres of n agents: the Gaussians of q further ones.

    Attributes:
        row: (q,) of the agent, ascending; of one agent, the most probable first.
        maneuver: (q,) number of the manoeuvre.
        mean, scale, correlation: (q, HORIZON, 2), (q, HORIZON, 2), (q, HORIZON), as in :class:`AgentFutures`.
    """

    row: IntArray
    maneuver: IntArray
    mean: Float32Array
    scale: Float32Array
    correlation: Float32Array

    @classmethod
    def none(cls) -> FurtherFutures:
        """Return no further futures."""
        whole, wide = np.empty(0, np.int64), np.empty((0, HORIZON, 2), np.float32)
        return cls(whole, whole, wide, wide, np.empty((0, HORIZON), np.float32))


@dataclass
class AgentFutures:
    """What a model answers of n agents of a scene: the Gaussians of their most probable manoeuvres, and further ones.

    Attributes:
        maneuver: (n, K) probabilities.
        mean: (n, HORIZON, 2) in the agent frames [m].
        scale: (n, HORIZON, 2) standard deviations along x and y [m].
        correlation: (n, HORIZON).
        further: Gaussians of further manoeuvres.
    """

    maneuver: Float32Array
    mean: Float32Array
    scale: Float32Array
    correlation: Float32Array
    further: FurtherFutures = field(default_factory=FurtherFutures.none)


class Network(Protocol):
    """A trained model, independent of what runs it.

    Attributes:
        source: the file of its weights, for errors.
        sees_signals: whether it is to be shown closed stop lines; see :mod:`.closed_lines`.
    """

    source: str
    sees_signals: bool

    def __call__(self, inputs: AgentInputs, asked: IntArray, modes: int = 0) -> AgentFutures:
        """Predict the agents of a scene in the rows `asked` (m,), at least one, in that order; it sees all agents.

        Networks that are run by kernels also answer with at most `modes` further manoeuvres of each agent, whose
        probabilities are at least MODE_SHARE. Graphs and eager models answer with the most probable manoeuvre alone.
        """


@runtime_checkable
class NetworkOfManeuvers(Network, Protocol):
    """A network that also answers with a manoeuvre that is asked for, in place of the most probable one."""

    def of_maneuver(self, inputs: AgentInputs, asked: IntArray, maneuver: int) -> AgentFutures:
        """As :class:`Network`, with the Gaussians of `maneuver`, a number in MANEUVERS."""


@runtime_checkable
class NetworkOfScenes(Network, Protocol):
    """A network that answers for several scenes at once, with the same bits as for each of them on its own."""

    def of_scenes(self, inputs: AgentInputs, asked: IntArray, begins: IntArray, modes: int = 0) -> AgentFutures:
        """As :class:`Network`, for agents of several scenes, which begin at the rows `begins` (S,), the first at 0."""
