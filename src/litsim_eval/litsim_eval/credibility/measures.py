"""Measures of credibility: each compares what simulated drivers did in encounters with what people did there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_eval.campaign.bootstrap import SEED, percentile_bounds, times_drawn
from litsim_eval.credibility.responses import Reactions, Responses
from litsim_eval.credibility.statistics import (
    areas_under_curve,
    covered,
    crps,
    kappas,
    ks_distances,
    means,
    medians,
    once,
)
from litsim_sim.core.scene import RATE_HZ, FloatArray

ERROR_STEPS = round(5.0 * RATE_HZ)
"""Steps after the onset over which the position error is a mean: 5 s."""
SCORED_S = (2.0, 4.0, 6.0)
"""Times after the onset at which the spread of drawn drivers is judged [s]."""
LEVELS = (0.5, 0.9)
"""Central shares of drawn positions that the record should be within as often."""
TTC_SHORT = 2.0  # [s] time to collision that people avoid
HALVES = 200  # random halves of people whose distance is the floor of a distribution's
DECIMALS = 6  # of figures
CELLS_MAX = 4_000_000  # numbers in memory at a time, of encounters in draws

Statistic = Callable[[Responses, FloatArray], FloatArray]
"""A figure (d,) of responses in each of d draws of the encounters, `times` (d, n); see :mod:`.statistics`."""


@dataclass(frozen=True)
class Measure:
    """A figure of how a setup drives.

    Attributes:
        name: in files.
        text: what it is, in one line.
        figure: computes it.
        drawn: whether it is for several drivers in each encounter alone.
        distance: whether it is one, to which the chance of a draw always adds; its bounds are corrected for that.
    """

    name: str
    text: str
    figure: Statistic
    drawn: bool = False
    distance: bool = False


QUANTITIES = {
    "onset": ("s", "time from the onset of the encounter until 0.5 m/s are lost"),
    "strongest_braking": ("mps2", "least mean acceleration over 0.5 s"),
    "speed_lost": ("mps", "speed at the onset minus the least speed"),
    "least_gap": ("m", "least distance to the opponent"),
    "least_ttc": ("s", "least time to collision; 99 without an approach"),
}
"""Units in names, and meanings, of the quantities whose distributions are compared."""


def measured(responses: Responses, *, bounds: bool = True) -> dict[str, Any]:
    """Returns all measures of a setup by name, with 95 % `bounds` as NAME_interval, and those by kind.

    The bootstrap is over the vehicles that react: all encounters of one are drawn together. What cannot be told, such
    as the median onset where nobody reacts, is None, and so are intervals with fewer than two vehicles.
    """
    whole, kinds = _figures(responses, bounds=bounds), responses.kinds
    if len(kinds) == 1:
        return {**whole, "kinds": dict.fromkeys(kinds, whole)}
    return {**whole, "kinds": {name: _figures(responses.take(rows), bounds=bounds) for name, rows in kinds.items()}}


def measures() -> Iterator[Measure]:
    """Yields all measures, in the order of files."""
    yield from _OF_POSITION
    yield from _OF_TAKEOVERS
    for quantity, (unit, text) in QUANTITIES.items():
        yield from _distribution(quantity, unit, text)
    yield from _OF_CLOSENESS
    yield from _OF_DRAWS


def floor(people: FloatArray) -> float | None:
    """Returns the mean KS distance between random halves of `people` (n,): what no model can fall below.

    None for fewer than four.
    """
    count = len(people)
    if count < 4:
        return None
    rng = np.random.default_rng(SEED)
    halves = [rng.permutation(count)[: count // 2 * 2].reshape(2, -1) for _ in range(HALVES)]
    return _plain(np.mean([ks_distances(people[a], people[b], once(count // 2))[0] for a, b in halves]))


def _figures(responses: Responses, *, bounds: bool) -> dict[str, Any]:
    """Returns the measures of `responses`, without those by kind."""
    own, vehicles = responses.vehicles, int(responses.vehicles.max()) + 1
    figures: dict[str, Any] = {
        "encounters": len(responses.encounters),
        "contacts": int(responses.touched.sum()),
        "contacts_people": int(responses.people.contact.sum()),
    }
    for measure in measures():
        if measure.drawn and responses.drivers < 2:
            continue
        value = float(measure.figure(responses, once(len(own)))[0])
        figures[measure.name] = _plain(value)
        if bounds:
            figures[f"{measure.name}_interval"] = _interval(measure, responses, vehicles, value)
    for quantity in QUANTITIES:
        figures[f"{quantity}_ks_people"] = floor(getattr(responses.people, quantity))
    return figures


def _interval(measure: Measure, responses: Responses, vehicles: int, value: float) -> list[float] | None:
    """Returns the bounds of a measure of this `value` by the bootstrap over so many `vehicles`; None without any."""
    if vehicles < 2:
        return None
    times = times_drawn(vehicles)[:, responses.vehicles]
    parts = math.ceil(times.size * responses.drivers / CELLS_MAX)
    figures = np.concatenate([measure.figure(responses, part) for part in np.array_split(times, parts)])
    if measure.distance:
        figures = np.maximum(figures - figures.mean() + value, 0.0)
    bounds = percentile_bounds(figures)
    return None if bounds is None else [round(bound, DECIMALS) for bound in bounds]


def _plain(value: float | np.floating[Any]) -> float | None:
    return round(float(value), DECIMALS) if np.isfinite(value) else None


def mean_distance(offsets: FloatArray) -> FloatArray:
    """Returns the mean distance over 5 s (n,) [m] of the median of drivers from the record, by `offsets` (n, k, t)."""
    away = np.abs(np.median(offsets[:, :, : ERROR_STEPS + 1], axis=1))
    there = ~np.isnan(away)
    total, count = np.where(there, away, 0.0).sum(axis=1), there.sum(axis=1)
    return np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0)


def _away(responses: Responses) -> FloatArray:
    """Returns the distance along the road between the median path and the record after 5 s (n,) [m]."""
    return np.abs(np.median(responses.along[:, :, ERROR_STEPS], axis=1))


def _onset_errors(responses: Responses) -> FloatArray:
    """Returns by how much onsets differ from people's (n, k) [s]; NaN unless both have reacted."""
    return np.abs(responses.simulated.onset - responses.people.onset[:, None])


def _heroic(responses: Responses) -> FloatArray:
    """Returns whether drivers brake harder than anyone did in an encounter of the kind (n, k)."""
    hardest = np.zeros(len(responses.encounters))
    for rows in responses.kinds.values():
        hardest[rows] = responses.people.strongest_braking[rows].min()
    return np.asarray(responses.simulated.strongest_braking < hardest[:, None], np.float64)


def _distribution(name: str, unit: str, text: str) -> Iterator[Measure]:
    """Yields the medians of a quantity, of simulated drivers and of people, and the distance of their distributions."""

    def simulated(responses: Responses, times: FloatArray) -> FloatArray:
        return medians(getattr(responses.simulated, name), times)

    def people(responses: Responses, times: FloatArray) -> FloatArray:
        return medians(getattr(responses.people, name), times)

    def distance(responses: Responses, times: FloatArray) -> FloatArray:
        return ks_distances(getattr(responses.simulated, name), getattr(responses.people, name), times)

    yield Measure(f"{name}_{unit}", f"{text}; median", simulated)
    yield Measure(f"{name}_people_{unit}", f"{text}; people's median", people)
    yield Measure(f"{name}_ks", f"{text}; Kolmogorov-Smirnov distance from people", distance, distance=True)


def _mean_of(values: Callable[[Responses], Any]) -> Statistic:
    return lambda responses, times: means(values(responses), times)


def _median_of(values: Callable[[Responses], Any]) -> Statistic:
    return lambda responses, times: medians(values(responses), times)


def _excess(flags: Callable[[Reactions], Any]) -> Statistic:
    """Returns the statistic of the share of drivers for which `flags` hold, minus that of people."""
    return lambda responses, times: means(flags(responses.simulated), times) - means(flags(responses.people), times)


def _at(responses: Responses, seconds: float) -> FloatArray:
    """Returns positions along the road relative to the record so long after the onset (n, k) [m]."""
    return responses.along[:, :, round(seconds * RATE_HZ)]


def _scored(seconds: float) -> Measure:
    """Returns the score of the positions of drawn drivers so long after the onset."""

    def score(responses: Responses) -> FloatArray:
        position = _at(responses, seconds)
        return crps(position, np.zeros(len(position)))

    text = f"continuous ranked probability score of the position after {seconds:g} s"
    return Measure(f"crps_{seconds:g}s_m", text, _mean_of(score), drawn=True)


def _covering(level: float) -> Measure:
    """Returns how often the record is within the central share `level` of the positions of drawn drivers."""

    def coverage(responses: Responses) -> FloatArray:
        positions = [_at(responses, seconds) for seconds in SCORED_S]
        return np.column_stack([covered(position, np.zeros(len(position)), level) for position in positions])

    text = f"share of positions after 2, 4 and 6 s within the central {100 * level:g} % of drivers"
    return Measure(f"coverage_{100 * level:g}", text, _mean_of(coverage), drawn=True)


_OF_POSITION = (
    Measure(
        "position_error_m",
        "distance along the road between the median path and the record over 5 s; mean of encounters' means",
        _mean_of(lambda r: mean_distance(r.along)),
    ),
    Measure(
        "position_error_median_m",
        "the same; median of encounters' means",
        _median_of(lambda r: mean_distance(r.along)),
    ),
    Measure(
        "across_error_m",
        "distance across the road over 5 s; mean of encounters' means",
        _mean_of(lambda r: mean_distance(r.across)),
    ),
    Measure("position_error_at_5s_m", "distance along the road after 5 s; mean", _mean_of(_away)),
)
_OF_TAKEOVERS = (
    Measure("taken_over", "share taken over", _mean_of(lambda r: ~np.isnan(r.taken_over_s))),
    Measure("reacted", "share that loses 0.5 m/s", _mean_of(lambda r: ~np.isnan(r.simulated.onset))),
    Measure("reacted_people", "share of people that did", _mean_of(lambda r: ~np.isnan(r.people.onset))),
    Measure("onset_error_s", "difference of onsets where both react; median", _median_of(_onset_errors)),
)
_OF_CLOSENESS = (
    Measure("ttc_below_2", "share below 2 s", _mean_of(lambda r: r.simulated.least_ttc < TTC_SHORT)),
    Measure("ttc_below_2_people", "people's share", _mean_of(lambda r: r.people.least_ttc < TTC_SHORT)),
    Measure("ttc_below_2_excess", "share minus people's", _excess(lambda own: own.least_ttc < TTC_SHORT)),
    Measure(
        "near_misses",
        "share with a gap below 1 m or a time to collision below 1.5 s",
        _mean_of(lambda r: r.simulated.near_miss),
    ),
    Measure("near_misses_people", "people's share", _mean_of(lambda r: r.people.near_miss)),
    Measure("near_misses_excess", "share minus people's", _excess(lambda own: own.near_miss)),
    Measure(
        "near_miss_auc",
        "how well people's near misses are ranked by the simulated least gap and time to collision",
        lambda r, times: areas_under_curve(-np.median(r.simulated.margin, axis=1), r.people.near_miss, times),
    ),
    Measure(
        "wide_kappa",
        "Cohen's kappa of: time to collision below 2.5 s, gap below 2 m, or braking above 2.5 m/s2",
        lambda r, times: kappas(r.simulated.wide.mean(axis=1) > 0.5, r.people.wide, times),
    ),
    Measure(
        "least_gap_ratio",
        "median least gap over people's",
        lambda r, times: medians(r.simulated.least_gap, times) / medians(r.people.least_gap, times),
    ),
    Measure(
        "politeness_m",
        "least gap minus people's; median",
        _median_of(lambda r: r.simulated.least_gap - r.people.least_gap[:, None]),
    ),
    Measure("heroism", "share that brakes harder than anyone did in encounters of the kind", _mean_of(_heroic)),
)
_OF_DRAWS = (*map(_scored, SCORED_S), *map(_covering, LEVELS))
