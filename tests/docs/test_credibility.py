"""The table of docs/credibility.md is of the packaged results, which pages of campaigns quote."""

import json
import re
from typing import Any

import pytest

from documentation import ROOT
from litsim_sim.scenario.scenario import packaged

TABLE = (ROOT / "docs/credibility.md").read_text(encoding="utf-8").split("<!-- begin: figures")[1].split("<!-- end")[0]
ROWS = re.findall(r"^\| `(\w+)`(, 8 drivers drawn|, no rules)? \|(.+)\|$", TABLE, re.MULTILINE)
MEASURES = {"position_error_m": (1, 2), "onset_s": (3, 1), "strongest_braking_mps2": (4, 2), "least_gap_m": (5, 1)}
"""Column behind the name, and digits."""


def measures(file: str) -> dict[str, Any]:
    """Returns the packaged measures by policy."""
    policies = json.loads(packaged(f"credibility/{file}.json", "litsim_eval").read_text(encoding="utf-8"))["policies"]
    return dict(policies)


def test_every_packaged_policy_is_in_the_table() -> None:
    assert {name for name, variant, _ in ROWS if "drawn" not in variant} == set(measures("credibility"))


@pytest.mark.parametrize(("policy", "variant", "cells"), ROWS, ids=[name + variant for name, variant, _ in ROWS])
def test_packaged_results_are_those_of_the_table(policy: str, variant: str, cells: str) -> None:
    own = measures("credibility_drawn" if "drawn" in variant else "credibility")[policy]
    shown = [cell.split()[0] for cell in cells.split("|")]
    assert {name: shown[column] for name, (column, _) in MEASURES.items()} == {
        name: f"{own[name]:.{digits}f}" for name, (_, digits) in MEASURES.items()
    }
