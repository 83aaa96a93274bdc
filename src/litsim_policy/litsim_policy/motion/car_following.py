"""The Intelligent Driver Model (Treiber 2000), and the braking that a leader requires."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from litsim_sim.core.pair_geometry import within
from litsim_sim.core.quantities import Acceleration, Duration, Length, NonNegative, Positive, Speed, configuration
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.kernels.compiled import Bools, Bools2, Floats, Floats2, Ints, kernel, tuple_of

DESIRED_MIN = 0.1  # [m/s] lower bound on desired speeds
GAP_MIN = 0.1  # [m] lower bound on gaps, since the model has a pole at zero
LEADER_BRAKES = 1.0  # [m/s2] a leader that brakes harder is assumed to brake until it stands
BRAKING_MIN = 0.1  # [m/s2] lower bound on the braking of such a leader
RESERVE_MIN = 0.2  # least share of the maximum acceleration that a vehicle does not use, since the model would use all
COOLNESS = 0.99  # of a driver who knows that a gap that is merely short is no emergency, as published
BRAKING_SEEN = 2.0  # [m/s2] harder braking says no more about the headway that a driver keeps


class IdmValues(NamedTuple):
    """The values of :class:`IdmConfig` besides the desired speed."""

    headway: float
    standstill_gap: float
    acceleration: float
    deceleration: float
    braking_max: float


class Leaders(NamedTuple):
    """The leaders of m vehicles among w others.

    Attributes:
        gap, speed: (m, w) to the others and of the others along the vehicles' paths [m], [m/s].
        leads: (m, w) whether one of them leads.
        first: (m,) row of the first of the others among n agents.
        acceleration: (n,) of all agents [m/s2].
    """

    gap: Floats2
    speed: Floats2
    leads: Bools2
    first: Ints
    acceleration: Floats


@configuration
class IdmConfig:
    """Parameters of the model; the defaults are those of sisl/ngsim_env, calibrated on NGSIM.

    Attributes:
        desired_speed: v0, on a free road.
        headway: T, behind a leader.
        standstill_gap: s0, behind a standing leader.
        acceleration: a_max, the maximum.
        deceleration: b, comfortable braking.
        braking_max: limit on the model's braking.
    """

    desired_speed: NonNegative[Speed] = 20.0
    headway: NonNegative[Duration] = 0.5
    standstill_gap: NonNegative[Length] = 2.0
    acceleration: Positive[Acceleration] = 3.0
    deceleration: Positive[Acceleration] = 2.5
    braking_max: Positive[Acceleration] = 8.0

    @cached_property
    def values(self) -> IdmValues:
        """The parameters besides the desired speed, as kernels take them."""
        return tuple_of(IdmValues, self)


def idm_acceleration(
    config: IdmConfig | Sequence[IdmConfig],
    speed: float | FloatArray,
    desired_speed: float | FloatArray,
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray | None = None,
) -> FloatArray:
    """Returns the acceleration (...) [m/s2] of vehicles, each behind the most demanding of its leaders.

    Gaps (..., n) are from bumper to bumper [m]; `leads` (..., n) is the mask of the leaders, None for all. `config`
    is that of all vehicles, or of each.
    """
    gap = np.asarray(gap, np.float64)
    shape, pairs = gap.shape[:-1], (math.prod(gap.shape[:-1]), gap.shape[-1])
    models = [config] if isinstance(config, IdmConfig) else config
    accelerations = _idm_accelerations(
        np.full(shape, speed, np.float64).reshape(-1),
        np.full(shape, desired_speed, np.float64).reshape(-1),
        np.ascontiguousarray(gap).reshape(pairs),
        np.ascontiguousarray(leader_speed, np.float64).reshape(pairs),
        np.ones(pairs, np.bool_) if leads is None else leads.reshape(pairs),
        np.array([model.values for model in models]),
    )
    return accelerations.reshape(shape)


@kernel
def idm(speed: float, desired_speed: float, gap: Floats, leader_speed: Floats, leads: Bools, model: IdmValues) -> float:
    """Acceleration [m/s2] of one vehicle behind the most demanding of its leaders; see :func:`idm_acceleration`."""
    free = model.acceleration * (1.0 - math.pow(speed / max(desired_speed, DESIRED_MIN), 4.0))
    interaction = 0.0
    for j in range(len(gap)):
        if leads[j]:
            closing = speed * (speed - leader_speed[j]) / (2.0 * math.sqrt(model.acceleration * model.deceleration))
            wanted = model.standstill_gap + max(0.0, speed * model.headway + closing)
            interaction = max(interaction, model.acceleration * (wanted / max(gap[j], GAP_MIN)) ** 2)
    return within(free - interaction, -model.braking_max, model.acceleration)


@kernel
def following(speed: float, gap: float, leader_speed: float, leader_acceleration: float, model: IdmValues) -> float:
    """Acceleration [m/s2] behind one leader on an otherwise free road.

    It is that of :func:`idm`, but where this would brake harder than it takes if the leader keeps its acceleration, it
    is little less than the latter: nobody brakes hard for a gap that is merely short, as after a cut-in (the ACC model
    of Kesting, Treiber and Helbing, 2010). `gap` [m] is positive.
    """
    room, slows = max(gap, GAP_MIN), min(leader_acceleration, model.acceleration)
    closing, scale = speed - leader_speed, 2.0 * math.sqrt(model.acceleration * model.deceleration)
    wanted = model.standstill_gap + max(speed * model.headway + speed * closing / scale, 0.0)
    plain = model.acceleration * (1.0 - (wanted / room) ** 2)
    stop = leader_speed**2 - 2.0 * room * slows
    if leader_speed * closing <= -2.0 * room * slows and stop > 0.0:
        enough = speed**2 * slows / stop
    else:
        enough = slows - max(closing, 0.0) ** 2 / (2.0 * room)
    if plain < enough:
        easier = enough + model.deceleration * math.tanh((plain - enough) / model.deceleration)
        plain = (1.0 - COOLNESS) * plain + COOLNESS * easier
    return within(plain, -model.braking_max, model.acceleration)


@kernel
def headway_kept(speed: float, acceleration: float, gap: float, leader_speed: float, model: IdmValues) -> float:
    """Headway [s] with which the model has this `acceleration` [m/s2] behind one leader on an otherwise free road.

    It may be negative; `speed` is more than 0.
    """
    reserve = 1.0 - max(acceleration, -BRAKING_SEEN) / model.acceleration
    closing = speed * (speed - leader_speed) / (2.0 * math.sqrt(model.acceleration * model.deceleration))
    return (gap * math.sqrt(max(reserve, RESERVE_MIN)) - model.standstill_gap - closing) / speed


@kernel
def safe_speed(room: float, leader_speed: float, own_braking: float, leader_braking: float) -> float:
    """Speed [m/s] from which `own_braking` stops an agent behind its leader, if the leader brakes by `leader_braking`.

    The safe speed of Krauss (1997), with a reaction time of one step. Negative `room` [m] counts as 0.
    """
    lag = own_braking * STEP_S
    stop = 2.0 * own_braking * max(room, 0.0) + leader_speed**2 * own_braking / leader_braking
    return -lag + math.sqrt(lag**2 + stop)


@kernel
def braking_behind(
    speed: float, leader_speed: float, leader_acceleration: float, room: float, leader_brakes: float
) -> float:
    """Constant braking [m/s2] with which an agent does not reach a leader, `room` [m] ahead, that drives on or brakes.

    A leader that brakes harder than `leader_brakes` [m/s2] is assumed to brake until it stands.
    """
    needed = max(speed - leader_speed, 0.0) ** 2 / (2.0 * max(room, GAP_MIN))
    braking = max(-leader_acceleration, BRAKING_MIN)
    if braking > leader_brakes:
        stopped = leader_speed**2 / (2.0 * braking)
        needed = max(needed, speed**2 / (2.0 * max(room + stopped, GAP_MIN)))
    return needed


@kernel
def _idm_accelerations(
    speed: Floats, desired_speed: Floats, gap: Floats2, leader_speed: Floats2, leads: Bools2, models: Floats2
) -> Floats:
    """Accelerations (m,) of m vehicles by :func:`idm`; arrays (m,) and (m, n).

    `models` are the parameters :class:`IdmValues` of each vehicle (m, 5) or of all (1, 5).
    """
    acceleration = np.empty(len(speed))
    for i in range(len(speed)):
        own = models[i if len(models) > 1 else 0]
        model = IdmValues(own[0], own[1], own[2], own[3], own[4])
        acceleration[i] = idm(speed[i], desired_speed[i], gap[i], leader_speed[i], leads[i], model)
    return acceleration
