"""Measures of runs side by side."""

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from command_line import refusal, status
from litsim_eval.analysis.compare import compare, load, names_of
from litsim_eval.cli import compare as command
from litsim_sim.core.errors import InputError

A = {
    "run_id": "r",
    "digest": "0" * 64,
    "reactive": True,
    "collision": {"pairs": 2, "contacts": [{"step": 3}]},
    "progress_m": 10.0,
    "handback": {"residual_m": None},
    "timing": {"wall_s": 1.0},
}


def changed(**values: object) -> dict:
    return json.loads(json.dumps(A)) | values


def rows(*trees: dict) -> dict:
    return {row.name: row for row in compare({str(i): tree for i, tree in enumerate(trees)}).rows}


def test_equal_runs_differ_in_nothing_but_wall_times() -> None:
    same = compare({"a": A, "b": changed(run_id="r@1", timing={"wall_s": 2.0})})
    assert same.equal
    assert [row.name for row in same.rows if row.differs] == ["run_id", "timing.wall_s"]


def test_what_differs_is_marked_and_by_how_much() -> None:
    found = rows(A, changed(progress_m=12.5, reactive=False, collision={"pairs": 1, "contacts": [{"step": 3}]}))
    assert [name for name, row in found.items() if row.differs] == ["reactive", "collision.pairs", "progress_m"]
    assert found["progress_m"].change == 2.5
    assert found["collision.pairs"].change == -1
    assert found["reactive"].change is None


def test_a_branch_that_is_null_in_a_run_has_no_row_of_its_own() -> None:
    for trees in ((A, changed(handback=None)), (changed(handback=None), A)):
        assert "handback" not in rows(*trees) and "handback.residual_m" in rows(*trees)


def test_lists_are_counted_but_compared_by_content() -> None:
    row = rows(A, changed(collision={"pairs": 2, "contacts": [{"step": 4}]}))["collision.contacts"]
    assert row.values == (1, 1) and row.differs


def test_the_third_counts_as_well() -> None:
    assert rows(A, A, changed(digest="1" * 64))["digest"].differs


def test_sums_in_another_order_are_the_same() -> None:
    assert not rows(A, changed(progress_m=10.000000000000002))["progress_m"].differs
    assert rows(A, changed(progress_m=10.0000001))["progress_m"].differs


def test_a_measure_that_one_run_lacks_differs() -> None:
    found = rows(A, changed(handback={"residual_m": 0.0, "count": 1}))
    assert found["handback.residual_m"].differs and found["handback.count"].values == (None, 1)
    assert not rows(A, A)["handback.residual_m"].differs


def test_names_are_as_short_as_they_can_be() -> None:
    assert names_of([Path("x/a"), Path("x/b_0.mcap")]) == ["a", "b_0"]
    assert names_of([Path("x/a/metrics.json"), Path("x/b/metrics.json")]) == ["a/metrics", "b/metrics"]
    assert len(set(names_of([Path("a"), Path("a")]))) == 2


def test_command_prints_table_and_json(tmp_path: Path, capsys) -> None:
    paths = [tmp_path / "one.json", tmp_path / "two.json"]
    for path, tree in zip(paths, (A, changed(progress_m=12.5)), strict=True):
        path.write_text(json.dumps(tree))
    command.main([*map(str, paths), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert found["runs"] == ["one", "two"] and not found["equal"]
    assert {"name": "progress_m", "values": [10.0, 12.5], "differs": True} in found["rows"]
    command.main([*map(str, paths), "--differences"])
    printed = capsys.readouterr().out
    assert "* progress_m" in printed and "+2.5" in printed and "1 measures differ" in printed
    assert "digest" not in printed


def test_differences_are_in_colour_on_a_terminal() -> None:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, color_system="standard", width=100)
    command.print_comparison(compare({"a": A, "b": changed(progress_m=12.5)}), console, only_differences=False)
    (line,) = (line for line in stream.getvalue().splitlines() if "progress_m" in line)
    assert "\x1b[1;33m" in line


@pytest.mark.parametrize("text", ["", "[]", "{}"])
def test_what_is_no_run_is_refused(tmp_path: Path, text: str, capsys) -> None:
    path = tmp_path / "no.json"
    path.write_text(text)
    with pytest.raises(InputError, match="measures"):
        load(path)
    assert "error:" in refusal(capsys, command.main, path, tmp_path / "none")
    with pytest.raises(InputError, match="no such bag"):
        load(tmp_path / "none")


def test_one_run_is_too_few(tmp_path: Path) -> None:
    assert status(command.main, tmp_path) == 2
