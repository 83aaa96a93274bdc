"""What the terminal says of two campaigns."""

import io
from pathlib import Path

from rich.console import Console

from campaigns import EGO, EGOS, metrics, stored
from litsim_eval.campaign.comparison import compare_campaigns
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import Campaign
from litsim_eval.report.campaign_comparison import CASES_MAX, print_campaigns


def printed(before: Campaign, after: Campaign, *, everything: bool = False) -> str:
    text = io.StringIO()
    print_campaigns(compare_campaigns(before, after), Console(file=text, width=100), everything=everything)
    return text.getvalue()


def test_what_differs_between_the_versions_is_said(tmp_path: Path) -> None:
    before, after = (stored(tmp_path / name, [metrics()], sources=name) for name in ("a", "b"))
    assert f"{tmp_path}/a -> {tmp_path}/b\n  sources: a -> b\n0 of 1 newly failing\n" in printed(before, after)


def test_other_criteria_are_said(tmp_path: Path) -> None:
    """A run that has not changed fails newly if its limits have: nobody should look for the cause in the system."""
    strict = {"runs": [{"name": "no contact at fault", "field": "collision.ego_at_fault", "max": 0}]}
    strict["runs"].append({"field": "progress_m", "min": 5.0})
    before = stored(tmp_path / "a", [metrics(progress_m=1.0)])
    after = stored(tmp_path / "b", [metrics(progress_m=1.0)], criteria=Criteria.model_validate(strict))
    told = "judged by other criteria, so that equal runs may differ: progress_m at least 5\n"
    assert told in (said := printed(before, after)) and "1 of 1 newly failing" in said
    assert compare_campaigns(before, after).to_json()["other_criteria"] == ["progress_m at least 5"]
    assert "other criteria" not in printed(before, before)


def test_a_long_list_is_cut_and_said_to_be(tmp_path: Path) -> None:
    count = CASES_MAX + 3
    before = stored(tmp_path / "a", [metrics()] * count)
    after = stored(tmp_path / "b", [metrics(at_fault=1)] * count)
    assert "and 3 more (--all)" in (short := printed(before, after))
    assert f"/{count - 1}\n" not in short
    whole = printed(before, after, everything=True)
    assert f"demo/{EGO}/idm/litsim/{count - 1}\n" in whole and "more" not in whole


def test_cases_of_one_campaign_and_those_failing_in_both_are_counted(tmp_path: Path) -> None:
    before = stored(tmp_path / "a", [metrics(), metrics(at_fault=1)])
    after = stored(tmp_path / "b", [metrics(), metrics(at_fault=1), metrics()], seeds=[0, 1, 5])
    said = printed(before, after)
    assert "1 pass in neither" in said
    assert f"only in {tmp_path}/b: 1, such as demo/{EGO}/idm/litsim/5" in said and f"only in {tmp_path}/a" not in said


def test_what_a_case_that_failed_before_fails_by_newly_is_told(tmp_path: Path) -> None:
    two = [{"name": "no contact", "field": "collision.ego_at_fault", "max": 0}, {"field": "progress_m", "min": 5.0}]
    lost = "no answer to step 3"
    outcomes = {"a": [(1, 9.0), (1, 9.0), (1, 1.0)], "b": [(1, 2.0), (1, 8.0), None]}
    both = [
        stored(
            tmp_path / name,
            [metrics(at_fault=run[0], progress_m=run[1]) if run else lost for run in runs],
            criteria=Criteria(runs=two),
        )
        for name, runs in outcomes.items()
    ]
    said = printed(*both)
    assert "3 pass in neither\n2 of these fail by more than before\n" in said
    assert f"demo/{EGO}/idm/litsim/0\n    progress of all agents 2.00 m, expected at least 5 m\n" in said
    assert f"demo/{EGO}/idm/litsim/2\n    is error: no answer to step 3\n" in said and "litsim/1\n" not in said
    told = compare_campaigns(*both).to_json()["worse"]
    assert [each["newly_missed"] for each in told] == [["progress_m at least 5"], []]
    assert "fail by more" not in printed(*both[::-1]) and compare_campaigns(*both[::-1]).those("worse") == []


def test_measures_that_have_hardly_changed_are_shown_on_request(tmp_path: Path) -> None:
    asked = {"cases": [{"scenario": "demo", "ego_id": EGOS[:4]}], "seeds": [0]}
    both = ("a", (1.0, 2.0, 3.0, 4.0)), ("b", (2.0, 1.0, 4.0, 3.0))
    before, after = (
        stored(tmp_path / name, [metrics(progress_m=value, takeovers=3) for value in values], **asked)
        for name, values in both
    )
    short, whole = printed(before, after), printed(before, after, everything=True)
    assert "1 more measures differ (--all)" in short and "progress_m" not in short
    row = next(line for line in whole.splitlines() if "progress_m" in line)
    assert row.split()[:5] == ["progress_m", "4", "2.5", "2.5", "0"], "not marked: its interval holds 0"
    assert "takeovers" not in whole, "nothing differs"
    assert "(paired bootstrap over 4 vehicles, 2000 resamples)" in short and "fewer than 20 vehicles" in short
