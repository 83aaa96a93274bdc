"""What the runs of a row come to together; measured ones are in tests/policy/run/test_campaign.py."""

from __future__ import annotations

from campaigns import cases
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.row_summary import row_summary


def test_runs_that_left_nothing_count() -> None:
    summary = row_summary([RunResult.error(case, "lost") for case in cases()])
    assert (summary["runs"], summary["measured"], summary["errors"], summary["passed_share"]) == (2, 0, 2, 0.0)


def test_no_runs() -> None:
    assert row_summary([])["passed_share"] is None
