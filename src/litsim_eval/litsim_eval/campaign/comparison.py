"""Comparison of two campaigns of the same cases: changed verdicts, and changes of the measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from litsim_eval.analysis.compare import OF_AN_EXECUTION
from litsim_eval.analysis.metrics import leaves
from litsim_eval.campaign.bootstrap import LEVEL, RESAMPLES, SEED, percentile_bounds, ratios, times_drawn
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.criteria import CriterionResult, Verdict
from litsim_eval.campaign.results import RUNS_FOLDER, Campaign, RunResult
from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import FloatArray, IntArray

PASSED = "passed"
NOT_RUN = "not run"


@dataclass(frozen=True)
class Pair:
    """A case that both campaigns have.

    Attributes:
        case: as the second campaign has it.
        before, after: its results; None if it has not been run.
    """

    case: Case
    before: RunResult | None
    after: RunResult | None

    @property
    def newly_failing(self) -> bool:
        """Whether it passed and does not any more, for any reason; one is that it has not been run."""
        return _passed(self.before) and not _passed(self.after)

    @property
    def newly_passing(self) -> bool:
        """Whether it was run without passing, and passes now."""
        return self.before is not None and not _passed(self.before) and _passed(self.after)

    @property
    def still_failing(self) -> bool:
        """Whether it was run and passes neither before nor after."""
        return self.before is not None and not _passed(self.before) and not _passed(self.after)

    @property
    def newly_missed(self) -> tuple[CriterionResult, ...]:
        """Criteria that were met before and are not any more, of a case that was judged both times."""
        met = {criterion.name for criterion in (self.before.criteria if self.before else ()) if criterion.passed}
        return tuple(
            criterion
            for criterion in (self.after.criteria if self.after else ())
            if not criterion.passed and criterion.name in met
        )

    @property
    def worse(self) -> bool:
        """Whether it failed already, and now misses further criteria, or cannot be judged any more."""
        lost = self.before is not None and self.before.verdict == Verdict.FAILED
        lost = lost and self.after is not None and self.after.verdict == Verdict.ERROR
        return self.still_failing and (lost or bool(self.newly_missed))


@dataclass(frozen=True)
class Change:
    """One measure over the pairs of runs that both have it.

    Attributes:
        name: path in `metrics.json`, with lists by their lengths and booleans by the share of true; or :data:`PASSED`,
            the share of cases that pass.
        pairs: number of pairs that have it.
        differs: number of pairs in which it differs.
        before, after, change: means, and the mean difference, after minus before.
        interval: bounds of `change` by :func:`paired_interval`; None if all pairs are of one vehicle.
    """

    name: str
    pairs: int
    differs: int
    before: float
    after: float
    change: float
    interval: tuple[float, float] | None

    @property
    def clear(self) -> bool:
        """Whether the bounds exclude 0, that is no change."""
        return self.interval is not None and (self.interval[0] > 0.0 or self.interval[1] < 0.0)


@dataclass(frozen=True)
class CampaignComparison:
    """Two campaigns, the first before the second.

    Attributes:
        before, after: the campaigns.
        pairs: cases of both, in the order of the second.
        only_before, only_after: cases of one of them only.
        changes: changes of each measure that both runs of any pair have, :data:`PASSED` first.
    """

    before: Campaign
    after: Campaign
    pairs: tuple[Pair, ...]
    only_before: tuple[Case, ...]
    only_after: tuple[Case, ...]
    changes: tuple[Change, ...]

    def those(self, verdict: str) -> list[Pair]:
        """Returns the pairs of which this property of :class:`Pair` is true, such as `newly_failing`."""
        return [pair for pair in self.pairs if getattr(pair, verdict)]

    @property
    def vehicles(self) -> int:
        """Number of vehicles that are the ego of any pair."""
        return len({pair.case.vehicle for pair in self.pairs})

    @property
    def other_versions(self) -> dict[str, tuple[str | None, str | None]]:
        """Dependencies of the runs with different versions, with both versions."""
        before, after = self.before.versions, self.after.versions
        return {n: (before.get(n), after.get(n)) for n in {**before, **after} if before.get(n) != after.get(n)}

    @property
    def other_criteria(self) -> list[str]:
        """Names of the criteria of runs that only one of the campaigns has, or that have other fields or limits."""
        before, after = ({run.title: run for run in campaign.criteria.runs} for campaign in (self.before, self.after))
        return [name for name in {**before, **after} if before.get(name) != after.get(name)]

    @property
    def renamed(self) -> list[str]:
        """Names of common cases that are not the same run, because the content of their scenarios differs."""
        names = {case.name for case in self.only_after}
        return [case.name for case in self.only_before if case.name in names]

    def to_json(self) -> dict[str, Any]:
        """Returns the comparison as values for JSON: changed verdicts with both reports of each run, all measures."""
        changed = ("newly_failing", "newly_passing", "still_failing")
        return {
            "before": _described(self.before),
            "after": _described(self.after),
            "versions": self.other_versions,
            "other_criteria": self.other_criteria,
            "common": len(self.pairs),
            "vehicles": self.vehicles,
            **{verdict: [self._described(pair) for pair in self.those(verdict)] for verdict in changed},
            "worse": [
                self._described(pair) | {"newly_missed": [criterion.name for criterion in pair.newly_missed]}
                for pair in self.those("worse")
            ],
            "only_before": [case.name for case in self.only_before],
            "only_after": [case.name for case in self.only_after],
            "bootstrap": {"level": LEVEL, "resamples": RESAMPLES, "seed": SEED},
            "measures": [asdict(change) for change in self.changes],
        }

    def _described(self, pair: Pair) -> dict[str, Any]:
        both = {"before": (self.before, pair.before), "after": (self.after, pair.after)}
        return {"name": pair.case.name, "key": pair.case.key} | {
            name: {
                "verdict": result.verdict.value if result else None,
                "reason": result.reason if result else NOT_RUN,
                "report": str(path) if (path := report_of(campaign, result)) else None,
            }
            for name, (campaign, result) in both.items()
        }


def compare_campaigns(before: Campaign, after: Campaign) -> CampaignComparison:
    """Compares two campaigns; their cases are matched by :attr:`litsim_eval.campaign.case.Case.key`.

    Raises:
        InputError: they have no case in common.
    """
    cases_before, cases_after = ({case.key: case for case in campaign.cases} for campaign in (before, after))
    first, second = ({result.case.key: result for result in campaign.results} for campaign in (before, after))
    pairs = tuple(
        Pair(case, first.get(key), second.get(key)) for key, case in cases_after.items() if key in cases_before
    )
    if not pairs:
        raise InputError(
            f"{before.folder} and {after.folder}: no case in common; expected the same scenarios, names of egos, "
            "policies, parameters and seeds"
        )
    return CampaignComparison(
        before=before,
        after=after,
        pairs=pairs,
        only_before=tuple(case for key, case in cases_before.items() if key not in cases_after),
        only_after=tuple(case for key, case in cases_after.items() if key not in cases_before),
        changes=tuple(_changes(pairs)),
    )


def report_of(campaign: Campaign, result: RunResult | None) -> Path | None:
    """Returns the report of a run of `campaign`; None if it has none."""
    return campaign.folder / RUNS_FOLDER / result.case.id / result.report if result and result.report else None


def paired_interval(difference: FloatArray, vehicles: IntArray) -> tuple[float, float] | None:
    """Returns bounds at :data:`LEVEL` of a mean by the bootstrap over vehicles; None for fewer than two.

    The interval is the percentiles of :data:`RESAMPLES` means of the pairs of vehicles drawn with replacement (Efron
    1979), drawn with the same seed every time. All pairs of one vehicle (its seeds, drivers and policies) are drawn
    together, since they resemble each other: what only repeats a run would narrow the interval otherwise.

    Args:
        difference: (n,) values, one for each pair.
        vehicles: (n,) number of the vehicle that is the ego of each pair.
    """
    drawn, vehicle = np.unique(vehicles, return_inverse=True)
    if len(drawn) < 2:
        return None
    if np.ptp(difference) == 0.0:
        return float(difference[0]), float(difference[0])
    times, count = times_drawn(len(drawn)), len(drawn)
    sums, pairs = np.bincount(vehicle, difference, count), np.bincount(vehicle, minlength=count)
    return percentile_bounds(ratios(times @ sums, times @ pairs))


def _changes(pairs: Sequence[Pair]) -> list[Change]:
    """Returns every measure that both runs of any pair have, whether it differs or not, in the order of `metrics.json`.

    Runs that could not be judged have no measures, but count as not passed.
    """
    vehicles = {vehicle: number for number, vehicle in enumerate(dict.fromkeys(pair.case.vehicle for pair in pairs))}
    columns: dict[str, list[tuple[float, float, int]]] = {}
    for pair in pairs:
        before, after = ({PASSED: float(_passed(result))} | _measures(result) for result in (pair.before, pair.after))
        for name, value in before.items():
            if name in after:
                columns.setdefault(name, []).append((value, after[name], vehicles[pair.case.vehicle]))
    return [_change(name, values) for name, values in columns.items()]


def _change(name: str, values: Sequence[tuple[float, float, int]]) -> Change:
    """Returns the change of a measure from its value before and after and the number of the vehicle, of each pair."""
    before, after, vehicles = np.array(values).T
    return Change(
        name=name,
        pairs=len(values),
        differs=int(np.count_nonzero(after != before)),
        before=float(before.mean()),
        after=float(after.mean()),
        change=float(after.mean()) - float(before.mean()),
        interval=paired_interval(after - before, vehicles.astype(np.int64)),
    )


def _measures(result: RunResult | None) -> dict[str, float]:
    """Returns the numbers of a run that was judged, by name, without those of the execution."""
    if result is None or result.verdict == Verdict.ERROR:
        return {}
    return {
        name: float(len(value) if isinstance(value, list) else value)
        for name, value in leaves(result.metrics or {}).items()
        if name.split(".")[0] not in OF_AN_EXECUTION and value is not None and not isinstance(value, str)
    }


def _passed(result: RunResult | None) -> bool:
    return result is not None and result.verdict == Verdict.PASSED


def _described(campaign: Campaign) -> dict[str, Any]:
    return {"folder": str(campaign.folder), "name": campaign.name, "cases": len(campaign.cases)}
