"""What the runs of a variant come to together."""

from __future__ import annotations

from campaigns import cases
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.variant_summary import variant_summary


def test_runs_that_left_nothing_count() -> None:
    summary = variant_summary([RunResult.error(case, "lost") for case in cases()])
    assert (summary["runs"], summary["measured"], summary["errors"], summary["passed_share"]) == (2, 0, 2, 0.0)


def test_no_runs() -> None:
    assert variant_summary([])["passed_share"] is None
