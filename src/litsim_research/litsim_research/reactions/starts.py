"""Moments of recorded car following from which followers are driven anew behind their leaders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from litsim_data.encounters.following import FollowingTrack
from litsim_policy.driving.safety.comfort import ACCELERATION_MAX, BRAKING_JERK_MAX, DECELERATION_MAX, JERK_MAX
from litsim_policy.motion.car_following import IdmValues, following
from litsim_policy.motion.kept_headways import STRIDE, WINDOW, headway_of_look
from litsim_policy.motion.log_leaders import BACK
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import Floats, Floats2, Floats3, kernel

STEPS = 60  # that a follower is driven
APART = 20  # [steps] between two starts
SPEED_MIN = 1.0  # [m/s] slower followers tell little
BRAKING_SPAN = 15  # [steps] over which speeds and their changes are means: positions are noisy
BRAKING_STEPS, SPEED_LOST = 30, 2.0  # a leader that loses so much [m/s] within so many steps brakes


@dataclass(frozen=True)
class Starts:
    """n moments, and what people did in the STEPS after each; arrays (n,) and (n, STEPS + 1), from the moment on.

    Attributes:
        driver: number of the follower.
        brakes: whether the leader is about to brake.
        front: of the follower, from the moment on [m].
        speed: of the follower [m/s].
        leader_rear, leader_speed: from the front of the follower at the moment on [m], and [m/s].
        leader_change: of the leader's speed over the half second before [m/s].
        change: of the follower's speed over the half second before [m/s].
        looks: (n, L, 4) looks at the driver up to the moment: speed [m/s], its change over the half second before
            [m/s], gap [m], speed of the leader [m/s]; zeros before the track.
    """

    driver: IntArray
    brakes: BoolArray
    front: FloatArray
    speed: FloatArray
    leader_rear: FloatArray
    leader_speed: FloatArray
    leader_change: FloatArray
    change: FloatArray
    looks: FloatArray

    def __len__(self) -> int:
        return len(self.driver)

    @property
    def gap(self) -> FloatArray:
        """Gaps (n, STEPS + 1) that people kept [m]."""
        return self.leader_rear - self.front

    def take(self, which: BoolArray) -> Starts:
        """Returns the starts of the mask `which` (n,)."""
        return Starts(**{field.name: getattr(self, field.name)[which] for field in fields(self)})

    @classmethod
    def of(cls, tracks: Iterable[FollowingTrack]) -> Starts:
        """Returns the starts in `tracks`, every APART steps."""
        numbers: dict[tuple[str, int, int], int] = {}
        parts = []
        for track in tracks:
            driver = numbers.setdefault((track.site, track.period, track.follower), len(numbers))
            moments = np.arange(BACK, len(track) - STEPS, APART)
            moments = moments[track.speed[moments] > SPEED_MIN]
            if len(moments):
                parts.append(cls._of_track(track, moments, driver))
        names = [field.name for field in fields(cls)]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    @classmethod
    def _of_track(cls, track: FollowingTrack, moments: IntArray, driver: int) -> Starts:
        """Returns the starts at the steps `at` of one track."""
        onwards, begin = moments[:, None] + np.arange(STEPS + 1), track.front[moments, None]
        leader_speed = track.leader_speed[onwards]
        back = moments[:, None] - np.arange(0, WINDOW + 1, STRIDE)
        there, back = back >= 0, np.maximum(back, 0)
        before = np.maximum(np.arange(len(track)) - BACK, 0)
        change, leader_change = (speed - speed[before] for speed in (track.speed, track.leader_speed))
        looks = np.stack([track.speed[back], change[back], track.gap[back], track.leader_speed[back]], axis=-1)
        return cls(
            driver=np.full(len(moments), driver),
            brakes=leader_speed[:, 0] - leader_speed[:, : BRAKING_STEPS + 1].min(axis=1) >= SPEED_LOST,
            front=track.front[onwards] - begin,
            speed=track.speed[onwards],
            leader_rear=track.leader_rear[onwards] - begin,
            leader_speed=leader_speed,
            leader_change=leader_change[onwards],
            change=change[moments],
            looks=np.where(there[..., None], looks, 0.0),
        )


def headways_of(starts: Starts, model: IdmValues, looks: float) -> FloatArray:
    """Returns the headways (n,) [s] of the drivers, as :class:`litsim_policy.motion.kept_headways.KeptHeadways`."""
    return _headways(starts.looks, model, looks)


def driven(starts: Starts, headway: FloatArray, model: IdmValues) -> tuple[FloatArray, FloatArray]:
    """Returns fronts [m] and speeds [m/s] (n, STEPS + 1) of followers that `model` drives, each with its headway (n,).

    They change their acceleration as fast as the policy's agents may.
    """
    acceleration = starts.change / (BACK * STEP_S)
    begin = np.column_stack([starts.speed[:, 0], acceleration, headway])
    slows = starts.leader_change / (BACK * STEP_S)
    front, speed = _driven(begin, starts.leader_rear, starts.leader_speed, slows, model)
    return front, speed


def strongest_braking(front: FloatArray) -> FloatArray:
    """Returns the strongest braking (n,) [m/s2] of vehicles with positions `front` (n, STEPS + 1) [m]."""
    span = BRAKING_SPAN * STEP_S
    speed = (front[:, BRAKING_SPAN:] - front[:, :-BRAKING_SPAN]) / span
    return np.asarray(((speed[:, :-BRAKING_SPAN] - speed[:, BRAKING_SPAN:]) / span).max(axis=1))


def headway_spread(starts: Starts, model: IdmValues, looks: float) -> float:
    """Returns by how much the headways that drivers go on to keep differ from those that are known of them.

    It is the standard deviation of the logarithm of their ratio, as far as it lasts: from the covariance of what the
    first and the second half of the steps after the moment tell.
    """
    headways = headways_of(starts, model, looks)
    halves = []
    for last in (STEPS // 2, STEPS):
        moments = np.arange(last, last - STEPS // 2, -STRIDE)
        change = starts.speed[:, moments] - starts.speed[:, moments - BACK]
        seen = np.stack(
            [starts.speed[:, moments], change, starts.gap[:, moments], starts.leader_speed[:, moments]], axis=-1
        )
        halves.append(_headways(np.ascontiguousarray(seen), model, 0.0) / headways)
    both = np.log(np.stack(halves)[:, np.isfinite(halves).all(axis=0)])
    return float(np.sqrt(np.cov(both)[0, 1]))


@kernel
def _headways(looks: Floats3, model: IdmValues, prior: float) -> Floats:
    """See :func:`headways_of`."""
    headways = np.empty(len(looks))
    for i in range(len(looks)):
        count, total = prior, prior * model.headway
        for k in range(looks.shape[1]):
            speed, change, gap, leader_speed = looks[i, k]
            headway = headway_of_look(speed, change, gap, leader_speed, model)
            if headway > 0.0:
                count, total = count + 1.0, total + headway
        headways[i] = total / count
    return headways


@kernel
def _driven(
    begin: Floats2, rear: Floats2, leader_speed: Floats2, leader_acceleration: Floats2, model: IdmValues
) -> tuple[Floats2, Floats2]:
    """See :func:`driven`; columns of `begin` (n, 3) are speed, acceleration and headway, the rest is of the leaders."""
    fronts, speeds = np.zeros(rear.shape), np.empty(rear.shape)
    for i in range(len(begin)):
        x, v, before = 0.0, begin[i, 0], begin[i, 1]
        own = IdmValues(begin[i, 2], model.standstill_gap, model.acceleration, model.deceleration, model.braking_max)
        speeds[i, 0] = v
        for k in range(rear.shape[1] - 1):
            wanted = following(v, rear[i, k] - x, leader_speed[i, k], leader_acceleration[i, k], own)
            before = within(before, -DECELERATION_MAX, ACCELERATION_MAX)
            pedal = within(wanted, before - BRAKING_JERK_MAX * STEP_S, before + JERK_MAX * STEP_S)
            after = max(v + pedal * STEP_S, 0.0)
            before = (after - v) / STEP_S
            x, v = x + 0.5 * (v + after) * STEP_S, after
            fronts[i, k + 1], speeds[i, k + 1] = x, v
    return fronts, speeds
