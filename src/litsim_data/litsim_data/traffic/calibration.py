"""Car-following models fitted to recorded pairs: the follower is simulated behind its recorded leader.

A fit minimises the root mean square error of the gap over a whole pair (reference, section 4). All pairs and all
candidates of the search are simulated at once as arrays, so that a hundred generations take a minute. A pair often says
little about some parameter, such as the desired speed in a jam: a small penalty keeps that one at the common value,
where the bare error would leave it anywhere, mostly at a bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray

GAP_FLOOR = 0.1  # [m] models divide by the gap: a follower that has run into its leader is held to this
EXPONENT = 4.0  # of IDM
MUTATION = (0.4, 0.9)  # range of the scale of differences, drawn for each generation
CROSSOVER = 0.8  # probability that a parameter is taken from the mutant
TO_BEST = 0.3  # share of the way to the best candidate that a mutant takes
PRIOR_WEIGHT = 0.5  # [m] of error that a parameter costs by being e times, or 1/e of, the common value. Chosen on the
# last 40 % of held-in pairs (of IDM): 4.4 m of error at 0.03, 3.8 at 0.3, 3.2 at 1, 3.4 with the common set itself.

StepSpeed = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]
"""(parameters (..., 5), gap (...) [m], own speed [m/s], leader's speed [m/s]) to the speed one step later [m/s]."""


@dataclass(frozen=True)
class Pairs:
    """Followers and their leaders at 10 Hz; n pairs, padded to the longest.

    Attributes:
        name: (n,) names of their sources.
        follower: (n,) number of the following driver; a driver may follow in several pairs.
        valid: (n, t) which steps a pair has: the first ones.
        gap: (n, t) from the follower's front to the leader's rear bumper, recorded [m].
        position: (n, t) follower's front along the road [m].
        speed: (n, t) follower's [m/s].
        leader_speed: (n, t) [m/s].
    """

    name: np.ndarray
    follower: IntArray
    valid: BoolArray
    gap: FloatArray
    position: FloatArray
    speed: FloatArray
    leader_speed: FloatArray

    def __len__(self) -> int:
        return len(self.follower)

    def take(self, rows: np.ndarray) -> Pairs:
        """Those of the pairs that `rows`, positions or a mask (n,), names."""
        return Pairs(*(getattr(self, field)[rows] for field in self.__dataclass_fields__))

    def part(self, low: float, high: float) -> Pairs:
        """Of every pair the steps from the share `low` to the share `high` of its duration."""
        steps = self.valid.sum(axis=1)
        first, last = np.floor(low * steps).astype(int), np.floor(high * steps).astype(int)
        index = first[:, None] + np.arange(int((last - first).max()))
        valid, index = index < last[:, None], np.minimum(index, steps[:, None] - 1)
        gap, position, speed, leader_speed = (
            np.take_along_axis(column, index, 1) for column in (self.gap, self.position, self.speed, self.leader_speed)
        )
        return Pairs(self.name, self.follower, valid, gap, position, speed, leader_speed)


@dataclass(frozen=True)
class Model:
    """A car-following model with bounds of its parameters.

    Attributes:
        name: name in tables.
        step_speed: its equation.
        parameters: names of its five parameters, with units in the text that explains them.
        low, high: (5,) bounds of the search.
    """

    name: str
    step_speed: StepSpeed
    parameters: tuple[str, ...]
    low: FloatArray
    high: FloatArray


def idm_step(p: FloatArray, gap: FloatArray, speed: FloatArray, leader_speed: FloatArray) -> FloatArray:
    """Speed after one step of the Intelligent Driver Model (Treiber 2000); `p` is v0, T, s0, a_max, b."""
    v0, headway, s0, a_max, b = np.moveaxis(p, -1, 0)
    desired = s0 + np.maximum(speed * headway + speed * (speed - leader_speed) / (2.0 * np.sqrt(a_max * b)), 0.0)
    ratio = desired / np.maximum(gap, GAP_FLOOR)
    acceleration = a_max * (1.0 - (speed / v0) ** EXPONENT - ratio * ratio)
    return np.maximum(speed + np.maximum(acceleration, -8.0) * STEP_S, 0.0)


def krauss_step(p: FloatArray, gap: FloatArray, speed: FloatArray, leader_speed: FloatArray) -> FloatArray:
    """Speed after one step of Krauss' model without dawdling (Krauss 1998, eq. 4.10); `p` as for IDM, T the reaction.

    The safe speed lets the follower stop behind a leader that brakes with `b`, after `T`, at the gap `s0`.
    """
    v0, reaction, s0, a_max, b = np.moveaxis(p, -1, 0)
    bt = b * reaction
    safe = -bt + np.sqrt(bt * bt + leader_speed**2 + 2.0 * b * np.maximum(gap - s0, 0.0))
    wanted = np.minimum(np.minimum(speed + a_max * STEP_S, v0), safe)
    return np.maximum(wanted, np.maximum(speed - 8.0 * STEP_S, 0.0))


NAMES = ("v0", "T", "s0", "a_max", "b")
"""Desired speed [m/s], time gap [s], gap at standstill [m], acceleration [m/s2], comfortable deceleration [m/s2]."""
IDM = Model("IDM", idm_step, NAMES, np.array([8.0, 0.2, 0.5, 0.3, 0.3]), np.array([35.0, 3.0, 6.0, 4.0, 5.0]))
KRAUSS = Model("Krauss", krauss_step, NAMES, np.array([8.0, 0.2, 0.5, 0.3, 0.3]), np.array([35.0, 3.0, 6.0, 4.0, 5.0]))


def simulate(model: Model, parameters: FloatArray, pairs: Pairs) -> FloatArray:
    """Gaps [m] of simulated followers, shape (..., n, t) for `parameters` (..., n, 5).

    The follower starts as recorded and then sees only its recorded leader; ballistic steps of 0.1 s.
    """
    rear = pairs.gap + pairs.position
    shape = parameters.shape[:-1]
    gaps = np.empty((*shape, pairs.gap.shape[1]))
    position, speed = np.broadcast_to(pairs.position[:, 0], shape), np.broadcast_to(pairs.speed[:, 0], shape)
    for step in range(gaps.shape[-1]):
        gaps[..., step] = gap = rear[:, step] - position
        after = model.step_speed(parameters, gap, speed, pairs.leader_speed[:, step])
        position, speed = position + 0.5 * (speed + after) * STEP_S, after
    return gaps


def gap_rmse(model: Model, parameters: FloatArray, pairs: Pairs) -> FloatArray:
    """Root mean square error of the gap [m], shape (..., n) for `parameters` (..., n, 5)."""
    error = np.where(pairs.valid, simulate(model, parameters, pairs) - pairs.gap, 0.0)
    return cast(FloatArray, np.sqrt((error**2).sum(axis=-1) / pairs.valid.sum(axis=-1)))


def fit_each(
    model: Model, pairs: Pairs, common: FloatArray, seed: int, generations: int = 80, population: int = 30
) -> FloatArray:
    """Parameters (n, 5) of every pair, near `common` (5,) where the pair does not determine them."""

    def cost(candidates: FloatArray) -> FloatArray:
        penalty = PRIOR_WEIGHT * (np.log(candidates / common) ** 2).sum(axis=-1)
        return gap_rmse(model, candidates, pairs) + penalty

    return _evolve(cost, len(pairs), model, seed, generations, population)


def fit_common(model: Model, pairs: Pairs, seed: int, generations: int = 40, population: int = 30) -> FloatArray:
    """One set of parameters (5,) for all pairs, with the least mean error."""

    def cost(candidates: FloatArray) -> FloatArray:
        everywhere = np.broadcast_to(candidates, (len(candidates), len(pairs), len(model.parameters)))
        return gap_rmse(model, everywhere, pairs).mean(axis=-1, keepdims=True)

    return _evolve(cost, 1, model, seed, generations, population)[0]


def _evolve(
    cost: Callable[[FloatArray], FloatArray], count: int, model: Model, seed: int, generations: int, population: int
) -> FloatArray:
    """Differential evolution (Storn and Price 1997, current-to-best/1/bin) of `count` problems at once.

    `cost` takes candidates (population, count, 5) and gives (population, count). Returns the best (count, 5). SciPy's
    takes one problem at a time: 0.4 s each on one core, 7 minutes for the 1074 of a calibration, here 1.
    """
    rng = np.random.default_rng(seed)
    size = (population, count, len(model.low))
    members = model.low + (model.high - model.low) * rng.random(size)
    costs = cost(members)
    problems = np.arange(count)
    for _ in range(generations):
        best = members[costs.argmin(axis=0), problems]
        first, second = (members[rng.permuted(np.arange(population))] for _ in range(2))
        mutant = members + TO_BEST * (best - members) + rng.uniform(*MUTATION) * (first - second)
        # Beyond a bound: half way between it and the parent, so that bounds do not attract.
        mutant = np.where(mutant < model.low, 0.5 * (members + model.low), mutant)
        mutant = np.where(mutant > model.high, 0.5 * (members + model.high), mutant)
        crossed = rng.random(size) < CROSSOVER
        crossed |= np.arange(size[-1]) == rng.integers(size[-1], size=(population, count, 1))
        trial = np.where(crossed, mutant, members)
        trial_costs = cost(trial)
        better = trial_costs < costs
        members, costs = np.where(better[..., None], trial, members), np.where(better, trial_costs, costs)
    return cast(FloatArray, members[costs.argmin(axis=0), problems])
