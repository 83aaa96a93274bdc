"""The list of the hard suite: cases of all kinds, with changes that a scenario takes."""

from collections import Counter
from pathlib import Path

import yaml

from litsim_sim.scenario.changes import changes_of

CASES = Path(__file__).parents[2] / "examples/suites/hard_cases.yaml"
KINDS = {"brake", "cut_in", "cut_out", "merge", "queue", "turn", "cyclist", "stale lights"}


def test_cases_of_the_hard_suite() -> None:
    cases = yaml.safe_load(CASES.read_text())
    assert len({case["name"] for case in cases}) == len(cases) >= 60
    assert set(Counter(case["kind"] for case in cases)) == KINDS
    assert sum(case["replay_collides"] for case in cases) >= 0.3 * len(cases)
    for case in cases:
        assert changes_of(case.get("changes", [])) or case["cyclist"] > 0
