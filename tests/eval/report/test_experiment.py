"""The page of a campaign without a browser: verdicts, best values, criteria, links, and what is no campaign."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from campaigns import cases, page_of, suite
from command_line import refusal
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.results import RunResult
from litsim_eval.cli import report
from litsim_eval.report import experiment
from litsim_eval.report.thumbnails import read_thumbnail
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import Run
from packed import of_page

Write = Callable[..., Path]


def cells(html: str, name: str) -> list[str]:
    """Text of the cells of the row of a table of measures that has this name; a best value in asterisks."""
    row = re.search(
        rf'<tr><th scope="row">{re.escape(name)}(?: \[[^]]*\])?(?: [↑↓])?(?:<small>.*?</small>)?\s*</th>(.*?)</tr>',
        html,
        re.DOTALL,
    )
    assert row, name
    found = re.findall(r'<td class="number( best)?"[^>]*>(.*?)</td>', row[1], re.DOTALL)
    return [f"*{text}*" if best else " ".join(re.sub(r"<[^>]+>", " ", text).split()) for best, text in found]


def packed(page: Path) -> dict[str, Any]:
    return of_page(page.read_text())[0]


def test_verdicts_are_of_all_runs_and_those_not_judged_have_not_passed(campaign: Write, tmp_path: Path) -> None:
    out = page_of(campaign(tmp_path))
    html = out.read_text()
    assert out == tmp_path / "experiment.html"
    assert cells(html, "runs") == ["6", "6"]
    # replay: scenes 0 and 3 at fault, 0 and 1 too near; litsim: 0 and 1 too near, 4 an error
    assert cells(html, "passed") == ["3", "3"]
    assert cells(html, "errors") == ["*0*", "1"]
    parts = re.findall(r'title="(\d+ \w+)">(\d+)</button>', html)
    assert [told for told, _ in parts] == ["3 passed", "3 failed", "3 passed", "2 failed", "1 error"]
    assert all(told.split()[0] == count for told, count in parts)
    assert '<span class="badge bad">not passed</span>' in html and "to run</span>" not in html


def test_the_better_value_is_marked_and_what_leaves_runs_out_has_an_asterisk(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path)).read_text()
    assert cells(html, "agents")[1].endswith("*") and not cells(html, "agents")[0].endswith("*")
    assert "* over the runs that left measures" in html
    assert [text.strip("*") for text in cells(html, "takeovers")] == ["0", "11"]
    assert not cells(html, "takeovers")[0].startswith("*")  # neither less nor more of them is better


def test_a_displacement_that_not_all_runs_went_on_for_says_so(campaign: Write, tmp_path: Path) -> None:
    campaign(tmp_path)
    files = [file for file in (tmp_path / "runs").glob("*/result.json") if '"replay"' in file.read_text()]
    for count, file in enumerate(sorted(files)):
        result = json.loads(file.read_text())
        reached = {"5": 1.0} if count else {"5": 1.0, "10": 2.0}
        file.write_text(json.dumps(result | {"metrics": result["metrics"] | {"ade_all_m": reached}}))
    html = page_of(tmp_path).read_text()
    assert cells(html, "ADE@5 s, all")[0] == "1.00"
    assert cells(html, "ADE@10 s, all")[0] == f"2.00 (1 of {len(files)})"


def test_driven_traffic_is_beside_its_logs_and_all_logs(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path)).read_text()
    gaps = [cells(html, f"median gap, {whose}")[0] for whose in ("driven", "of their logs", "of all logs")]
    assert len(set(gaps)) == 3 and "-" not in gaps
    fields = {field["path"]: field["label"] for field in packed(tmp_path / "experiment.html")["fields"]}
    assert fields["traffic.driven.headway_s"] == "median headway, driven [s]"


def test_who_left_no_measures_is_best_in_nothing(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path)).read_text()
    starred = re.findall(r'<td class="number( best)?">[^<]*\*</td>', html)
    assert starred and not any(starred)
    for file in (tmp_path / "runs").glob("*/result.json"):
        result = json.loads(file.read_text())
        if result["case"]["policy"] == "litsim":
            file.write_text(json.dumps(result | {"verdict": "error", "reason": "died", "metrics": None}))
    html = page_of(tmp_path).read_text()
    assert cells(html, "contacts of the ego")[1] == "–" == cells(html, "agents")[1]


def test_criteria_count_the_runs_that_miss_them(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path)).read_text()
    assert cells(html, "no contact at fault") == ["2 of 6", "0 of 5"]
    assert cells(html, "time to collision") == ["2 of 6", "2 of 5"]
    assert "Met by all runs: takeovers at most 100." in html and 'scope="row">takeovers at' not in html
    assert cells(html, "all runs pass") == ["0.5", "not met"]


def test_tags_count_the_runs_that_have_not_passed_the_worst_first(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path)).read_text()
    # replay: 0 of the even ones, 1 and 3 of the odd ones; litsim: 0 and the error 4, and 1
    assert cells(html, "odd") == ["2 of 3", "1 of 3"]
    assert cells(html, "even") == ["1 of 3", "2 of 3"]
    fewer = page_of(campaign(tmp_path / "fewer", scenes=4)).read_text()
    assert cells(fewer, "odd") == ["2 of 2", "1 of 2"] and cells(fewer, "even") == ["1 of 2", "1 of 2"]
    assert fewer.index('scope="row">odd') < fewer.index('scope="row">even')


def test_a_campaign_that_keeps_its_own_criteria_passes(campaign: Write, tmp_path: Path) -> None:
    lenient = {"runs": [{"field": "takeovers", "max": 100}], "suite": [{"field": "passed_share", "min": 0.9}]}
    html = page_of(campaign(tmp_path, criteria=lenient)).read_text()
    assert '<span class="badge good">passed</span>' in html
    assert cells(html, "passed_share at least 0.9") == ["0.9167", "met"]


def test_an_unfinished_campaign_has_a_page_that_says_so(campaign: Write, tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path, done=7)).read_text()
    assert "unfinished: 5 to run" in html and "7 of 12 runs" in html and "not passed" in html
    assert cells(html, "runs") == ["6", "1"]
    html = page_of(campaign(tmp_path / "begun", done=0)).read_text()
    assert "unfinished: 12 to run" in html


def test_a_campaign_of_errors_alone_has_a_page(tmp_path: Path) -> None:
    folder = CampaignFolder(tmp_path)
    (lost,) = cases(policies=["replay"])
    folder.begin(suite(), [lost], {})
    folder.clear(lost)
    folder.store(RunResult.error(lost, "its process was ended by SIGKILL"))
    page = page_of(tmp_path)
    assert cells(page.read_text(), "passed") == ["0"]
    (run,) = packed(page)["runs"]
    assert (run["verdict"], run["reason"]) == ("error", "its process was ended by SIGKILL")
    assert (run["steps"], run["picture"]) == (0, None)


def test_files_of_runs_are_linked_from_where_the_page_is_if_they_are_there(campaign: Write, tmp_path: Path) -> None:
    folder = campaign(tmp_path / "a campaign")
    own = next(path for path in (folder / "runs").iterdir() if path.name.endswith("000000000002"))
    (own / "run").mkdir()
    (own / "run/report.html").write_text("")
    for page, start in (
        (page_of(folder), "runs"),
        (page_of(folder, tmp_path / "pages/x.html"), "../a%20campaign/runs"),
    ):
        linked = {run["id"]: run["report"] for run in packed(page)["runs"] if run["report"]}
        assert linked == {own.name: f"{start}/{own.name}/run/report.html"}
        assert not any(run["log"] for run in packed(page)["runs"])  # named by a result, but not there


def test_pictures_come_from_the_record_and_are_kept(
    campaign: Write, small_run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = campaign(tmp_path, scenes=2)
    read: list[Path] = []

    def reader(path: Path) -> Run:
        read.append(path)
        if "litsim" in path.parent.name or len(read) == 1:
            raise InputError(f"{path}: no record")
        return small_run

    monkeypatch.setattr(experiment, "read_run", reader)
    runs = packed(page_of(folder))["runs"]
    assert [run["picture"] is not None for run in runs] == [False, True, True, True]
    assert len(read) == 4 and {path.name for path in read} == {"run"}
    page_of(folder)
    assert len(read) == 5  # only the one that has no picture is tried again
    assert read_thumbnail(read[1].parent) == runs[1]["picture"]


def test_command_line(campaign: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = campaign(tmp_path)
    report.main([str(folder)])
    assert capsys.readouterr().out.startswith(f"{folder / 'experiment.html'} (0.")
    assert "nowhere" in refusal(capsys, report.main, "nowhere")


def test_variants_without_a_result_yet_are_there(campaign: Write, tmp_path: Path) -> None:
    data = packed(page_of(campaign(tmp_path, done=2)))
    assert data["variants"] == ["idm, replay", "idm, litsim"]
    assert [run["variant"] for run in data["runs"]] == [0, 0]
