"""Cases with several draws of the background's drivers: their runs, and how probable it is that they fail."""

from io import StringIO

import pytest
from rich.console import Console

from campaigns import CRITERIA, EGOS, cases, metrics
from litsim_eval.campaign.case import Case
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.variant_summary import drawn_cases
from litsim_eval.runs.case_run import plan_of
from litsim_eval.runs.summary_table import print_drawn

DRAWN = ("policy.drivers", "drawn")


def test_policies_that_draw_drivers_run_with_each_draw() -> None:
    drawn = cases(policies=["litsim", "yield", "replay"], drivers=3)
    assert [(case.policy, case.draw) for case in drawn] == [
        *(("litsim", draw) for draw in range(3)),
        ("yield", None),
        ("replay", None),
    ]
    assert all(DRAWN in case.parameters for case in drawn[:3]) and len({case.id for case in drawn}) == 5
    assert [Case.from_json(case.to_json()) for case in drawn] == drawn
    assert drawn[2].name.endswith(", drivers 2") and drawn[2].of_all_draws == drawn[0].of_all_draws


def test_who_wants_the_median_driver_gets_it_once() -> None:
    (case,) = cases(policies=["litsim"], drivers=3, parameters={"policy.drivers": "median"})
    assert case.draw is None
    (case,) = cases(policies=["litsim"])
    assert case.draw is None and DRAWN not in case.parameters


def test_each_draw_has_other_drivers_and_the_same_ego() -> None:
    plans = [plan_of(case) for case in cases(policies=["litsim"], drivers=2, egos=["perturbed"])]
    one, other = (plan.scenario for plan in plans)
    assert (one.seed, one.ego_id) == (other.seed, other.ego_id)
    assert (one.identities[:, 0] != other.identities[:, 0]).all()
    assert plans[0].identity != plans[1].identity


def results(failed: int, drivers: int, errors: int = 0) -> list[RunResult]:
    """Of one case, and of a second that passes with all drivers."""
    first, second = (
        cases(cases=[{"scenario": "demo", "ego_id": ego}], policies=["litsim"], drivers=drivers) for ego in EGOS[:2]
    )
    judged = [RunResult.judged(case, metrics(int(k < failed)), CRITERIA) for k, case in enumerate(first)]
    judged[drivers - errors :] = [RunResult.error(case, "lost") for case in first[drivers - errors :]]
    return judged + [RunResult.judged(case, metrics(), CRITERIA) for case in second]


@pytest.mark.parametrize(("failed", "bounds"), [(0, (0.0, 0.194)), (4, (0.102, 0.495)), (16, (0.806, 1.0))])
def test_the_probability_is_the_share_with_wilsons_interval(failed: int, bounds: tuple[float, float]) -> None:
    case = drawn_cases(results(failed, 16))[0]
    assert (case.failed, case.drivers, case.probability) == (failed, 16, failed / 16)
    assert case.bounds == pytest.approx(bounds, abs=1e-3)


def test_runs_that_could_not_be_judged_do_not_count() -> None:
    assert [(case.failed, case.drivers) for case in drawn_cases(results(1, 4, errors=1))] == [(1, 3), (0, 4)]


def test_the_table_lists_cases_that_fail() -> None:
    console = Console(file=StringIO(), width=100)
    print_drawn(drawn_cases(results(4, 16)), 20, console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "4 of 16 drivers   25 [10, 49]" in text and "1 of 2 cases pass with all drivers" in text
