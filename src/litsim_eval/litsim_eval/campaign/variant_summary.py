"""What the runs of a variant, or of a case with several drivers, come to, and how far the figures are from chance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from litsim_eval.analysis.measure import Figure, mean, total
from litsim_eval.analysis.summary import summarise, table_rows
from litsim_eval.campaign.bootstrap import LEVEL, percentile_bounds, ratios, times_drawn
from litsim_eval.campaign.criteria import PASSED_SHARE, Verdict
from litsim_eval.campaign.results import RunResult
from litsim_sim.core.scene import FloatArray

Bounds = dict[str, tuple[float, float]]
"""Bounds by the name of the measure; `ade_all_m.5` is that of a horizon."""

VERDICTS = {"passed": Verdict.PASSED, "not_passed": Verdict.FAILED, "errors": Verdict.ERROR}
"""Verdicts by the names of their numbers of runs."""


def variant_summary(results: Sequence[RunResult]) -> dict[str, Any]:
    """Returns measures as :func:`litsim_eval.analysis.summary.summarise` does, and how many runs have which verdict.

    Verdicts are counted as `passed`, `not_passed` (by a criterion) and `errors`; `passed_share` is that of all runs,
    None without runs.
    """
    measured = [dict(result.metrics) for result in results if result.metrics is not None]
    counts = Counter(result.verdict for result in results)
    return summarise(measured, len(results) - len(measured)) | {
        **{name: counts[verdict] for name, verdict in VERDICTS.items()},
        PASSED_SHARE: counts[Verdict.PASSED] / len(results) if results else None,
    }


def variant_bounds(results: Sequence[RunResult]) -> Bounds:
    """Returns bounds of the sums, means and shares of :func:`variant_summary`.

    They are 95 % intervals by the bootstrap over the vehicles that are the ego: all runs of one vehicle of a scenario
    are drawn together, since its seeds resemble each other. There are no bounds of maxima, of figures that are the same
    in all draws (no contact in all runs does not mean that there never is one), and none with fewer than two vehicles.

    Args:
        results: of the runs of a variant.
    """
    vehicles = list(dict.fromkeys(result.case.vehicle for result in results))
    if len(vehicles) < 2:
        return {}
    own = [vehicles.index(result.case.vehicle) for result in results]
    times = times_drawn(len(vehicles))[:, own]
    intervals = {
        name: percentile_bounds(times @ above if below is None else ratios(times @ above, times @ below))
        for name, above, below in _figures(results)
    }
    return {name: bounds for name, bounds in intervals.items() if bounds is not None and bounds[0] < bounds[1]}


def _figures(results: Sequence[RunResult]) -> Iterator[tuple[str, FloatArray, FloatArray | None]]:
    """Yields each figure: name, and what each run (n,) adds to numerator and denominator, which is None for a sum."""
    measured = np.array([result.metrics is not None for result in results])

    def values(figure: Figure) -> FloatArray:
        found = (None if result.metrics is None else figure(result.metrics) for result in results)
        return np.array([np.nan if value is None else value for value in found])

    for name, verdict in VERDICTS.items():
        yield name, np.array([float(result.verdict == verdict) for result in results]), None
    yield "reactive", np.nan_to_num(values(lambda run: run["reactive"])), np.ones(len(results))
    for row in table_rows():
        assert row.figure is not None
        above = values(row.figure)
        if row.over is mean:
            yield row.name, np.nan_to_num(above), (~np.isnan(above)).astype(float)
        elif row.over is total and not np.isnan(above[measured]).any():
            below = None if row.below is None else values(row.below)
            if below is None or not np.isnan(below[measured]).any():
                yield row.name, np.nan_to_num(above), below if below is None else np.nan_to_num(below)


@dataclass(frozen=True)
class DrawnCase:
    """A case with several draws of the background's drivers.

    Attributes:
        name: of the case, without the draw.
        variant: of its runs.
        drivers: number of draws whose runs could be judged.
        failed: how many of these runs have failed.
        probability: with which it fails, as far as these runs tell.
        bounds: 95 % interval of the probability (Wilson 1927).
    """

    name: str
    variant: str
    drivers: int
    failed: int
    probability: float
    bounds: tuple[float, float]


def drawn_cases(results: Iterable[RunResult]) -> list[DrawnCase]:
    """Returns the cases in `results` that were run with several draws, those that fail most often first."""
    runs: dict[str, list[RunResult]] = {}
    for result in results:
        if result.case.draw is not None and result.verdict != Verdict.ERROR:
            runs.setdefault(result.case.of_all_draws, []).append(result)
    return sorted((_of_runs(name, own) for name, own in runs.items()), key=lambda case: -case.probability)


def _of_runs(name: str, runs: list[RunResult]) -> DrawnCase:
    failed = sum(run.verdict == Verdict.FAILED for run in runs)
    interval = binomtest(failed, len(runs)).proportion_ci(LEVEL, method="wilson")
    bounds = float(interval.low), float(interval.high)
    return DrawnCase(name, runs[0].case.variant, len(runs), failed, failed / len(runs), bounds)
