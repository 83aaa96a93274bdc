"""Training samples of SimNet: rasters of recorded agents, and their future poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from litsim_predictor.inference.raster import raster_of_net
from litsim_research.baselines.simnet.output import FUTURE, OUTPUTS
from litsim_research.baselines.simnet.raster import CHANNELS, FRAMES, SMALL, Motions, Painter, Rasters
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.quantities import Angle, Duration, Length, NonNegative, Positive, Share, Speed, configuration
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario

PAST_S = np.arange(1 - FRAMES, 1) * STEP_S
FUTURE_S = np.arange(1, FUTURE + 1) * STEP_S
RASTERS_MAX = 4 * 2**30  # [B] of a batch, or of a validation
UNIT_MIN = 1e-3  # [m], [rad] least unit, for traffic in which no agent accelerates or turns


@configuration
class PerturbationConfig:
    """Displacement of some agents, with futures that lead back, from which the network learns to correct its errors.

    Attributes:
        share: share of the agents that are displaced, if they drive at `speed_min` or faster.
        offset: standard deviation, to the side [m].
        turn: likewise, of the heading [rad].
        ahead: likewise, along the path [m].
        speed: likewise, of the speed [m/s].
        back_s: time constant of the return to the log's path, critically damped [s].
        along_back_s: likewise, of the return to the log's position and speed along the path [s].
        speed_min: [m/s].
    """

    share: Share = 0.5
    offset: NonNegative[Length] = 0.4
    turn: NonNegative[Angle] = 0.03
    ahead: NonNegative[Length] = 1.5
    speed: NonNegative[Speed] = 1.0
    back_s: Positive[Duration] = 0.8
    along_back_s: Positive[Duration] = 2.0
    speed_min: Positive[Speed] = 3.0


@dataclass(frozen=True)
class Samples:
    """Samples of b agents, each at one moment.

    Attributes:
        rasters: (b, CHANNELS, rows, columns), or (b,) without content.
        futures: (b, OUTPUTS) future poses in the agent's frame [m], [rad].
        way: (b,) distance moved in the last step [m]; 0 if unknown.
        known: (b,) whether `way` is known.
    """

    rasters: Rasters
    futures: FloatArray
    way: FloatArray
    known: BoolArray

    @classmethod
    def joined(cls, parts: Sequence[Samples]) -> Samples:
        """Return `parts` concatenated."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @property
    def units(self) -> FloatArray:
        """Root mean squares (OUTPUTS,) of the deviations of the futures from straight driving at constant speed.

        The network is to learn acceleration and turning. In the first step, the only one that is executed in
        simulation, they make up a hundredth of the distance.
        """
        on = self.way[:, None] * np.arange(1, FUTURE + 1)
        deviation = self.futures.reshape(-1, FUTURE, 3).copy()
        deviation[..., 0] -= on
        spread: FloatArray = np.sqrt((deviation[self.known] ** 2).mean(axis=0)).ravel()
        return np.maximum(spread, UNIT_MIN)


@dataclass(frozen=True)
class _Source:
    """A scenario from which moments are drawn.

    Attributes:
        scenario: the scenario.
        painter: of its net and signals.
        usable: (n, steps) mask of the agents that are vehicles and stay for another FUTURE steps.
        steps: (k,) steps with usable agents.
        share: (k,) probabilities of these steps, proportional to the number of usable agents.
    """

    scenario: Scenario
    painter: Painter
    usable: BoolArray
    steps: IntArray
    share: FloatArray

    @classmethod
    def of(cls, scenario: Scenario) -> _Source:
        log = scenario.log
        usable = log.valid & ~log.obstacle[:, None]
        usable &= np.arange(log.steps) + FUTURE <= log.last_step[:, None]
        counts = usable.sum(axis=0)
        steps = np.flatnonzero(counts)
        painter = Painter(raster_of_net(scenario.net_path)[1].drawn, scenario.signals)
        return cls(scenario, painter, usable, steps, counts[steps] / max(counts.sum(), 1))


class Moments:
    """Draws samples of agents at moments of scenarios.

    Args:
        scenarios: the sources.
        shares: weights of the scenarios' agents, in any unit.
        perturbation: of the agents; None for none.

    Raises:
        InputError: no agent stays long enough.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        shares: Sequence[float],
        perturbation: PerturbationConfig | None = None,
    ) -> None:
        self._sources = [_Source.of(scenario) for scenario in scenarios]
        counts = np.array([source.usable.sum() for source in self._sources], np.float64)
        if not counts.sum():
            raise InputError(f"data: no vehicle is on the road for {FUTURE + 1} steps, expected some in the scenarios")
        weight = counts * np.array(shares)
        self._share: FloatArray = weight / weight.sum()
        self._perturbation = perturbation
        self._most = max(int(source.usable.sum(axis=0).max()) for source in self._sources)
        self._raster_bytes = CHANNELS * SMALL.rows * SMALL.columns * np.dtype(np.float32).itemsize

    def draw(self, moments: int, agents: int, random: np.random.Generator, *, painted: bool = True) -> Samples:
        """Samples of at most `agents` agents at each of `moments` moments; without rasters unless `painted`.

        Raises:
            InputError: their rasters could take more than RASTERS_MAX.
        """
        most, fit = moments * min(agents, self._most), RASTERS_MAX // self._raster_bytes
        if painted and most > fit:
            raise InputError(
                f"training configuration: {moments} moments of up to {min(agents, self._most)} agents are {most} "
                f"rasters, expected at most {fit}: choose less for moments, validation_moments or agents"
            )
        return Samples.joined([self._moment(agents, random, painted=painted) for _ in range(moments)])

    def _moment(self, agents: int, random: np.random.Generator, *, painted: bool) -> Samples:
        source = self._sources[random.choice(len(self._sources), p=self._share)]
        step = int(random.choice(source.steps, p=source.share))
        log = source.scenario.log
        usable = np.flatnonzero(source.usable[:, step])
        chosen = np.sort(random.permutation(usable)[:agents])
        here = np.flatnonzero(log.valid[:, step])
        past = np.arange(step + 1 - FRAMES, step + 1)
        motions = Motions(
            _poses(source.scenario, here, np.maximum(past, 0)),
            log.valid[here][:, np.maximum(past, 0)] & (past >= 0),
            np.stack([log.length[here], log.width[here]], axis=-1),
            np.zeros(len(here), np.int64),
        )
        rows = np.searchsorted(here, chosen)
        own, future = motions.pose[rows], _poses(source.scenario, chosen, step + np.arange(1, FUTURE + 1))
        if self._perturbation is not None:
            own, future = perturbed(own, future, log.speed[chosen, step], self._perturbation, random)
        has_next = motions.there[rows][:, -2]
        way = np.where(has_next, np.hypot(*(own[:, -1, :2] - own[:, -2, :2]).T), 0.0)
        rasters = source.painter.draw(step, motions, rows, own).copy() if painted else np.empty(len(rows), np.float32)
        return Samples(rasters, relative(own[:, -1], future), way, has_next)


def relative(present: FloatArray, future: FloatArray) -> FloatArray:
    """Poses (m, FUTURE, 3) in the frames of the present ones (m, 3), as outputs (m, OUTPUTS): ahead, left and turn."""
    ahead, left = to_body(
        future[..., 0] - present[:, None, 0], future[..., 1] - present[:, None, 1], present[:, None, 2]
    )
    turn = wrap_angle(future[..., 2] - present[:, None, 2])
    return np.stack([ahead, left, turn], axis=-1).reshape(len(future), OUTPUTS)


def perturbed(
    own: FloatArray, future: FloatArray, speed: FloatArray, config: PerturbationConfig, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Displace some of m agents, with futures that lead back to the log.

    Args:
        own: (m, FRAMES, 3) past and present poses.
        future: (m, FUTURE, 3) poses.
        speed: (m,) now [m/s].
        config: share and size of the displacements.
        random: generator of the draws.

    Returns:
        both, displaced: the past with constant heading and speed errors, the future returning to the log.
    """
    m = len(own)
    deviations = np.array([config.offset, config.turn, config.ahead, config.speed])
    draws = random.standard_normal((4, m)) * deviations[:, None]
    offset, turn, ahead, faster = draws * ((random.random(m) < config.share) & (speed >= config.speed_min))
    faster = np.maximum(faster, -0.5 * speed)  # no agent drives backwards
    drift = speed * np.tan(turn)
    along, _ = _way_back(ahead, faster, config.along_back_s)
    side, side_rate = _way_back(offset, drift, config.back_s)
    lead = np.maximum(speed, config.speed_min)[:, None]
    past_along, past_side = ahead[:, None] + faster[:, None] * PAST_S, offset[:, None] + drift[:, None] * PAST_S
    return (
        _moved(own, past_along, past_side, np.arctan2(drift[:, None], lead)),
        _moved(future, along, side, np.arctan2(side_rate, lead)),
    )


def _way_back(offset: FloatArray, rate: FloatArray, time_constant: float) -> tuple[FloatArray, FloatArray]:
    """Critically damped offsets (m, FUTURE), with the initial values `offset` and `rate` (m,), and their rates."""
    slope = (rate + offset / time_constant)[:, None]
    fade = np.exp(-FUTURE_S / time_constant)
    value = (offset[:, None] + slope * FUTURE_S) * fade
    return value, slope * fade - value / time_constant


def _moved(pose: FloatArray, ahead: FloatArray, left: FloatArray, turn: FloatArray) -> FloatArray:
    """Poses (m, k, 3) displaced ahead, to the left [m] and in heading [rad], each (m, k) or (m, 1)."""
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = pose[..., 0] + ahead * cos - left * sin, pose[..., 1] + ahead * sin + left * cos
    return np.stack([x, y, pose[..., 2] + turn], axis=-1)


def _poses(scenario: Scenario, rows: IntArray, steps: IntArray) -> FloatArray:
    """Poses (m, k, 3) of the agents in `rows` (m,) of the log at `steps` (k,)."""
    log, index = scenario.log, np.ix_(rows, steps)
    return np.stack([log.x[index], log.y[index], log.yaw[index]], axis=-1)
