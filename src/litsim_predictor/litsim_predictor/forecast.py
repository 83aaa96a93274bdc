"""What every predictor is: which agents of a step it looks at, whose forecasts are read, and what it answers."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from enum import StrEnum
from typing import ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from litsim_sim.core.nearby import around
from litsim_sim.core.plugins import Configured
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, FloatArray, IntArray, index_of
from litsim_sim.kernels.compiled import Bools, Floats, Ints, kernel

Float32Array = npt.NDArray[np.float32]
DT_MIN_S = 1e-3
"""Least time between two steps of a forecast [s]."""
Egos = int | IntArray
"""Id of the ego, or ids of those of several scenes (scenes,)."""

MEETING_S = 3.0  # [s] within which agents may be taken over for each other: as far as detection looks, by default
MEETING_AHEAD = 20.0  # [m] from box to box, along the heading of the agent on its log
MEETING_ASIDE = 1.5  # [m] likewise, across it
STILL = 1e-6  # [m/s] slower is nearly not at all


@dataclass
class Modes:
    """Less probable alternatives of agents: q further futures over T steps, frame map.

    Only the most probable of these are among them; see `litsim_predictor.models.PredictorConfig.modes`.

    Attributes:
        row: (q,) of the agent in the forecast, ascending; an agent may have several, the most probable first, or none.
        probability: (q,) of the manoeuvre.
        mean, yaw, covariance: (q, T, 2), (q, T), (q, T, 3), each as in :class:`Forecast`.
    """

    row: IntArray
    probability: Float32Array
    mean: FloatArray
    yaw: Float32Array
    covariance: Float32Array

    @classmethod
    def none(cls, steps: int = 0) -> Modes:
        """Returns no further futures, of `steps` steps."""
        return cls(
            np.empty(0, np.int64),
            np.empty(0, np.float32),
            np.empty((0, steps, 2)),
            np.empty((0, steps), np.float32),
            np.empty((0, steps, 3), np.float32),
        )

    def __len__(self) -> int:
        return len(self.row)


@dataclass
class Forecast:
    """Joint forecast of n agents over T future steps, frame map.

    Mean, heading and covariance are those of each agent's most probable manoeuvre; what else it may do is in `modes`.

    Attributes:
        step: the step it starts from.
        dt: seconds between future steps; row 0 lies `dt` after `step`.
        id: (n,) agents, ascending; only those whose forecast is wanted.
        mean: (n, T, 2) box centres [m].
        yaw: (n, T) headings [rad].
        covariance: (n, T, 3) sigma_x [m], sigma_y [m], correlation of the Gaussian around `mean`.
        maneuver_probability: (n, K) of the latent manoeuvres; K = 0 where the predictor knows none.
        valid: (n,) whether the forecast may be used.
        modes: what agents may do instead.
    """

    step: int
    dt: float
    id: IntArray
    mean: FloatArray
    yaw: Float32Array
    covariance: Float32Array
    maneuver_probability: Float32Array
    valid: BoolArray
    modes: Modes = field(default_factory=Modes.none)

    @property
    def share(self) -> FloatArray:
        """(n,) probability of the most probable manoeuvre; 1 where the predictor knows none."""
        if not self.maneuver_probability.shape[1]:
            return np.ones(len(self.id))
        return self.maneuver_probability.max(axis=1).astype(np.float64)

    @classmethod
    def empty(cls, step: int, dt: float = STEP_S, maneuvers: int = 0) -> Forecast:
        """Returns the forecast of no agents, by a predictor that knows `maneuvers`."""
        narrow = np.empty((0, 0), np.float32)
        return cls(
            step=step,
            dt=dt,
            id=np.empty(0, np.int64),
            mean=np.empty((0, 0, 2)),
            yaw=narrow,
            covariance=np.empty((0, 0, 3), np.float32),
            maneuver_probability=np.empty((0, maneuvers), np.float32),
            valid=np.empty(0, np.bool_),
        )

    def rows(self, agents: IntArray) -> IntArray:
        """Returns the row of each of `agents` (m,), -1 where there is no valid forecast."""
        rows = index_of(self.id, agents)
        if not self.valid.all():
            rows[~self.valid[rows]] = -1
        return rows


class NoPredictor:
    """Forecasts no agent, for policies that need no forecasts."""

    def observe(self, table: AgentTable) -> None:
        """Nothing is remembered."""

    def forecast(self, table: AgentTable) -> Forecast:
        """Returns an empty forecast."""
        return Forecast.empty(table.step)


class Wanted(StrEnum):
    """Which of the agents of interest a predictor forecasts.

    READ: those that the conflict stage may read, see :func:`agents_read`; ALL: all of them; EGO: the ego alone.
    """

    READ = "read"
    ALL = "all"
    EGO = "ego"


@dataclass(frozen=True)
class Scope:
    """Whom a predictor forecasts, and what of it.

    Attributes:
        roi_m: radius around agents off their log within which agents are looked at [m].
        wanted: the agents that are forecast.
        modes: greatest number of manoeuvres of each besides the most probable one.
        along_lanes: whether learned models forecast along lanes that bend.
    """

    roi_m: float
    wanted: Wanted = Wanted.READ
    modes: int = 0
    along_lanes: bool = True


class Predictor(Protocol):
    """Forecasts traffic: one of both is called once a step, in order, and it keeps what history it needs."""

    @abstractmethod
    def observe(self, table: AgentTable) -> None:
        """Take note of a step for which no forecast is needed."""

    @abstractmethod
    def forecast(self, table: AgentTable) -> Forecast:
        """Forecast agents of `table` that matter to the ego and to those off their log; see :func:`selected`."""


class PredictorPlugin(Configured, Predictor):
    """A predictor that is a plug-in of ``litsim.predictors``.

    It is made for a run as ``cls(scenario, scope)``, or with its configuration as third argument if it has parameters.

    Attributes:
        batched: whether it also forecasts the agents of several scenes at once, which do not see each other.
    """

    batched: ClassVar[bool] = False


def selected(table: AgentTable, ego_id: Egos, roi_m: float, wanted: Wanted) -> tuple[AgentTable, IntArray]:
    """Returns the agents of interest, and the rows among them of those to forecast; both empty if there are none.

    Of interest are agents within `roi_m` [m] of the ego or of another agent off its log, those included.
    """
    off_log = table.off_log | table.mask(np.atleast_1d(ego_id))
    near = around(table, off_log, roi_m)
    if wanted == Wanted.ALL:
        forecast = near
    elif wanted == Wanted.EGO:
        forecast = near & table.mask(np.atleast_1d(ego_id))
    else:
        forecast = near & agents_read(table, off_log)
    return table.take(near), forecast[near].nonzero()[0]


def agents_read(table: AgentTable, off_log: BoolArray) -> BoolArray:
    """Returns the mask (n,) of the agents whose forecast the conflict stage reads, or may read.

    It reads those of agents that are `off_log` (n,), the ego among them; and, as soon as it has taken an agent over,
    that agent's in the same step, to look for others in conflict with it. Which that will be is not known yet, so these
    include all that may be taken over: whose boxes come within :data:`MEETING_AHEAD` and :data:`MEETING_ASIDE` of the
    box of an agent off its log, within :data:`MEETING_S`, all at their present velocities. Others can be taken over,
    too: they have no forecast in that one step, and are off their logs from the next on.
    """
    agents, others = (~off_log).nonzero()[0], off_log.nonzero()[0]
    if not len(agents) or not len(others):
        return off_log
    cos, sin = np.cos(table.yaw), np.sin(table.yaw)
    return off_log | _meeting(table.arrays, cos, sin, agents, others)


@kernel
def _meeting(table: AgentArrays, cos: Floats, sin: Floats, agents: Ints, others: Ints) -> Bools:
    """Mask (n,) of those in the rows `agents` that come close to one in the rows `others`; see :func:`agents_read`.

    `cos` and `sin` (n,) are those of the headings.
    """
    scene, x, y, speed, length, width = table.scene, table.x, table.y, table.speed, table.length, table.width
    meets, vx, vy = np.zeros(len(x), np.bool_), speed * cos, speed * sin
    # how far an agent may be from another, together with what is as far of the other
    half = 0.5 * (MEETING_AHEAD + MEETING_ASIDE + length + width) + MEETING_S * (np.abs(speed) + STILL)
    for i in agents:
        for j in others:
            dx, dy = x[j] - x[i], y[j] - y[i]
            if scene[j] != scene[i] or dx * dx + dy * dy > (half[i] + half[j]) ** 2:
                continue
            faster_x, faster_y = vx[j] - vx[i], vy[j] - vy[i]
            # Along and across the heading of the agent, each is within reach for one span of time; do both, and the
            # time that is looked at, have one in common?
            place = (cos[i] * dx + sin[i] * dy, cos[i] * dy - sin[i] * dx)
            velocity = (cos[i] * faster_x + sin[i] * faster_y, cos[i] * faster_y - sin[i] * faster_x)
            reach = (
                MEETING_AHEAD + 0.5 * (length[i] + length[j]),
                MEETING_ASIDE + 0.5 * (width[i] + width[j]),
            )
            begin, end = 0.0, MEETING_S
            for k in range(2):
                moves = STILL if abs(velocity[k]) < STILL else velocity[k]
                first, last = (-reach[k] - place[k]) / moves, (reach[k] - place[k]) / moves
                begin, end = max(begin, min(first, last)), min(end, max(first, last))
            if begin <= end:
                meets[i] = True
                break
    return meets
