"""Tables in Markdown: what is bold, what is marked, what the paper's own rows say, and who wins."""

from __future__ import annotations

from typing import Any

import pytest

from litsim_research.paper.published import TABLE
from litsim_research.paper.tables import Measure, counts, differences, goals, table, won

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
    methods["idm"][key(9)] = None
    assert cells(differences(methods, [COLLISION]), "idm")[1].startswith("-1.40 ["), "of the cases that both have"


def test_counts_of_contacts_by_fault(methods: dict[str, Any]) -> None:
    assert cells(counts(methods), "idm")[1:] == ["10", "0", "20", "30", "40"]


def test_what_another_wins_is_said(methods: dict[str, Any]) -> None:
    assert won(methods, [COLLISION, PROGRESS]) == ["- collision %, 2.45 with `litsim`: `idm` 1.00\\*."]
    assert won({"idm": method(0.05, 1.0), "litsim": method(0.02, 1.0)}, [COLLISION]) == []


@pytest.mark.parametrize(("ours", "reactive", "met"), [(0.02, 1.0, "yes"), (0.021, 0.96, "no")])
def test_goals_are_held_against_the_better_of_the_baselines(ours: float, reactive: float, met: str) -> None:
    def judged(rate: float, *, free: bool, relevant: float) -> dict[Any, Any]:
        displacement = {"agent_steps": {"5": 100}, "agents": []}
        return {
            key(k): {
                "collision": {"rate_all": rate},
                "collision_free": free if k else True,
                "relevant_ratio_roi": relevant,
                "realism_near": 0.5 + relevant,
                "displacement": displacement,
            }
            for k in range(20)
        }

    methods = {
        "idm": judged(0.05, free=False, relevant=0.12),
        "simnet": judged(0.04, free=False, relevant=0.18),
        "litsim": judged(ours, free=reactive == 1.0, relevant=ours),
    }
    lines = {line.strip("| ").split(" | ")[0]: line.strip("| ").split(" | ") for line in goals(methods)[2:]}
    assert lines["collision rate at most half of the best"][1:] == [f"{100 * ours:.2f}", "4.00", met]
    assert lines["reactivity at least 97 %"][3] == met
    assert lines["relevant ratio at most a sixth of the best"][2:] == ["12.00", met]
    assert lines["realism highest"][3] == "no"
    assert lines["ADE at 25 s lowest"][3] == "not measured"
