"""What SimNet learns from: rasters of recorded agents, and where they went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from litsim_policy.driving.simnet_output import FUTURE, OUTPUTS
from litsim_policy.driving.simnet_raster import FRAMES, Motions, Painter, Rasters, RasterShape
from litsim_predictor.inference.raster import raster_of_net
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.scenario.scenario import Scenario

PAST_S = np.arange(1 - FRAMES, 1) * STEP_S
FUTURE_S = np.arange(1, FUTURE + 1) * STEP_S


class PerturbationConfig(BaseModel):
    """How some agents are displaced, with futures that lead back: what a network has done wrong it must undo.

    Attributes:
        share: of the agents; of those only who drives at `speed_min` at least.
        offset: standard deviation, to the side [m].
        turn: likewise, of the heading [rad].
        speed: likewise, of the speed [m/s].
        back_s: time constant of the way back to the log's path, critically damped [s].
        speed_back_s: of the way back to its speed [s].
        speed_min: [m/s].
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    share: float = Field(0.5, ge=0, le=1)
    offset: float = Field(0.4, ge=0)
    turn: float = Field(0.03, ge=0)
    speed: float = Field(1.0, ge=0)
    back_s: float = Field(0.8, gt=0)
    speed_back_s: float = Field(2.0, gt=0)
    speed_min: float = Field(3.0, gt=0)


@dataclass(frozen=True)
class _Source:
    """A scenario to draw moments from.

    Attributes:
        scenario: it.
        painter: of its net and signals.
        usable: (n, steps) who can be learned from at which step: whoever is there from then on for FUTURE steps.
        steps: (k,) at which there is anybody.
        share: (k,) by which they are drawn: as many as are usable.
    """

    scenario: Scenario
    painter: Painter
    usable: BoolArray
    steps: IntArray
    share: FloatArray

    @classmethod
    def of(cls, scenario: Scenario, shape: RasterShape) -> _Source:
        log = scenario.log
        usable = log.valid & ~log.obstacle[:, None]
        usable &= np.arange(log.steps) + FUTURE <= log.last_step[:, None]
        counts = usable.sum(axis=0)
        steps = np.flatnonzero(counts)
        painter = Painter(raster_of_net(scenario.net_path)[1].drawn, scenario.signals, shape)
        return cls(scenario, painter, usable, steps, counts[steps] / max(counts.sum(), 1))


class Moments:
    """Draws moments of scenarios, and some of the agents of each.

    Args:
        scenarios: from which.
        shares: how often each, in any unit, beside how many agents there are to learn from.
        shape: of the rasters.
        perturbation: of the agents; None for none.

    Raises:
        InputError: there is nobody to learn from.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        shares: Sequence[float],
        shape: RasterShape,
        perturbation: PerturbationConfig | None = None,
    ) -> None:
        self._sources = [_Source.of(scenario, shape) for scenario in scenarios]
        counts = np.array([source.usable.sum() for source in self._sources], np.float64)
        if not counts.sum():
            raise InputError(f"data: nobody is on the road for {FUTURE + 1} steps, so there is nothing to learn from")
        weight = counts * np.array(shares)
        self._share: FloatArray = weight / weight.sum()
        self._perturbation = perturbation

    def draw(self, moments: int, agents: int, random: np.random.Generator) -> tuple[Rasters, FloatArray]:
        """Rasters (b, CHANNELS, rows, columns) of at most `agents` agents at each of some moments, and their futures.

        Returns:
            the rasters, and OUTPUTS for each (b, OUTPUTS).
        """
        found = [self._moment(agents, random) for _ in range(moments)]
        return np.concatenate([rasters for rasters, _ in found]), np.concatenate([futures for _, futures in found])

    def _moment(self, agents: int, random: np.random.Generator) -> tuple[Rasters, FloatArray]:
        source = self._sources[random.choice(len(self._sources), p=self._share)]
        step = int(random.choice(source.steps, p=source.share))
        log = source.scenario.log
        usable = np.flatnonzero(source.usable[:, step])
        chosen = np.sort(random.permutation(usable)[:agents])
        here = np.flatnonzero(log.valid[:, step])
        past = np.arange(step + 1 - FRAMES, step + 1)
        everybody = Motions(
            _poses(source.scenario, here, np.maximum(past, 0)),
            log.valid[here][:, np.maximum(past, 0)] & (past >= 0),
            np.stack([log.length[here], log.width[here]], axis=-1),
            np.zeros(len(here), np.int64),
        )
        rows = np.searchsorted(here, chosen)
        own, future = everybody.pose[rows], _poses(source.scenario, chosen, step + np.arange(1, FUTURE + 1))
        if self._perturbation is not None:
            own, future = perturbed(own, future, log.speed[chosen, step], self._perturbation, random)
        return source.painter.draw(step, everybody, rows, own).copy(), relative(own[:, -1], future)


def relative(present: FloatArray, future: FloatArray) -> FloatArray:
    """OUTPUTS (m, OUTPUTS) of poses (m, FUTURE, 3), seen from the present ones (m, 3)."""
    ahead, left = to_body(
        future[..., 0] - present[:, None, 0], future[..., 1] - present[:, None, 1], present[:, None, 2]
    )
    turn = wrap_angle(future[..., 2] - present[:, None, 2])
    return np.stack([ahead, left, turn], axis=-1).reshape(len(future), OUTPUTS)


def perturbed(
    own: FloatArray, future: FloatArray, speed: FloatArray, config: PerturbationConfig, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Displace some of m agents, who drive at `speed` (m,), as they were and as they will be.

    Args:
        own: (m, FRAMES, 3) poses.
        future: (m, FUTURE, 3) poses.
        speed: now [m/s].
        config: how.
        random: draws.

    Returns:
        both, displaced: up to now by a constant offset to the side, heading and speed, from then on on the way back.
    """
    m = len(own)
    draws = random.standard_normal((3, m)) * np.array([config.offset, config.turn, config.speed])[:, None]
    offset, turn, faster = draws * ((random.random(m) < config.share) & (speed >= config.speed_min))
    faster = np.maximum(faster, -0.5 * speed)  # nobody backwards
    drift = speed * np.tan(turn)
    fade = np.exp(-FUTURE_S / config.back_s)
    slope = drift[:, None] + offset[:, None] / config.back_s
    side = (offset[:, None] + slope * FUTURE_S) * fade
    side_rate = slope * fade - side / config.back_s
    gain = faster[:, None] * config.speed_back_s * (1.0 - np.exp(-FUTURE_S / config.speed_back_s))
    lead = np.maximum(speed, config.speed_min)[:, None]
    return (
        _moved(
            own, faster[:, None] * PAST_S, offset[:, None] + drift[:, None] * PAST_S, np.arctan2(drift[:, None], lead)
        ),
        _moved(future, gain, side, np.arctan2(side_rate, lead)),
    )


def _moved(pose: FloatArray, ahead: FloatArray, left: FloatArray, turn: FloatArray) -> FloatArray:
    """Poses (m, k, 3) displaced ahead, to the left [m] and in heading [rad], each (m, k) or (m, 1)."""
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x, y = pose[..., 0] + ahead * cos - left * sin, pose[..., 1] + ahead * sin + left * cos
    return np.stack([x, y, pose[..., 2] + turn], axis=-1)


def _poses(scenario: Scenario, rows: IntArray, steps: IntArray) -> FloatArray:
    """(m, k, 3) of the agents in `rows` (m,) of the log at `steps` (k,)."""
    log, at = scenario.log, np.ix_(rows, steps)
    return np.stack([log.x[at], log.y[at], log.yaw[at]], axis=-1)
