"""Rows of the tables, the short tables made from them, and the agreement of docs/results.md with its CSV files."""

from pathlib import Path
from typing import Any

import pytest

from litsim_research.cli.paper import CLAIMS, GOALS, SHOWN
from litsim_research.paper.claims import claim_rows, claims_table
from litsim_research.paper.experiments import EXPERIMENTS
from litsim_research.paper.goals import GoalRow, goals, goals_table
from litsim_research.paper.page import END, begin
from litsim_research.paper.published import TABLE
from litsim_research.paper.tables import (
    ALL_SETS,
    CONFLICTING_EGOS,
    ClaimRow,
    Row,
    published_rows,
    read_csv,
    rows,
    summary,
    write_csv,
)

NOT_MADE = "Not made yet: run the command above."
PAGE = Path(__file__).parents[3] / "docs/results.md"


def key(k: int) -> Any:
    return "road", k, "bat", k % 2


def method(rate: float, progress: float, slope: float = 0.0) -> dict[Any, Any]:
    """Ten runs; the rate grows by `slope` from one to the next."""
    by_fault = {"background": 1, "ego_avoidable": 0, "ego_unavoidable": 2}
    return {
        key(k): {
            "collision": {
                "rate_all": rate + slope * k,
                "excess_rate_all": 0.0,
                "rate_controlled": None,
                "excess_rate_controlled": None,
                "by_fault": by_fault,
            },
            "collision_free": True,
            "reactive": k != 2,
            "progress_m": progress,
            "relevant_ratio_roi": 0.1,
            "relevant_ratio": 0.1,
            "realism_near": 0.5,
            "off_road_controlled": None,
            "displacement": {"agent_steps": {}, "agents": []},
            "takeovers": 3,
            "comfort": {"controlled": {"hard_brakes": 4}},
        }
        for k in range(10)
    }


@pytest.fixture
def methods() -> dict[str, Any]:
    return {"replay": method(0.0, 90.0), "idm": method(0.01, 95.0), "litsim": method(0.02, 80.0, 0.001)}


def one(records: list[Row], name: str, measure: str) -> Row:
    (row,) = (row for row in records if (row.method, row.measure) == (name, measure))
    return row


def cells(lines: list[str], name: str) -> list[str]:
    (line,) = (line for line in lines if f"| {name} |" in line)
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_rows_have_values_spreads_and_differences_from_litsim(methods: dict[str, Any]) -> None:
    records = rows(methods, "bat", "real")
    assert one(records, "idm", "collision")[:7] == ("bat", "real", "idm", "collision", "%", "1.00", "0.00")
    assert one(records, "litsim", "collision")[5:] == ("2.45", "0.07", "", "", "", "", "10", "0")
    compared = one(records, "idm", "collision")
    assert compared.difference == "-1.45" and compared.clear == "yes"
    assert float(compared.lower) < -1.45 < float(compared.upper) < 0.0
    assert one(records, "replay", "collision").difference == "", "replay is no rival"
    assert one(records, "idm", "realism").clear == ""
    assert not [row for row in records if row.measure == "off_road"], "nothing measured, no row"
    assert one(records, "idm", "fault_ego").value == "20"


def test_differences_are_of_the_cases_that_both_have(methods: dict[str, Any]) -> None:
    methods["idm"][key(9)] = None
    row = one(rows(methods, "bat", "real"), "idm", "collision")
    assert (row.difference, row.runs, row.failed) == ("-1.40", "10", "1")


def test_the_short_table_is_of_all_conflicting_egos_and_sets_together(methods: dict[str, Any]) -> None:
    methods["idm"][key(3)] = None
    records = [
        *rows(methods, "brake", "real"),
        *rows(methods, CONFLICTING_EGOS, "real"),
        *rows(methods, CONFLICTING_EGOS, None),
        *published_rows(CONFLICTING_EGOS, TABLE),
    ]
    lines = summary(records)
    assert cells(lines, "`idm`") == ["`idm`", "10, 1 failed", "-", "1.00\\*", "90.0", "10.00", "1", "9", "27", "36"]
    assert cells(lines, "IDM: paper, other data")[2:5] == ["2.56", "8.68", "46.2"]
    assert cells(summary(records, counts_alone=True), "`idm`") == ["`idm`", "10, 1 failed", "1", "9", "27", "36"]
    assert len(lines) == 2 + len(methods) + len(TABLE)


def test_files_give_back_what_was_written(methods: dict[str, Any], tmp_path: Path) -> None:
    records = rows(methods, "bat", "real")
    write_csv(tmp_path / "new/table.csv", records)
    assert read_csv(tmp_path / "new/table.csv", Row) == records


@pytest.mark.parametrize(
    ("ours", "replayed", "reactive", "met"),
    [(0.02, 0.1, 1.0, "yes"), (0.021, 0.1, 0.96, "no"), (0.02, 0.01, 0.97, "no")],
    ids=["met", "not met against the baselines", "not met against replay"],
)
def test_goals_are_held_against_replay_and_the_better_of_the_baselines(
    ours: float, replayed: float, reactive: float, met: str
) -> None:
    def judged(rate: float, free: float, relevant: float, ade: float = 0.0) -> dict[Any, Any]:
        agent = {"agent": 1, "ade_m": {"5": ade, "10": None}, "steps": {"5": 50, "10": 0}, "controlled_s": 1.0}
        displacement = {"agent_steps": {"5": 100, **dict.fromkeys(("10", "15", "20", "25"))}, "agents": [agent]}
        return {
            key(k): {
                "collision": {"excess_rate_all": rate},
                "reactive": k < free * 100,
                "relevant_ratio_roi": relevant,
                "realism_near": 0.5 + relevant,
                "displacement": displacement,
            }
            for k in range(100)
        }

    methods = {
        "replay": judged(replayed, 0.3 if replayed > ours else 0.99, 0.0),
        "idm": judged(0.05, 0.5, 0.12, 2.0),
        "simnet, conflict": judged(0.04, 0.9, 0.18, 1.0),
        "litsim": judged(ours, reactive, 0.019, 1.5),
        "paper": judged(0.03, 0.9, 0.02, 1.5),
    }
    records = goals(methods, CONFLICTING_EGOS, "urban")
    by_goal = {row.goal: row[3:] for row in records}
    shown = f"{100 * ours:.2f}"
    assert by_goal["collision rate at most half of the best, %"] == (
        *(f"{100 * replayed:.2f}", "4.00", "simnet, conflict", shown, "3.00", met),
    )
    assert by_goal["reactivity at least 97 %, highest"][1:4] == ("90.0", "simnet, conflict", f"{100 * reactive:.1f}")
    assert by_goal["reactivity at least 97 %, highest"][-1] == met
    assert by_goal["relevant ratio at most a sixth of the best, %"] == ("0.00", "12.00", "idm", "1.90", "2.00", "yes")
    assert by_goal["realism highest"][-1] == "no"
    assert by_goal["ADE at 5 s lowest, m"] == ("0.00", "1.00", "simnet, conflict", "1.50", "1.50", "no")
    assert "| generated street | realism highest | 0.500 | 0.680 | `simnet, conflict` | 0.519 | 0.520 | no |" in (
        goals_table(records)
    )
    assert goals({"replay": methods["replay"], "litsim": methods["litsim"]}, "bat", None) == []


def test_a_claim_is_counted_in_the_tables_that_can_tell() -> None:
    """On the street LitSim collides as often as GAIL; there is no ADE beyond 15 s in the real window."""
    table = [
        Row(ego, set_, method, measure, "", value)
        for ego, set_, values in (("bat", "real", (0.1, 0.2, 0.3)), ("idm", "urban", (0.2, 0.2, 0.3)))
        for method, value in zip(("litsim", "gail", "idm"), map(str, values), strict=True)
        for measure in ("collision_beyond", *(("ade_25",) if set_ == "urban" else ("ade_15",)))
    ]
    table += [Row("idm", "urban", "simnet", measure, "", "0.1") for measure in ("collision_beyond", "ade_25")]
    table += [Row("bat", "paper", "IDM", "collision_beyond", "", "0.0")]
    ablation = [
        Row("bat", "real", name, "ade_15", "m", value)
        for name, value in zip(("litsim", "paper", "M0", "M1"), "1121", strict=True)
    ]
    table += [Row(CONFLICTING_EGOS, "real", "idm", "collision_beyond", "", "0.0")]
    table += [Row("bat", ALL_SETS, "idm", "collision_beyond", "", "0.0")]
    told = {row.claim: (row.litsim, row.paper) for row in claim_rows(table, ablation)}
    assert told["LitSim has the lowest collision rate"] == ("1 of 2", "-")
    assert told["beyond 15 s, LitSim is nearest to the log"] == ("0 of 1", "-")
    assert told["of IDM, GAIL and SimNet, SimNet collides least"] == ("1 of 1", "-")
    assert told["GAIL makes most progress"] == ("-", "-")
    assert told["joint forecasts bring agents nearer to the log (M1, M0)"] == ("-", "1 of 1")
    assert told["policy C avoids collisions (M2, M1)"] == ("-", "-")


@pytest.mark.parametrize("name", SHOWN)
def test_the_page_of_the_documentation_agrees_with_its_files(name: str) -> None:
    """A part that has not been made yet says so, and has no file."""
    file = PAGE.with_suffix("") / f"{name}.csv"
    if not file.is_file():
        lines = [NOT_MADE]
    elif name == CLAIMS:
        lines = claims_table(read_csv(file, ClaimRow))
    elif name == GOALS:
        lines = goals_table(read_csv(file, GoalRow))
    else:
        lines = summary(read_csv(file, Row), counts_alone=EXPERIMENTS[name].counts_alone)
    mark = begin(f"paper {name}").removesuffix(" -->")
    (shown,) = (part.split(END)[0] for part in PAGE.read_text().split(mark)[1:])
    assert shown.partition(" -->\n")[2] == "".join(f"{line}\n" for line in lines)
