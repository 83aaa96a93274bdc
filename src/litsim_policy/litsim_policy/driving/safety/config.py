"""Parameters of the guards of policy C's safety layer."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

from pydantic import model_validator

from litsim_policy.motion.car_following import LEADER_BRAKES
from litsim_sim.core.quantities import (
    Acceleration,
    Duration,
    Flag,
    Horizon,
    Length,
    NonNegative,
    Positive,
    at_most,
    configuration,
)
from litsim_sim.kernels.compiled import tuple_of, tuple_type


class SafetyValues(NamedTuple):
    """The values of :class:`SafetyConfig` that kernels take."""

    braking_max: float
    leader_braking: float
    own_braking: float
    standstill_gap: float
    relax: float
    imminent: float
    leader_brakes: float


SAFETY = tuple_type(SafetyValues)


@configuration
class SafetyConfig:
    """The guards; the limits of :mod:`.comfort` always hold.

    Attributes:
        following: brake for the agent ahead on the path, and for red, when braking can no longer wait.
        contact: brake or steer where the command leads into another box within `horizon`.
        road: do not steer off the road.
        braking_max: of the guards in an emergency, the most that the vehicle can do.
        leader_braking: hardest braking that the agent ahead may begin at any time.
        own_braking: own braking assumed in reply.
        standstill_gap: kept behind the agent ahead.
        relax: time constant of widening a gap that is too short.
        imminent: an approach that needs harder braking is an emergency. Up to there the network itself brakes within
            its limits, and what is then missing can still be made up for.
        leader_brakes: a leader that brakes harder is assumed to stop.
        horizon: of the look-ahead for other boxes.
        margin: distance kept to other boxes.
        road_horizon: of the look-ahead for the road, at most `horizon`.
    """

    following: Flag = True
    contact: Flag = True
    road: Flag = True
    braking_max: Positive[Acceleration] = 8.0
    leader_braking: Positive[Acceleration] = 8.0
    own_braking: Positive[Acceleration] = 7.5
    standstill_gap: NonNegative[Length] = 1.0
    relax: Positive[Duration] = 1.0
    imminent: NonNegative[Acceleration] = 6.0
    leader_brakes: NonNegative[Acceleration] = LEADER_BRAKES
    horizon: Horizon = 1.2
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
