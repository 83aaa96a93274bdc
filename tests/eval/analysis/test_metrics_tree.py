"""The fields of metrics.json are known before a run, and all that a run has are among them."""

import pytest

from litsim_eval.analysis.metrics import find_field


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("collision.ego_fault", r"collision\.ego_at_fault"),
        ("safety.ttc_min_s", r"safety\.min_ttc_s"),
        ("safety.ttc_below", r"safety\.ttc_below\.0\.95, safety\.ttc_below\.1\.5"),
        ("hard_brakes", r"ego_motion\.hard_brakes, .*comfort\.ego\.hard_brakes"),
        ("comfort.ego.within.jerks", r"comfort\.ego\.within\.jerk"),
        ("ade_ego_m.7", r"ade_ego_m\.5"),
    ],
)
def test_an_unknown_field_names_those_called_nearly_so(name: str, near: str) -> None:
    with pytest.raises(ValueError, match=rf"no field {name} of metrics\.json \(near: .*{near}"):
        find_field(name)


def test_what_is_near_nothing_is_told_where_to_look() -> None:
    with pytest.raises(ValueError, match=r"no field qqq of metrics\.json; docs/metrics\.md has all"):
        find_field("qqq")


@pytest.mark.parametrize("name", ["timing.stage_ms.ego.max", "lockstep.missed_by_topic./litsim/ego/control"])
def test_keys_that_only_a_run_knows(name: str) -> None:
    assert find_field(name).counts


@pytest.mark.parametrize("name", ["timing.stage_ms..max", "timing.stage_ms.ego", "lockstep.missed_by_topic."])
def test_a_key_that_only_a_run_knows_is_not_empty(name: str) -> None:
    with pytest.raises(ValueError, match="no field"):
        find_field(name)


@pytest.mark.parametrize(("name", "counts"), [("takeovers", True), ("ledger", True), ("valid", False), ("why", False)])
def test_what_bounds_can_be_set_to(name: str, counts: bool) -> None:
    assert find_field(name).counts is counts
