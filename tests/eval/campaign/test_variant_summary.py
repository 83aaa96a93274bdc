"""Summary of the runs of a variant, and bounds of its figures by the bootstrap over the vehicles that are the ego."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from scipy.stats import bootstrap

from campaigns import CRITERIA, cases, summarised_metrics
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.variant_summary import variant_bounds, variant_summary

EGOS = [7, 20, 24, 5, 2, 15, 3, 4, 1, 8]
RATES = [0.0, 0.01, 0.02, 0.0, 0.05, 0.03, 0.0, 0.0, 0.04, 0.02]


def judged(each: Sequence[dict[str, Any] | None], seeds: Sequence[int] = (0,)) -> list[RunResult]:
    """A run for each of `each`, its changed metrics, by ego and then by seed; None for one that could not be judged."""
    egos = EGOS[: len(each) // len(seeds)]
    asked = cases(cases=[{"scenario": "demo", "ego_id": egos}], policies=["litsim"], seeds=list(seeds))
    asked.sort(key=lambda case: (egos.index(case.ego_id), case.seed))
    return [
        RunResult.error(case, "lost")
        if changes is None
        else RunResult.judged(case, summarised_metrics(**{"collision": {"ego_at_fault": 0}} | changes), CRITERIA)
        for case, changes in zip(asked, each, strict=True)
    ]


def collides(rate: float) -> dict[str, Any]:
    return {"collision": {"ego_at_fault": 0, "rate_all": rate}}


def test_bounds_of_a_mean_are_those_of_scipy() -> None:
    found = variant_bounds(judged([collides(rate) for rate in RATES]))["rate_all"]
    theirs = bootstrap((RATES,), np.mean, n_resamples=20000, method="percentile", rng=np.random.default_rng(1))
    assert found == pytest.approx(theirs.confidence_interval, abs=0.0015)


def test_bounds_of_sums_are_of_as_many_vehicles_and_shares_lie_between_those_of_the_runs() -> None:
    released = [{"released_step": 80, "held_s": 3.0, "outcome": "back_on_log"}]
    results = judged([{"takeovers": n, "ledger": released if n % 2 else []} for n in range(1, 11)])
    found, variant = variant_bounds(results), variant_summary(results)
    low, high = found["takeovers"]
    assert 10 < low < variant["takeovers"] == 55 < high < 100
    assert found["takeovers_per_run"] == pytest.approx((low / 10, high / 10))
    low, high = found["released_share"]
    assert 0.0 < low < variant["released_share"] == 5 / 55 < high < 1.0


def test_runs_of_one_vehicle_are_drawn_together() -> None:
    alone = variant_bounds(judged([collides(rate) for rate in RATES]))
    repeated = variant_bounds(judged([collides(rate) for rate in RATES for _ in range(4)], seeds=range(4)))
    assert repeated["rate_all"] == pytest.approx(alone["rate_all"]), "the same run four times tells nothing new"


def test_runs_that_could_not_be_judged_count_among_verdicts_and_reactive_runs_alone() -> None:
    found = variant_bounds(judged([collides(rate) for rate in RATES[:8]] + [None, None]))
    low, high = found["errors"]
    assert low < 2 < high and found["reactive"] == pytest.approx((1 - high / 10, 1 - low / 10))
    assert found["rate_all"][1] <= max(RATES[:8])


def test_no_contact_in_all_runs_has_no_bounds() -> None:
    found = variant_bounds(judged([collides(rate) for rate in RATES]))
    assert "background_faults" not in found and "agents" not in found and "max_residual_m" not in found


def test_figures_that_older_versions_did_not_measure_have_no_bounds() -> None:
    older = {"comfort": {"controlled": {"hard_brakes": 1, "guarded": {"count": 5, "share": 0.1}}}}
    found = variant_bounds(judged([older if k else {"takeovers": 5, "comfort": {}} for k in range(10)]))
    assert "guarded" not in found and "hard_brakes_log" not in found and "hard_brakes" in found


def test_one_vehicle_has_no_bounds() -> None:
    assert variant_bounds(judged([collides(rate) for rate in RATES[:4]], seeds=range(4))) == {}


def test_runs_that_left_nothing_count() -> None:
    summary = variant_summary([RunResult.error(case, "lost") for case in cases()])
    assert (summary["runs"], summary["measured"], summary["errors"], summary["passed_share"]) == (2, 0, 2, 0.0)
    assert variant_summary([])["passed_share"] is None
