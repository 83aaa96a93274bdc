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


def test_links_lead_from_where_the_page_is(evaluation: Write, tmp_path: Path) -> None:
    (tmp_path / "runs/idm-litsim-made-7").mkdir(parents=True)
    (tmp_path / "runs/idm-litsim-made-7/report.html").write_text("")
    (tmp_path / "pages").mkdir()
    out = write_experiment_report(evaluation(tmp_path / "runs"), tmp_path / "pages/x.html")
    assert 'href="../runs/idm-litsim-made-7/report.html"' in out.read_text()


@pytest.mark.parametrize("text", [None, "no JSON", "[]", '{"summary": {}}', '{"summary": {"a": 1}, "runs": {"a": {}}}'])
def test_what_is_no_evaluation(text: str | None, tmp_path: Path) -> None:
    if text is not None:
        (tmp_path / "evaluation.json").write_text(text)
    with pytest.raises(InputError, match=r"evaluation\.json"):
        write_experiment_report(tmp_path)
