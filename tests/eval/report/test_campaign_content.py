"""What the page of a campaign embeds: measures, happenings, criteria."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from litsim_eval.analysis.metrics import measures_by_field
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.campaign.results import Campaign, read_campaign
from litsim_eval.report.campaign_content import criteria_of, fields_of, pack_campaign
from packed import unpack


@pytest.fixture
def read(campaign: Callable[..., Path], tmp_path: Path) -> Campaign:
    return read_campaign(campaign(tmp_path))


def by_path(campaign: Campaign) -> dict[str, dict[str, Any]]:
    return {field["path"]: field for field in fields_of(campaign)}


def test_fields_hold_a_value_for_each_run_and_none_where_there_is_none(read: Campaign) -> None:
    ttc = by_path(read)["safety.min_ttc_s"]
    assert ttc["values"] == [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 0.0, 0.2, 0.4, 0.6, None, 1.0]
    assert (ttc["label"], ttc["digits"], ttc["main"]) == ("ego: shortest TTC [s]", 2, True)


def test_what_criteria_ask_for_comes_first_with_its_limits(read: Campaign) -> None:
    fields = fields_of(read)
    assert [field["path"] for field in fields[:3]] == ["collision.ego_at_fault", "safety.min_ttc_s", "takeovers"]
    assert [field["limits"] for field in fields[:4]] == [[0.0], [0.3], [100.0], []]
    assert [field["path"] for field in fields if field["main"]][3:] == ["ego_motion.progress_ratio"]
    assert len({field["path"] for field in fields}) == len(fields)


def test_what_the_default_criteria_ask_for_is_called_by_words() -> None:
    assert all(measures_by_field()[criterion.field].title for criterion in Criteria.load().runs)


def test_lists_are_counted_truth_values_kept_and_texts_left_out(read: Campaign) -> None:
    fields = by_path(read)
    assert fields["ledger"]["values"][0] == 1
    assert fields["reactive"]["values"][0] is False or fields["reactive"]["values"][0] is True
    assert not {"digest", "why", "scenario"} & set(fields)
    assert not any(path.startswith("timing.stage_ms") for path in fields)


def test_happenings_are_takeovers_and_contacts_that_the_log_has_not(read: Campaign, tmp_path: Path) -> None:
    first, *rest = read.results
    assert first.metrics is not None
    ledger = [
        {"detected_step": 12, "released_step": None, "held_s": 4.8},
        {"detected_step": 3, "released_step": 9, "held_s": 0.7},
        {"detected_step": 7, "released_step": None, "held_s": 1.3},  # it left the net, at step 20
    ]
    contacts = [{"pair": [1, 2], "step": 30, "in_log": False}, {"pair": [1, 3], "step": 5, "in_log": True}]
    metrics = {**first.metrics, "ledger": ledger, "collision": first.metrics["collision"] | {"contacts": contacts}}
    changed = replace(read, results=(replace(first, metrics=metrics), *rest))
    run = unpack(pack_campaign(changed, {}, tmp_path))[0]["runs"][0]
    assert (run["steps"], run["takeovers"], run["contacts"]) == (60, [[12, 60], [3, 10], [7, 20]], [30])


def test_runs_of_a_case_are_known_in_other_variants(read: Campaign, tmp_path: Path) -> None:
    runs = unpack(pack_campaign(read, {}, tmp_path))[0]["runs"]
    assert [run["same"] for run in runs[:6]] == [run["same"] for run in runs[6:]]
    assert len({run["same"] for run in runs}) == 6


def test_criteria_of_other_times_are_not_lost(read: Campaign) -> None:
    own = read.criteria.model_copy(update={"runs": read.criteria.runs[:1]})
    names = [name for name, _, _ in criteria_of(replace(read, criteria=own))]
    assert names == ["no contact at fault", "time to collision", "takeovers at most 100"]
