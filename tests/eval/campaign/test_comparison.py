"""Two campaigns of the same cases: which verdicts have changed, and by how much the measures."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import bootstrap

from campaigns import EGO, EGOS, metrics, scenario_file, stored
from litsim_eval.campaign.comparison import CampaignComparison, Change, compare_campaigns, paired_interval
from litsim_sim.core.errors import InputError


def compared(folder: Path, before: Sequence[Any], after: Sequence[Any], **values: Any) -> CampaignComparison:
    both = stored(folder / "a", before, **values), stored(folder / "b", after, sources="c", **values)
    return compare_campaigns(*both)


def of_vehicles(count: int) -> dict[str, Any]:
    """The first `count` egos of the demo, with one seed."""
    return {"cases": [{"scenario": "demo", "ego_id": EGOS[:count]}], "seeds": [0]}


GOOD, BAD = metrics(at_fault=0), metrics(at_fault=1)


@pytest.mark.parametrize(
    ("before", "after", "kinds"),
    [
        (GOOD, GOOD, []),
        (GOOD, BAD, ["newly_failing"]),
        (GOOD, "no answer", ["newly_failing"]),
        (GOOD, None, ["newly_failing"]),
        (BAD, GOOD, ["newly_passing"]),
        ("no answer", GOOD, ["newly_passing"]),
        (BAD, BAD, ["still_failing"]),
        (BAD, "no answer", ["still_failing"]),
        (None, GOOD, []),
        (None, BAD, []),
    ],
)
def test_what_has_become_of_a_case(tmp_path: Path, before: Any, after: Any, kinds: list[str]) -> None:
    found = compared(tmp_path, [before], [after])
    assert len(found.pairs) == 1
    every = ("newly_failing", "newly_passing", "still_failing")
    assert [kind for kind in every if found.those(kind)] == kinds
    told = found.to_json()
    assert [kind for kind in every if told[kind]] == kinds


def test_cases_are_matched_by_all_that_is_no_version(tmp_path: Path) -> None:
    ego = [{"name": "mine", "kind": "perturbed", "parameters": {"ego.kind": kind}} for kind in ("brake", "keep_speed")]
    before = stored(tmp_path / "a", [GOOD, GOOD], egos=[ego[0]])
    after = stored(tmp_path / "b", [BAD, GOOD, GOOD], sources="c", egos=[ego[1]])
    found = compare_campaigns(before, after)
    assert [pair.case.name for pair in found.those("newly_failing")] == [f"demo/{EGO}/mine/litsim/0"]
    assert [case.name for case in found.only_after] == [f"demo/{EGO}/mine/litsim/2"] and found.only_before == ()
    assert found.other_versions == {"sources": ("b", "c")}


def test_cases_of_one_name_whose_scenario_is_another_are_not_the_same(tmp_path: Path) -> None:
    entries = [
        [{"scenario": scenario_file(tmp_path / at, simulation_s=s), "ego_id": 1}, {"scenario": "demo", "ego_id": "ego"}]
        for at, s in (("a", 3.0), ("b", 4.0))
    ]
    before, after = (
        stored(tmp_path / f"out_{at}", [GOOD, GOOD], seeds=[0], cases=each)
        for at, each in zip("ab", entries, strict=True)
    )
    found = compare_campaigns(before, after)
    assert found.renamed == ["own/1/idm/litsim/0"]
    assert [pair.case.name for pair in found.pairs] == [f"demo/{EGO}/idm/litsim/0"]


def test_campaigns_of_other_cases_cannot_be_compared(tmp_path: Path) -> None:
    before, after = (stored(tmp_path / ego, [GOOD], egos=[ego]) for ego in ("idm", "log"))
    with pytest.raises(InputError, match="no case in common; expected the same scenarios, names of egos"):
        compare_campaigns(before, after)


def test_the_json_links_both_reports_and_says_why(tmp_path: Path) -> None:
    found = compared(tmp_path, [GOOD], [BAD])
    told = json.loads(json.dumps(found.to_json()))["newly_failing"][0]
    before, after = (each.cases[0].id for each in (found.before, found.after))
    assert told["name"] == f"demo/{EGO}/idm/litsim/0"
    assert told["before"]["report"] == str(tmp_path / f"a/runs/{before}/report.html")
    assert told["after"]["report"] == str(tmp_path / f"b/runs/{after}/report.html")
    assert (told["before"]["verdict"], told["after"]["verdict"]) == ("passed", "failed")
    assert told["after"]["reason"].startswith("no contact at fault")


def test_changes_are_of_the_runs_that_both_have_measured(tmp_path: Path) -> None:
    before = [metrics(progress_m=value) for value in (10.0, 20.0, 30.0)] + [metrics(progress_m=99.0)]
    after = [metrics(progress_m=value) for value in (11.0, 22.0, 33.0)] + ["no answer"]
    changes = {each.name: each for each in compared(tmp_path, before, after, **of_vehicles(4)).changes}
    progress = changes["progress_m"]
    assert (progress.pairs, progress.differs) == (3, 3)
    assert (progress.before, progress.after, progress.change) == (20.0, 22.0, 2.0)
    assert progress.clear and 1.0 <= progress.interval[0] < 2.0 < progress.interval[1] <= 3.0
    passed = changes["passed"]
    assert (passed.pairs, passed.before, passed.after) == (4, 1.0, 0.75)
    assert changes["collision.ego_at_fault"].differs == 0 and not changes["collision.ego_at_fault"].clear


def test_lists_count_their_entries_and_texts_and_wall_times_are_left_out(tmp_path: Path) -> None:
    entry = metrics()["ledger"][0]
    before = metrics(ledger=[entry], reactive=True, timing={"wall_s": 1.0}, run_id="a", safety={"min_ttc_s": None})
    after = metrics(ledger=[entry] * 2, reactive=False, timing={"wall_s": 2.0}, run_id="b", safety={"min_ttc_s": 1.0})
    changes = {each.name: each.change for each in compared(tmp_path, [before], [after]).changes}
    assert {name: change for name, change in changes.items() if change} == {"ledger": 1.0, "reactive": -1.0}
    assert not {"run_id", "timing.wall_s", "safety.min_ttc_s"} & changes.keys()


def progress_of(comparison: CampaignComparison) -> list[Change]:
    return [change for change in comparison.changes if change.name == "progress_m"]


def test_runs_that_only_repeat_others_narrow_no_interval(tmp_path: Path) -> None:
    """Seeds that change nothing, and other policies on the same road, tell no more than one run of each vehicle."""
    values = [1.0, -2.0, 3.0, 2.5, 4.0]
    before, after = [metrics(progress_m=50.0)] * 5, [metrics(progress_m=50.0 + value) for value in values]
    (alone,) = progress_of(compared(tmp_path / "alone", before, after, **of_vehicles(5)))
    repeated = of_vehicles(5) | {"seeds": [0, 1, 2, 3], "policies": ["replay", "litsim"]}
    found = compared(tmp_path / "repeated", before * 8, after * 8, **repeated)
    (change,) = progress_of(found)
    assert (change.name, change.pairs, found.vehicles) == ("progress_m", 40, 5)
    assert change.interval == pytest.approx(alone.interval)
    assert not change.clear and change.interval[0] < 0.0 < change.interval[1]


def test_seeds_of_one_vehicle_have_no_interval(tmp_path: Path) -> None:
    before, after = ([metrics(progress_m=base + k) for k in (0.0, 0.5, 2.0)] for base in (1.0, 3.0))
    change = compared(tmp_path, before, after).changes[-1]
    assert (change.pairs, change.interval, change.clear) == (3, None, False)


def test_the_interval_is_the_same_every_time() -> None:
    values, vehicles = np.random.default_rng(2).normal(size=30), np.arange(30)
    assert paired_interval(values, vehicles) == paired_interval(values, vehicles)
    assert paired_interval(np.full(5, 2.0), vehicles[:5]) == (2.0, 2.0)


def test_the_interval_of_one_pair_for_each_vehicle_is_that_of_scipy() -> None:
    values = np.random.default_rng(3).normal(1.0, 2.0, 40)
    theirs = bootstrap((values,), np.mean, n_resamples=20000, method="percentile", rng=np.random.default_rng(1))
    assert paired_interval(values, np.arange(40)) == pytest.approx(theirs.confidence_interval, abs=0.05)
