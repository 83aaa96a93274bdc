"""Rows of the tables, the short tables made from them, and the agreement of docs/results.md with its CSV files."""

from pathlib import Path
from typing import Any

import pytest

from litsim_research.cli.paper import CLAIMS, GOALS, SHOWN, short_table
from litsim_research.paper.claims import claim_rows, claims_table
from litsim_research.paper.experiments import EXPERIMENTS
from litsim_research.paper.page import END, begin
from litsim_research.paper.published import TABLE
from litsim_research.paper.tables import (
    ClaimRow,
    GoalRow,
    Row,
    goals,
    goals_table,
    published_rows,
    read_csv,
    rows,
    summary,
    write_csv,
)

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
            "reactive": True,
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


def test_the_short_table_has_sets_side_by_side_and_sums_of_counts(methods: dict[str, Any]) -> None:
    methods["idm"][key(3)] = None
    records = [*rows(methods, "bat", "real"), *rows(methods, "bat", "urban"), *published_rows("bat", TABLE)]
    lines = summary(records)
    assert lines[0] == "Where a cell has several values: real window, street."
    of_idm = cells(lines, "`idm`")
    assert of_idm[2] == "20, 2 failed"
    assert of_idm[4] == "1.00\\*, 1.00\\*" and of_idm[3] == "-, -"
    assert of_idm[-3:] == ["18", "54", "72"], "those that failed count nothing"
    assert cells(lines, "IDM: paper, other data")[3:6] == ["2.56", "8.68", "46.2"]
    assert cells(summary(records, counts_alone=True), "`idm`") == ["`bat`", "`idm`", "20, 2 failed", "18", "54", "72"]


@pytest.mark.parametrize(("egos", "shown"), [(("bat", "perturbed"), "`bat`"), (("perturbed",), "`perturbed`")])
def test_a_short_table_may_leave_egos_out_unless_there_are_no_others(
    methods: dict[str, Any], egos: tuple[str, ...], shown: str
) -> None:
    lines = short_table(EXPERIMENTS["table"], [row for ego in egos for row in rows(methods, ego, "real")])
    assert {line.split("|")[1].strip() for line in lines[2:]} == {shown}


def test_files_give_back_what_was_written(methods: dict[str, Any], tmp_path: Path) -> None:
    records = rows(methods, "bat", "real")
    write_csv(tmp_path / "new/table.csv", records)
    assert read_csv(tmp_path / "new/table.csv", Row) == records


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
    records = goals(methods, "bat")
    by_goal = {row.goal: row[2:] for row in records}
    assert by_goal["collision rate at most half of the best"] == (f"{100 * ours:.2f}", "4.00", met)
    assert by_goal["reactivity at least 97 %"][2] == met
    assert by_goal["relevant ratio at most a sixth of the best"][1:] == ("12.00", met)
    assert by_goal["realism highest"][2] == "no"
    assert by_goal["ADE at 25 s lowest"][2] == "not measured"
    assert f"| realism highest | {0.5 + ours:.3f}, 0.680: no |" in goals_table(records)


def test_a_claim_is_counted_in_the_tables_that_can_tell() -> None:
    """On the street LitSim collides as often as GAIL; there is no ADE beyond 15 s in the real window."""
    table = [
        Row(ego, set_, method, measure, "", value)
        for ego, set_, values in (("bat", "real", (0.1, 0.2, 0.3)), ("idm", "urban", (0.2, 0.2, 0.3)))
        for method, value in zip(("litsim", "gail", "idm"), map(str, values), strict=True)
        for measure in ("collision", *(("ade_25",) if set_ == "urban" else ("ade_15",)))
    ]
    table += [Row("idm", "urban", "simnet", measure, "", "0.1") for measure in ("collision", "ade_25")]
    table += [Row("bat", "paper", "IDM", "collision", "", "0.0")]
    ablation = [
        Row("bat", "real", name, "ade_15", "m", value)
        for name, value in zip(("litsim", "paper", "M0", "M1"), "1121", strict=True)
    ]
    told = {row.claim: (row.litsim, row.paper) for row in claim_rows(table, ablation)}
    assert told["LitSim has the lowest collision rate"] == ("1 of 2", "-")
    assert told["beyond 15 s, LitSim is nearest to the log"] == ("0 of 1", "-")
    assert told["of the baselines, SimNet collides least"] == ("1 of 1", "-")
    assert told["GAIL makes most progress"] == ("-", "-")
    assert told["joint forecasts bring agents nearer to the log (M1, M0)"] == ("-", "1 of 1")
    assert told["policy C avoids collisions (M2, M1)"] == ("-", "-")


@pytest.mark.parametrize("name", SHOWN)
def test_the_page_of_the_documentation_agrees_with_its_files(name: str) -> None:
    file = PAGE.with_suffix("") / f"{name}.csv"
    if name == CLAIMS:
        lines = claims_table(read_csv(file, ClaimRow))
    elif name == GOALS:
        lines = goals_table(read_csv(file, GoalRow))
    else:
        lines = short_table(EXPERIMENTS[name], read_csv(file, Row))
    mark = begin(f"paper {name}").removesuffix(" -->")
    (shown,) = (part.split(END)[0] for part in PAGE.read_text().split(mark)[1:])
    assert shown.partition(" -->\n")[2] == "".join(f"{line}\n" for line in lines)
