"""Cases that are run with several draws of the background's drivers: how probable it is that one fails."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from scipy.stats import binomtest

from litsim_eval.campaign.bootstrap import LEVEL
from litsim_eval.campaign.criteria import Verdict
from litsim_eval.campaign.results import RunResult


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
