"""The list of the hard suite: cases of all kinds, with changes that a scenario takes."""

from collections import Counter
from pathlib import Path

import yaml

from litsim_sim.scenario.changes import changes_of

CASES = Path(__file__).parents[2] / "examples/suites/hard_cases.yaml"
VEHICLES = {"brake", "cut_in", "cut_out", "merge", "queue", "turn"}
OTHERS = {"walker", "cyclist", "red light", "amber light", "stale lights", "recorded, us101", "recorded, streets"}


def test_cases_of_the_hard_suite() -> None:
    cases = yaml.safe_load(CASES.read_text())
    assert len({case["name"] for case in cases}) == len(cases) >= 80
    assert set(Counter(case["kind"] for case in cases)) == VEHICLES | OTHERS
    assert sum(case["replay_collides"] for case in cases) >= 0.3 * len(cases)
    for case in cases:
        changes = changes_of(case.get("changes", []))
        assert changes or case["kind"].startswith(("red", "recorded"))
        assert ("walker" in case) == (case["kind"] in ("walker", "cyclist"))
        if case["kind"] in ("brake", "cut_in", "cut_out", "queue", "walker", "cyclist"):  # where the ego is in the run
            assert all(change.model_dump().get("headway_s") for change in changes)
