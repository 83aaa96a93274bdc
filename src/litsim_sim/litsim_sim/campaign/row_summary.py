"""Summary of the runs of one row of a campaign's tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from litsim_sim.analysis.summary import summarise
from litsim_sim.campaign.criteria import PASSED_SHARE, Verdict
from litsim_sim.campaign.results import RunResult


def row_summary(results: Sequence[RunResult]) -> dict[str, Any]:
    """Measures as of :func:`litsim_sim.analysis.summary.summarise`, and how many of the runs have which verdict.

    Verdicts are counted as `passed`, `not_passed` (by a criterion) and `errors`; `passed_share` is that of all runs,
    None without runs.
    """
    measured = [dict(result.metrics) for result in results if result.metrics is not None]
    counts = Counter(result.verdict for result in results)
    return summarise(measured, len(results) - len(measured)) | {
        "passed": counts[Verdict.PASSED],
        "not_passed": counts[Verdict.FAILED],
        "errors": counts[Verdict.ERROR],
        PASSED_SHARE: counts[Verdict.PASSED] / len(results) if results else None,
    }
