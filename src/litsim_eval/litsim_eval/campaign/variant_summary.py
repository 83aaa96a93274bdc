"""Summary of the runs of one variant of a campaign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from litsim_eval.analysis.summary import summarise
from litsim_eval.campaign.criteria import PASSED_SHARE, Verdict
from litsim_eval.campaign.results import RunResult

VERDICTS = {"passed": Verdict.PASSED, "not_passed": Verdict.FAILED, "errors": Verdict.ERROR}
"""Verdicts by the names of their numbers of runs."""


def variant_summary(results: Sequence[RunResult]) -> dict[str, Any]:
    """Measures as of :func:`litsim_eval.analysis.summary.summarise`, and how many of the runs have which verdict.

    Verdicts are counted as `passed`, `not_passed` (by a criterion) and `errors`; `passed_share` is that of all runs,
    None without runs.
    """
    measured = [dict(result.metrics) for result in results if result.metrics is not None]
    counts = Counter(result.verdict for result in results)
    return summarise(measured, len(results) - len(measured)) | {
        **{name: counts[verdict] for name, verdict in VERDICTS.items()},
        PASSED_SHARE: counts[Verdict.PASSED] / len(results) if results else None,
    }
