"""Parameters of policy C's safety layer: limits that always hold, and guards that intervene."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

from pydantic import model_validator

from litsim_policy.motion.car_following import LEADER_BRAKES
from litsim_sim.core.quantities import (
    Acceleration,
    AngularAcceleration,
    AngularRate,
    Duration,
    Flag,
    Horizon,
    Jerk,
    Length,
    NonNegative,
    Positive,
    at_most,
    configuration,
)
from litsim_sim.kernels.compiled import tuple_of, tuple_type


class SafetyValues(NamedTuple):
    """The values of :class:`SafetyConfig` that kernels take."""

    acceleration_max: float
    deceleration_max: float
    jerk_max: float
    braking_jerk_max: float
    lateral_acceleration_max: float
    yaw_rate_max: float
    yaw_acceleration_max: float
    braking_max: float
    leader_braking: float
    own_braking: float
    standstill_gap: float
    relax: float
    widening: float
    imminent: float
    leader_brakes: float


SAFETY = tuple_type(SafetyValues)


@configuration
class SafetyConfig:
    """Limits, which always hold, and guards. Bounds are those of nuPlan's comfort measure unless stated otherwise.

    Attributes:
        following: brake for the agent ahead on the path, and for red, when braking can no longer wait.
        contact: brake or steer where the command leads into another box within `horizon`.
        road: do not steer off the road.
        acceleration_max, deceleration_max: of the network's commands.
        jerk_max: with which the network's acceleration grows, and its braking is eased.
        braking_jerk_max: with which the network's braking grows. With nuPlan's longitudinal 4.13 m/s3 it would take a
            second to brake as hard as people do within a quarter of one; this is nuPlan's bound on the whole jerk. The
            careful and competent driver of UN Regulation 157 has 12.65.
        lateral_acceleration_max: of the network's turns.
        yaw_rate_max: of the network's turns.
        yaw_acceleration_max: change of the network's yaw rate.
        braking_max: of the guards in an emergency, the most that the vehicle can do.
        leader_braking: hardest braking that the agent ahead may begin at any time.
        own_braking: own braking assumed in reply.
        standstill_gap: kept behind the agent ahead.
        relax: time constant of widening a gap that is too short.
        widening: hardest braking for that alone, outside emergencies.
        imminent: an approach that needs harder braking is an emergency. Up to there the network itself brakes, by
            `deceleration_max` at most, and what is then missing can still be made up for.
        leader_brakes: a leader that brakes harder is assumed to stop.
        horizon: of the look-ahead for other boxes.
        settle: time constant with which turns are expected to end.
        margin: distance kept to other boxes.
        road_horizon: of the look-ahead for the road, at most `horizon`.
    """

    following: Flag = True
    contact: Flag = True
    road: Flag = True
    acceleration_max: Positive[Acceleration] = 2.40
    deceleration_max: Positive[Acceleration] = 4.05
    jerk_max: Positive[Jerk] = 4.13
    braking_jerk_max: Positive[Jerk] = 8.37
    lateral_acceleration_max: Positive[Acceleration] = 4.89
    yaw_rate_max: Positive[AngularRate] = 0.95
    yaw_acceleration_max: Positive[AngularAcceleration] = 1.93
    braking_max: Positive[Acceleration] = 8.0
    leader_braking: Positive[Acceleration] = 8.0
    own_braking: Positive[Acceleration] = 7.5
    standstill_gap: NonNegative[Length] = 1.0
    relax: Positive[Duration] = 1.0
    widening: Positive[Acceleration] = 2.5
    imminent: NonNegative[Acceleration] = 6.0
    leader_brakes: NonNegative[Acceleration] = LEADER_BRAKES
    horizon: Horizon = 1.2
    settle: Positive[Duration] = 0.5
    margin: NonNegative[Length] = 0.15
    road_horizon: Horizon = 0.8

    @cached_property
    def values(self) -> SafetyValues:
        """The values that kernels take."""
        return tuple_of(SafetyValues, self)

    @property
    def without_guards(self) -> SafetyConfig:
        """The limits alone."""
        return replace(self, following=False, contact=False, road=False)

    @model_validator(mode="after")
    def _check(self) -> SafetyConfig:
        at_most(self, "road_horizon", "horizon")
        return self


LIMITS_ONLY = SafetyConfig().without_guards
"""The layer in training: limits without guards; need of a guard is penalised instead."""
