"""What comes from data is text on every page, whatever it holds; and the templates are where the code finds them."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import jinja2
import pytest

from campaigns import page_of
from litsim_data.pictures.recording_plots import draw
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report import run_report
from litsim_eval.report.pages import asset, render_page
from litsim_sim.record.run import Run
from litsim_sim.scenario.recording import Recording, RecordingHeader
from packed import of_page

HOSTILE = "a\"b'c</script></title></pre><script>alert(1)</script><img src=x onerror='alert(2)'>{{ 7 * 7 }}&amp;"


class Page(HTMLParser):
    """Tags with their attributes, and the text of a page as a browser reads it."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data

    def count(self, tag: str) -> int:
        return sum(name == tag for name, _ in self.tags)


def expect_text(html: str, scripts: int, times: int) -> None:
    """HOSTILE stands on the page as text, at least `times`, and nothing of it has become a tag."""
    page = Page(html)
    assert page.text.count(HOSTILE) >= times
    assert page.count("script") == scripts
    assert not any(attributes.get("src") == "x" or "onerror" in attributes for _, attributes in page.tags)
    assert "<script>alert" not in html and "<img src=x" not in html


def test_hostile_text_of_a_run(small_run: Run) -> None:
    versions = json.dumps({HOSTILE: HOSTILE})
    changes = dict.fromkeys(("run_id", "scenario", "ego", "policy", "configuration"), HOSTILE)
    run = replace(small_run, info=replace(small_run.info, versions=versions, **changes), scenario_yaml=HOSTILE)
    metrics = compute_metrics(run) | {"why": HOSTILE, "digest": HOSTILE, HOSTILE: {HOSTILE: [HOSTILE]}}
    html = run_report.render(run, metrics)
    expect_text(html, scripts=3, times=12)
    assert of_page(html)[0]["run"]["id"] == HOSTILE


def test_hostile_text_of_a_campaign(campaign: Callable[..., Path], tmp_path: Path) -> None:
    folder = campaign(
        tmp_path, scenes=1, name=HOSTILE, criteria={"runs": [{"name": HOSTILE, "field": "takeovers", "max": 0}]}
    )
    file = folder / "campaign.json"
    values = json.loads(file.read_text())
    values["versions"] = {HOSTILE: HOSTILE}
    for case in values["cases"]:
        case |= {"name": HOSTILE, "label": HOSTILE, "tags": [HOSTILE], "scenario": HOSTILE}
    file.write_text(json.dumps(values))
    html = page_of(folder).read_text()
    expect_text(html, scripts=2, times=10)
    assert of_page(html)[0]["tags"] == [HOSTILE]


def test_hostile_text_of_a_recording(tmp_path: Path, track: type) -> None:
    rows = track(id=1, x=0.0, yaw=0.0).rows()
    draw(Recording.from_table(RecordingHeader(HOSTILE), rows, "one"), tmp_path / "one.html", HOSTILE)
    html = (tmp_path / "one.html").read_text()
    expect_text(html, scripts=0, times=3)  # title, heading, text
    assert [tag for tag, _ in Page(html).tags].count("img") == 1


def test_style_and_scripts_are_as_they_are(small_run: Run) -> None:
    html = run_report.render(small_run, compute_metrics(small_run))
    for name in ("report.css", "container.js", "data.js", "view.js", "svg.js", "charts.js", "app.js"):
        assert asset(name).strip() in html
        assert not re.search(r"</(script|style)", asset(name), re.IGNORECASE)  # would end the element that it stands in


def test_the_page_of_a_campaign_holds_its_scripts(campaign: Callable[..., Path], tmp_path: Path) -> None:
    html = page_of(campaign(tmp_path, scenes=1)).read_text()
    parts = ("", "_runs", "_pictures", "_table", "_charts", "_panel", "_columns", "_view", "_filters")
    names = [f"campaign{part}.js" for part in parts]
    for name in ("campaign.css", "container.js", "svg.js", *names):
        assert asset(name).strip() in html
        assert not re.search(r"</(script|style)", asset(name), re.IGNORECASE)


def test_a_value_that_a_template_lacks_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="is undefined"):
        render_page("experiment.html.j2")


def test_the_package_installs_the_templates() -> None:
    source = Path(__file__).resolve().parents[3] / "src/litsim_eval"
    (endings,) = re.findall(r"^ENDINGS = \((.*)\)$", (source / "setup.py").read_text(), re.MULTILINE)
    used = {
        path.suffix[1:]
        for folder in ("assets", "templates")
        for path in (source / "litsim_eval/report" / folder).iterdir()
    }
    assert used <= set(re.findall(r'"([\w.]+)"', endings))
    assert used == {"css", "js", "j2"}
