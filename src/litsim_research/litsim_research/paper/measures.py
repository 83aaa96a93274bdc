"""The measures of the paper's tables: ratios of sums over the runs of a method.

docs/metrics.md has the formulas. ADE is paired: over the same agents and the same steps for all methods of a table.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from litsim_eval.analysis.measure import Metrics
from litsim_eval.campaign.bootstrap import drawn_units, percentile_bounds, ratios
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.results import RunResult
from litsim_sim.core.scene import FloatArray, IntArray

Key = tuple[str, int, str, int | None]
"""Identifies a case across policies: scenario, id of the ego, its driver, seed."""

Whose = Literal["driven", "all"]
"""Agents over which ADE averages: those that any method has driven by then in its run of the case, or all."""


@dataclass(frozen=True)
class Part:
    """The contribution of one run to a measure.

    Attributes:
        draw: seed of the run; the spread of a measure is over draws.
        above, below: addends to numerator and denominator.
    """

    draw: int
    above: float
    below: float


Parts = dict[Key, Part]


@dataclass(frozen=True)
class Figure:
    """A measure of a method.

    Attributes:
        value: over all its runs.
        spread: standard deviation over draws; None with fewer than two.
    """

    value: float
    spread: float | None


def key_of(case: Case) -> Key:
    """Returns the :data:`Key` of `case`."""
    return case.scenario, case.ego_id, case.ego.name, case.seed


def by_key(results: Sequence[RunResult]) -> dict[Key, Metrics | None]:
    """Returns metrics of the runs of a method, by case; None for a run without metrics."""
    return {key_of(result.case): result.metrics for result in results}


RUN_MEASURES: dict[str, Callable[[Metrics], float | None]] = {
    "collision": lambda m: m["collision"]["rate_all"],
    "collision_beyond": lambda m: m["collision"]["excess_rate_all"],
    "collision_driven": lambda m: m["collision"]["rate_controlled"],
    "collision_driven_beyond": lambda m: m["collision"]["excess_rate_controlled"],
    "progress": lambda m: m["progress_m"],
    "relevant": lambda m: m["relevant_ratio_roi"],
    "relevant_ours": lambda m: m["relevant_ratio"],
    "realism": lambda m: m["realism_near"],
    "off_road": lambda m: m["off_road_controlled"],
}
"""Means over runs, by key."""

SHARES: dict[str, Callable[[Metrics], bool]] = {
    "reactivity": lambda m: m["collision_free"],
    "reactivity_beyond": lambda m: m["reactive"],
}
"""Shares of all runs, by key; a failed run counts as false."""

COUNTS: dict[str, Callable[[Metrics], int]] = {
    "colliding": lambda m: int(not m["reactive"]),
    "fault_background": lambda m: m["collision"]["by_fault"]["background"],
    "fault_ego_avoidable": lambda m: m["collision"]["by_fault"]["ego_avoidable"],
    "fault_ego": lambda m: m["collision"]["by_fault"]["ego_unavoidable"],
    "hard_brakes": lambda m: m["comfort"]["controlled"]["hard_brakes"],
    "takeovers": lambda m: m["takeovers"],
}
"""Sums over runs, by key."""


def run_parts(runs: Mapping[Key, Metrics | None], name: str) -> Parts:
    """Returns what each run contributes to the measure `name` of :data:`RUN_MEASURES` or :data:`SHARES`."""
    parts: Parts = {}
    for key, metrics in runs.items():
        draw = key[3] or 0
        if name in SHARES:
            parts[key] = Part(draw, float(metrics is not None and SHARES[name](metrics)), 1.0)
        elif metrics is not None and (value := RUN_MEASURES[name](metrics)) is not None:
            parts[key] = Part(draw, value, 1.0)
    return parts


def count(runs: Mapping[Key, Metrics | None], name: str) -> int:
    """Returns the sum `name` of :data:`COUNTS` over the runs of a method."""
    return sum(COUNTS[name](metrics) for metrics in runs.values() if metrics is not None)


def ade_parts(methods: Mapping[str, Mapping[Key, Metrics | None]], horizon: int, whose: Whose) -> dict[str, Parts]:
    """Returns what runs contribute to ADE up to `horizon` [s], by method, in cases that all methods ran for so long."""
    parts: dict[str, Parts] = {name: {} for name in methods}
    text = str(horizon)
    for key in dict.fromkeys(key for runs in methods.values() for key in runs):
        metrics = {name: runs.get(key) for name, runs in methods.items()}
        displacements = {name: m["displacement"] for name, m in metrics.items() if m is not None}
        if len(displacements) < len(methods) or any(d["agent_steps"].get(text) is None for d in displacements.values()):
            continue
        driven = {
            agent["agent"]: agent["steps"][text]
            for displacement in displacements.values()
            for agent in displacement["agents"]
            if agent["controlled_s"] is not None and agent["controlled_s"] <= horizon
        }
        for name, displacement in displacements.items():
            far = sum(
                agent["ade_m"][text] * agent["steps"][text]
                for agent in displacement["agents"]
                if agent["ade_m"][text] is not None and (whose == "all" or agent["agent"] in driven)
            )
            steps = displacement["agent_steps"][text] if whose == "all" else sum(driven.values())
            parts[name][key] = Part(key[3] or 0, far, float(steps))
    return parts


def figure(parts: Parts) -> Figure | None:
    """Returns the measure over all runs, and its spread; None if there is nothing to measure."""
    value = _ratio(parts.values())
    if value is None:
        return None
    draws = sorted({part.draw for part in parts.values()})
    by_draw = [_ratio([part for part in parts.values() if part.draw == draw]) for draw in draws]
    known = [ratio for ratio in by_draw if ratio is not None]
    return Figure(value, float(np.std(known, ddof=1)) if len(known) > 1 else None)


def interval(ours: Parts, theirs: Parts) -> tuple[float, float] | None:
    """Returns the 95 % interval of theirs minus ours, by paired bootstrap over cases; None for fewer than two cases."""
    keys = [key for key in ours if key in theirs]
    if len(keys) < 2:
        return None
    drawn = drawn_units(len(keys))
    return percentile_bounds(_drawn(theirs, keys, drawn) - _drawn(ours, keys, drawn))


def _drawn(parts: Parts, keys: Sequence[Key], drawn: IntArray) -> FloatArray:
    above = np.array([parts[key].above for key in keys])[drawn].sum(axis=1)
    below = np.array([parts[key].below for key in keys])[drawn].sum(axis=1)
    return ratios(above, below)


def _ratio(parts: Any) -> float | None:
    every = list(parts)
    below = sum(part.below for part in every)
    return sum(part.above for part in every) / below if below else None
