"""The page of an experiment: policies side by side, best values, links to runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from litsim_sim.core.errors import InputError
from litsim_sim.report.experiment import write_experiment_report

Write = Callable[..., Path]


def test_page(evaluation: Write, tmp_path: Path) -> None:
    folder = evaluation(tmp_path)
    (folder / "idm-litsim-made-8").mkdir()
    (folder / "idm-litsim-made-8/report.html").write_text("")
    out = write_experiment_report(folder / "evaluation.json")
    html = out.read_text()
    assert out == folder / "experiment.html"
    assert html.count("<tr><td>litsim</td>") == html.count("<tr><td>replay</td>") == 2
    assert 'href="idm-litsim-made-8/report.html"' in html
    assert html.count("href=") == 2  # of the icon, and of the one run that has a report
    row = html[html.index("agents that collide") :].split("</tr>")[0]
    assert '<td class="number">4</td><td class="number best">0</td>' in row
    assert (
        "collision rate" not in html.split("Policies side by side")[1].split("Every run")[0]
    )  # not in this evaluation


def test_failed_runs_are_listed_with_the_reason(evaluation: Write, tmp_path: Path) -> None:
    lost = "its process was ended by SIGKILL"
    failures = {"litsim": {"made/9": "node policy ended: <b>no weights</b>", "made/10": lost}}
    html = write_experiment_report(evaluation(tmp_path, failures=failures)).read_text()
    listed = html[html.index("Failed runs") : html.index("Every run</h2>")]
    why = "node policy ended: &lt;b&gt;no weights&lt;/b&gt;"
    assert f"<tr><td>litsim</td><td>made/9</td><td>{why}</td></tr>" in listed
    assert f"<td>made/10</td><td>{lost}</td>" in listed
    assert "2 runs failed" in html and "6 runs ·" in html and "every run valid" not in html


def test_without_failures_there_is_no_list_of_them(evaluation: Write, tmp_path: Path) -> None:
    html = write_experiment_report(evaluation(tmp_path, failures={})).read_text()
    assert "Failed runs" not in html and "every run valid" in html and "4 runs ·" in html


def test_an_experiment_of_which_every_run_failed_has_a_page(evaluation: Write, tmp_path: Path) -> None:
    nothing = {"summary": {"replay": {"runs": 1, "failed": 1}}, "runs": {"replay": {}}}
    html = write_experiment_report(evaluation(tmp_path, **nothing, failures={"replay": {"made/7": "lost"}})).read_text()
    assert "<td>made/7</td><td>lost</td>" in html


def test_links_lead_from_where_the_page_is(evaluation: Write, tmp_path: Path) -> None:
    (tmp_path / "runs/idm-litsim-made-7").mkdir(parents=True)
    (tmp_path / "runs/idm-litsim-made-7/report.html").write_text("")
    (tmp_path / "pages").mkdir()
    out = write_experiment_report(evaluation(tmp_path / "runs"), tmp_path / "pages/x.html")
    assert 'href="../runs/idm-litsim-made-7/report.html"' in out.read_text()


@pytest.mark.parametrize(
    "text",
    [
        None,
        "no JSON",
        "[]",
        '{"summary": {}}',
        '{"summary": {"a": 1}, "runs": {"a": {}}}',
        '{"summary": {"a": {}}, "runs": {"a": {}}, "failures": [1]}',
    ],
)
def test_what_is_no_evaluation(text: str | None, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "evaluation.json").write_text(text)
    with pytest.raises(InputError, match=r"evaluation\.json"):
        write_experiment_report(tmp_path)
