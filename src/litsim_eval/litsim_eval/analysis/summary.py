"""Summary of the runs of one variant: its column in the table that compares policies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from typing import Any

import numpy as np

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED, added_metrics
from litsim_eval.analysis.metrics_tree import leaves, metric_fields
from litsim_sim.core.errors import shown

Metrics = Mapping[str, Any]
Figure = Callable[[Metrics], float | None]
"""A number of one run from its metrics; None where the run has none."""

SUMS: dict[str, Figure] = {
    "agents": lambda run: run["agents"],
    "colliding_agents": lambda run: run["collision"]["agents"],
    "colliding_runs": lambda run: not run["reactive"],
    "excess_pairs": lambda run: run["collision"]["excess"],
    "ego_contacts": lambda run: len(run["collision"]["ego_contacts"]),
    "background_faults": lambda run: run["collision"].get("by_fault", {}).get("background"),
    "ego_faults_avoidable": lambda run: run["collision"].get("by_fault", {}).get("ego_avoidable"),
    "ego_faults_unavoidable": lambda run: run["collision"].get("by_fault", {}).get("ego_unavoidable"),
    "takeovers": lambda run: run["takeovers"],
    "releases": lambda run: sum(each["released_step"] is not None for each in run["ledger"]),
    "releases_missing": lambda run: sum(
        each["released_step"] is None and each["outcome"] is None for each in run["ledger"]
    ),
    "held_s": lambda run: sum(each["held_s"] for each in run["ledger"]),
    "bound_hits": lambda run: run["detection"]["bound_hits"],
    "false_alarms": lambda run: run["false_alarms"],
    "hard_brakes": lambda run: run["comfort"]["controlled"]["hard_brakes"],
    "hard_brakes_log": lambda run: run["comfort"]["controlled"].get("hard_brakes_log"),
}
"""Sums over the measured runs; none is known if one run lacks it, since an older version measured that run."""

MEANS: dict[str, Figure] = {
    "rate_all": lambda run: run["collision"]["rate_all"],
    "rate_controlled": lambda run: run["collision"]["rate_controlled"],
    "takeovers_per_run": lambda run: float(run["takeovers"]),
    "relevant_ratio": lambda run: run["relevant_ratio"],
    "off_road": lambda run: run["off_road_controlled"],
    "progress_m": lambda run: run["progress_m"],
    "realtime_factor": lambda run: run["timing"]["realtime_factor"],
}
"""Means over those of the measured runs that have the number."""

LARGEST: dict[str, Figure] = {
    "replay_error_max_m": lambda run: run["replay_error_max_m"],
    "max_position_jump_m": lambda run: run["handback"]["max_position_jump_m"],
    "max_residual_m": lambda run: run["handback"]["max_residual_m"],
}
"""Maxima over those of the measured runs that have the number."""

DISPLACEMENTS = ("ade_controlled_m", "ade_all_m")
"""Means likewise, by horizon: see :func:`displacement`."""

RATIOS: dict[str, tuple[Figure, Figure]] = {
    "released_share": (SUMS["releases"], SUMS["takeovers"]),
    "guarded": (
        lambda run: run["comfort"]["controlled"]["guarded"]["count"],
        lambda run: run["comfort"]["controlled"]["guarded"].get("commands"),
    ),
}
"""Sums of the first number over sums of the second: released takeovers; commands of the policy that a guard changed."""


def check_summable(metrics: Metrics) -> None:
    """Checks that measures read from a file can be summarised, and that what criteria judge has its type.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: they cannot; a branch is missing or a field has another type.
    """
    ratios, displacements = chain(*RATIOS.values()), (displacement(name, "5") for name in DISPLACEMENTS)
    for figure in (*SUMS.values(), *MEANS.values(), *LARGEST.values(), *ratios, *displacements):
        figure(metrics)
    steps = [each["detected_step"] for each in metrics["ledger"]]
    steps += [each["step"] for each in metrics["collision"]["contacts"]]
    if max(steps, default=0) > metrics["steps"]:
        raise ValueError(f"a takeover or contact at step {max(steps)}, expected at most {metrics['steps']}")
    kinds = {field.name: field.kinds for field in metric_fields()}
    for name, value in leaves(metrics).items():
        expected = kinds.get(name)
        if value is None or expected is None or type(value) in expected:
            continue
        if not (type(value) is int and float in expected):
            names = " or ".join(sorted(kind.__name__ for kind in expected))
            raise ValueError(f"field {name} is {shown(value)}, expected {names}")


def displacement(name: str, horizon: str) -> Figure:
    """Returns the figure `name` of :data:`DISPLACEMENTS` up to `horizon` [s]."""
    return lambda run: run[name].get(horizon)


def added(name: str) -> Figure:
    """Returns the figure of an added measure, see :mod:`litsim_eval.analysis.metric`."""
    return lambda run: run.get(ADDED, {}).get(name)


def summarise(runs: Iterable[Metrics], failed: int = 0) -> dict[str, Any]:
    """Returns the sums, means and maxima over the measured runs; None where there are no values.

    Args:
        runs: metrics of the measured runs, valid or not.
        failed: number of runs without metrics. They count in `runs` and in the denominator of `reactive`, the share of
            runs known to be free of excess collisions; all other figures are of the `measured` runs alone, and ADE up
            to a horizon of those that lasted that long: as many as `ade_runs` says.
    """
    runs = list(runs)
    total = len(runs) + failed
    horizons = [str(horizon) for horizon in HORIZONS_S]
    return {
        "runs": total,
        "failed": failed,
        "measured": len(runs),
        "invalid": sum(not run["valid"] for run in runs),
        "reactive": sum(run["reactive"] for run in runs) / total if total else None,
        "ade_runs": {horizon: sum(horizon in run["ade_all_m"] for run in runs) for horizon in horizons},
        **{name: _known_sum(map(figure, runs)) for name, figure in SUMS.items()},
        **{name: _ratio(*(_known_sum(map(figure, runs)) for figure in RATIOS[name])) for name in RATIOS},
        **{name: _mean(map(figure, runs)) for name, figure in MEANS.items()},
        **{name: max(_known(map(figure, runs)), default=None) for name, figure in LARGEST.items()},
        **{name: {h: _mean(map(displacement(name, h), runs)) for h in horizons} for name in DISPLACEMENTS},
        ADDED: {name: _mean(map(added(name), runs)) for name in added_metrics()},
    }


def _known_sum(values: Iterable[float | None]) -> float | None:
    """Returns the sum of `values`; None if there are none, or if one is None."""
    addends = list(values)
    return None if None in addends or not addends else sum(value for value in addends if value is not None)


def _ratio(above: float | None, below: float | None) -> float | None:
    return above / below if above is not None and below else None


def _mean(values: Iterable[float | None]) -> float | None:
    known = _known(values)
    return float(np.mean(known)) if known else None


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
