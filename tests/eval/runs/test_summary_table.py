"""The table of a campaign stays readable at the width of a terminal, however many variants there are."""

import io
import re
from typing import Any

import pytest
from rich.cells import cell_len
from rich.console import Console

from litsim_eval.analysis.measure import Table
from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_eval.analysis.summary import rows_of
from litsim_eval.runs.summary_table import print_summary

WIDTH = 100


def variant(**values: Any) -> dict[str, Any]:
    """Measures of a variant, as wide as they get."""
    ade = dict.fromkeys(map(str, HORIZONS_S), 0.000868)
    usual: dict[str, Any] = dict.fromkeys((row.name for row in rows_of(Table.EGO, Table.SIMULATION)), 0.000868) | {
        "runs": 20,
        "agents": 1920,
        "failed": 0,
    }
    usual |= {"ade_controlled_m": ade, "ade_all_m": ade, "ade_runs": dict.fromkeys(ade, 20)}
    return usual | {"reactive": 1.0, "measured": 20} | values


def variants(count: int) -> dict[str, dict[str, Any]]:
    """Variants with the names that six of them have in `docs/results.md`."""
    egos, policies = ("perturbed", "external"), ("replay", "yield, kinematic", "litsim, default, handback=time_shift")
    names = [f"{ego}, {policy}" for ego in egos for policy in policies]
    return {names[i % 6] + (f", horizon={i}" if i > 5 else ""): variant(runs=10 + i) for i in range(count)}


def printed(summary: dict[str, dict[str, Any]], width: int = WIDTH, **options: Any) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    print_summary("the suite", summary, console, **options)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert max(map(cell_len, lines)) <= width
    return [line.rstrip() for line in lines]


def cells(lines: list[str], name: str) -> list[str]:
    """Values of a measure, from all tables of a print, left to right; the name stands whole in one line."""
    heading = re.compile(rf" *{re.escape(name)}(?: \[\S+\])?(?: [↑↓])? +(?=[\d-])")
    return [word for line in lines if (found := heading.match(line)) for word in line[found.end() :].split()]


def test_few_variants_are_named_above_their_columns() -> None:
    lines = printed({"idm, replay": variant(), "idm, litsim": variant(takeovers=55)})
    assert any("idm, replay" in line and "idm, litsim" in line for line in lines)
    assert cells(lines, "takeovers")[1] == "55"


@pytest.mark.parametrize("count", [1, 9])
def test_where_nobody_can_be_taken_over_nothing_is_said_of_it(count: int) -> None:
    whole, short = printed(variants(count)), printed(variants(count), replayed=True)
    for name in (
        "takeovers",
        "guarded steps of policy C",
        "largest jump",
        f"ADE@{HORIZONS_S[0]} s, controlled",
    ):
        assert cells(whole, name) and not cells(short, name)
    for name in ("runs", "contacts of the ego", "progress of all agents", f"ADE@{HORIZONS_S[0]} s, all"):
        assert cells(short, name) == cells(whole, name) != []


def test_six_variants_are_one_table_with_their_names_below() -> None:
    summary = variants(6)
    lines = printed(summary)
    assert cells(lines, "runs") == ["10", "11", "12", "13", "14", "15"]
    assert sum(bool(re.match(r" *runs +\d", line)) for line in lines) == 1, "one table, each measure in one line"
    legend = [line.strip() for line in lines[-6:]]
    assert legend == [f"{number}  {name}" for number, name in enumerate(summary, 1)]
    heading = next(line.split() for line in lines if line.split()[:1] == ["1"])
    assert heading == ["1", "2", "3", "4", "5", "6"]


@pytest.mark.parametrize("count", [7, 12, 31])
def test_more_variants_are_spread_over_tables(count: int) -> None:
    lines = printed(variants(count))
    assert cells(lines, "runs") == [str(10 + i) for i in range(count)]
    per_table = [len(line.split()) - 1 for line in lines if re.match(r" *runs +\d", line)]
    assert max(per_table) - min(per_table) <= 1 and len(per_table) > 1


def test_figures_of_fewer_runs_than_there_are_are_marked_and_explained() -> None:
    lines = printed({"a": variant(), "b": variant(runs=20, measured=19, failed=1, errors=1)})
    assert cells(lines, "agents") == ["1920", "1920*"] and cells(lines, "runs") == ["20", "20"]
    assert cells(lines, "no new contacts") == ["100.00", "100.00"], "of all runs, those that failed among them"
    assert lines[-1] == "* over the runs that were measured: b: 19 of 20"


def test_displacements_say_where_not_all_runs_went_on_for_so_long() -> None:
    whole = variant()
    reached = {"ade_runs": whole["ade_runs"] | {"25": 3}, "ade_controlled_m": whole["ade_controlled_m"] | {"25": None}}
    lines = printed({"a": whole, "b": variant(**reached)})
    assert cells(lines, "ADE@20 s, all") == ["0.000868", "0.000868"]
    assert cells(lines, "ADE@25 s, all") == ["0.000868", "0.000868", "(3", "of", "20)"]
    assert cells(lines, "ADE@25 s, controlled") == ["0.000868", "-"]


def test_horizons_that_no_run_reaches_are_left_out() -> None:
    ade = dict.fromkeys(map(str, HORIZONS_S)) | {"5": 1.25}
    lines = printed({"a": variant(ade_controlled_m=ade, ade_all_m=ade | {"5": None}), "b": variant(ade_all_m=ade)})
    assert cells(lines, "ADE@5 s, controlled") == ["1.25", "0.000868"]
    assert cells(lines, "ADE@5 s, all") == ["-", "1.25"] and not cells(lines, "ADE@10 s, all")


def test_bounds_stand_behind_the_figures_that_have_them() -> None:
    bounds = {"a": {"takeovers": (36.025, 95.0), "reactive": (0.9, 1.0), "ade_all_m.10": (0.1, 0.25)}}
    lines = printed({"a": variant(takeovers=61), "b": variant(takeovers=55)}, bounds=bounds)
    assert cells(lines, "takeovers")[:4] == ["61", "[36,", "95]", "55"]
    assert cells(lines, "no new contacts") == ["100.00", "[90.00,", "100.00]", "100.00"]
    assert cells(lines, "ADE@10 s, all") == ["0.000868", "[0.1,", "0.25]", "0.000868"]
    assert cells(lines, "ADE@5 s, all") == ["0.000868", "0.000868"]
