"""`paper --quick`: every experiment from runs to tables, figures and page; what is there already is not run again."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from command_line import refusal
from litsim_eval.campaign.results import read_campaign
from litsim_research.cli.paper import CAPTIONS, FIGURES, SHOWN, main
from litsim_research.paper import case_studies, figures, roads, running
from litsim_research.paper.case_studies import AFTER_S, BEFORE_S
from litsim_research.paper.experiments import TABLE
from litsim_research.paper.goals import GoalRow, goals_table
from litsim_research.paper.page import END, begin
from litsim_research.paper.tables import Row, read_csv, summary
from litsim_sim.scenario.policies import setup_of

PARTS = (*SHOWN, FIGURES)
EMPTY = "Not made yet."


@pytest.fixture(scope="module", autouse=True)
def _short_runs() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roads, "QUICK_S", 2.0)
        yield


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The table on the motorway, its figures, and a page of both that had nothing made on it."""
    folder = tmp_path_factory.mktemp("paper")
    lines = [line for part in PARTS for line in (begin(f"paper {part}"), EMPTY, END)]
    (folder / "results.md").write_text("\n".join([*lines, ""]))
    main(["table", *options(folder)])
    return folder


def options(folder: Path) -> list[str]:
    return ["--quick", "--sets", "highway", "--out", str(folder / "out"), "--page", str(folder / "results.md")]


def methods_in(file: Path) -> dict[str, set[str]]:
    """Numbers of runs by method in a CSV file, apart from the paper's own figures."""
    runs: dict[str, set[str]] = {}
    for row in read_csv(file, Row):
        if row.runs:
            runs.setdefault(row.method, set()).add(row.runs)
    return runs


def test_the_table_has_every_method_and_the_papers_figures(out: Path) -> None:
    text = (out / "results.md").read_text()
    assert text.count(EMPTY) == len(PARTS) - 2, "the table and the goals are there"
    records = read_csv(out / "results/table.csv", Row)
    assert (out / "results/table.csv").read_bytes() == (out / "out/table.csv").read_bytes()
    assert methods_in(out / "results/table.csv") == {setup_of(row).name: {"2"} for row in TABLE.policies}
    assert "| SimNet: paper, other data |" in text
    assert "\n".join(summary(records)) in text, "the page says what the file says"
    assert "\n".join(goals_table(read_csv(out / "results/goals.csv", GoalRow))) in text
    assert "\ntable," in (out / "results/times.csv").read_text()
    campaign = read_campaign(out / "out/table")
    assert not campaign.missing and all(result.metrics is not None for result in campaign.results)


def test_figures_are_of_what_has_been_run(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing_left(_: object, cases: list[object]) -> list[object]:
        assert not cases, "the table has run them"
        yield from ()

    monkeypatch.setattr(running.LocalRuns, "run", nothing_left)
    main(["figures", *options(out)])
    name = "contacts_by_fault"
    assert name in CAPTIONS
    assert (out / f"out/figures/{name}.svg").read_text().startswith("<?xml")
    assert (out / f"out/figures/{name}.png").read_bytes().startswith(b"\x89PNG")
    assert f"](out/figures/{name}.png)" in (out / "results.md").read_text()
    before = (out / f"out/figures/{name}.svg").read_bytes()
    main(["figures", "--as-it-is", *options(out)])
    assert (out / f"out/figures/{name}.svg").read_bytes() == before


def test_the_same_command_gives_the_same_tables(out: Path, tmp_path: Path) -> None:
    main(["table", "--quick", "--sets", "highway", "--out", str(tmp_path / "again")])
    for file in ("table.csv", "goals.csv"):
        assert (tmp_path / "again" / file).read_bytes() == (out / "out" / file).read_bytes()


def test_the_ablation_has_its_rows_with_any_ego(out: Path) -> None:
    main(["ablation", *options(out), "--ego", "idm"])
    rows = ("replay", "M0", "M1", "M2", "paper", "litsim")
    assert methods_in(out / "results/ablation.csv") == {name: {"2"} for name in rows}


@pytest.fixture
def _one_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    turns = case_studies.left_turns
    monkeypatch.setattr(case_studies, "left_turns", lambda files: turns(files)[-1:])


@pytest.mark.usefixtures("_one_turn")
def test_the_case_study_of_the_street(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quick trial has such a case; its picture is drawn, and shown on the page."""
    save, saved = figures.save, []
    monkeypatch.setattr(figures, "save", lambda canvas, *where: saved.append(canvas) or save(canvas, *where))
    main(["cases", *options(out)])
    assert (out / "out/figures/case_left_turn.png").is_file()
    assert "](out/figures/case_left_turn.png)" in (out / "results.md").read_text()
    assert [len(canvas.axes) for canvas in saved] == [2 * len([*BEFORE_S, AFTER_S])]


@pytest.mark.usefixtures("_one_turn")
def test_without_a_case_the_picture_of_other_runs_goes(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = out / "out/figures/case_left_turn.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.touch()
    monkeypatch.setattr(case_studies, "chosen", lambda *_: None)
    main(["cases", *options(out)])
    assert not picture.exists()


def test_without_recorded_data_the_real_window_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("LITSIM_DATA", raising=False)
    assert "LITSIM_DATA is not set" in refusal(capsys, main, "table", "--quick", "--sets", "real", "--out", tmp_path)


def test_a_page_that_is_not_there_is_said_before_anything_is_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("table", "--quick", "--sets", "highway", "--out", tmp_path / "out", "--page", tmp_path / "no.md")
    assert "no.md" in refusal(capsys, main, *words) and not (tmp_path / "out").exists()
