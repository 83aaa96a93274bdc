"""The table of a campaign's results, as pandas reads it."""

from pathlib import Path

import pandas as pd

from campaigns import CRITERIA, EGO, VERSIONS, cases, metrics, suite
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult
from litsim_eval.campaign.results_table import TABLE_FILE, results_table


def test_one_row_a_run_and_one_column_a_measure(tmp_path: Path) -> None:
    first, second, third = cases(seeds=[1, 2, 3], cases=[{"scenario": "demo", "ego_id": "ego", "tags": ["cut_in"]}])[:3]
    measured = metrics(
        at_fault=1,
        seed=1,
        digest="abc",
        reactive=True,
        takeovers=2,
        safety={"min_ttc_s": None, "ttc_below": {"1.5": 3}},
        ledger=[{"agent": 4}, {"agent": 5}],
        timing={"stage_ms": {"bridge": {"median": 0.5}}},
    )
    results = [
        RunResult.judged(first, measured, CRITERIA),
        RunResult.judged(second, metrics(seed=2, ade_all_m={"5": 0.25}), CRITERIA),
        RunResult.error(third, "it crashed"),
    ]
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(), [first, second, third], VERSIONS)
    folder.write_results(results)

    table = pd.read_parquet(tmp_path / TABLE_FILE)
    assert table["verdict"].tolist() == ["failed", "passed", "error"]
    assert table["reason"][0].startswith("no contact at fault") and table["reason"][2] == "it crashed"
    assert table["scenario"].tolist() == ["demo"] * 3 and table["ego_id"].tolist() == [EGO] * 3
    assert table["variant"].tolist() == [first.variant, second.variant, third.variant]
    assert table["seed"].tolist() == [1, 2, 3]
    assert [list(tags) for tags in table["tags"]] == [["cut_in"]] * 3
    assert table["digest"].fillna("").tolist() == ["abc", "", ""]
    assert table["collision.ego_at_fault"][:2].tolist() == [1, 0] and table["collision.ego_at_fault"].isna()[2]
    assert table["reactive"][0] is True and table["takeovers"][0] == 2
    assert table["ledger"][0] == 2, "the length of a list"
    assert table["ade_all_m.5"][1] == 0.25
    assert table["safety.min_ttc_s"].isna().all() and table["safety.min_ttc_s"].dtype == float, "there, if in no run"
    assert table["timing.stage_ms.bridge.median"][0] == 0.5 and not [name for name in table if "*" in name]


def test_without_runs_it_has_the_same_columns() -> None:
    none, one = results_table([]), results_table([RunResult.judged(cases()[0], metrics(), CRITERIA)])
    assert none.schema == one.schema and len(none) == 0
