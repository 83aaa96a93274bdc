"""Tables in Markdown: what is bold, what is marked, what the paper's own rows say, and who wins."""

from __future__ import annotations

from typing import Any

import pytest

from litsim_policy.paper.published import TABLE
from litsim_policy.paper.tables import Measure, counts, differences, table, won

COLLISION = Measure("collision", "collision %", min, 100.0)
PROGRESS = Measure("progress", "progress, m", None, digits=1)


def key(k: int) -> Any:
    return "road", k, "bat", k % 2


def method(rate: float, progress: float, slope: float = 0.0) -> dict[Any, Any]:
    """Ten runs; the rate grows by `slope` from one to the next."""
    by_fault = {"background": 1, "ego_avoidable": 0, "ego_unavoidable": 2}
    return {
        key(k): {
            "collision": {"rate_all": rate + slope * k, "by_fault": by_fault},
            "progress_m": progress,
            "takeovers": 3,
            "comfort": {"controlled": {"hard_brakes": 4}},
        }
        for k in range(10)
    }


@pytest.fixture
def methods() -> dict[str, Any]:
    return {"replay": method(0.0, 90.0), "idm": method(0.01, 95.0), "litsim": method(0.02, 80.0, 0.001)}


def cells(lines: list[str], name: str) -> list[str]:
    (line,) = (line for line in lines if line.startswith((f"| `{name}` ", f"| *{name}:")))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_best_is_bold_and_what_clearly_differs_is_marked(methods: dict[str, Any]) -> None:
    lines = table(methods, [COLLISION, PROGRESS], TABLE)
    assert cells(lines, "replay")[2:] == ["0.00 ± 0.00", "90.0 ± 0.0"], "replay is no rival"
    assert cells(lines, "idm")[1:] == ["10", "**1.00** ± 0.00\\*", "95.0 ± 0.0\\*"]
    assert cells(lines, "litsim")[2:] == ["2.45 ± 0.07", "80.0 ± 0.0"]
    assert cells(lines, "IDM")[2:] == ["8.68", "192.2"], "the paper's, where it has the measure"


def test_runs_that_failed_are_told(methods: dict[str, Any]) -> None:
    methods["idm"][key(3)] = None
    assert cells(table(methods, [COLLISION]), "idm")[1] == "10, 1 failed"


def test_differences_have_their_bounds(methods: dict[str, Any]) -> None:
    (found,) = cells(differences(methods, [COLLISION]), "idm")[1:]
    middle, _, bounds = found.partition(" ")
    low, high = (float(bound) for bound in bounds.strip("[]").split(","))
    assert middle == "-1.45" and low < -1.45 < high < 0.0


def test_counts_of_contacts_by_fault(methods: dict[str, Any]) -> None:
    assert cells(counts(methods), "idm")[1:] == ["10", "0", "20", "30", "40"]


def test_what_another_wins_is_said(methods: dict[str, Any]) -> None:
    assert won(methods, [COLLISION, PROGRESS]) == [
        "- collision %: `idm` is clearly better, 1.00 where `litsim` has 2.45."
    ]
    assert won({"idm": method(0.05, 1.0), "litsim": method(0.02, 1.0)}, [COLLISION]) == []
