"""All that shows measures is made from the objects: those of LitSim, and one that a plug-in adds in one place."""

from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from rich.console import Console

from campaigns import stored, summarised_metrics
from litsim_eval.analysis import metrics, summary
from litsim_eval.analysis.measure import Better, Measure
from litsim_eval.campaign.criteria import Criteria
from litsim_eval.report.campaign_content import fields_of
from litsim_eval.report.terminal import print_metrics
from litsim_eval.runs.summary_table import print_summary
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import Run
from made_runs import make_run, table
from programs import program

tool = program("tools/measures.py")
MADE = (metrics.added, metrics.measures, metrics.metric_fields, metrics.measures_by_field, summary.all_rows)
FASTEST = Measure(
    "fastest",
    lambda run: max(float(table.speed.max()) for table in run.tables),
    title="highest speed",
    unit="m/s",
    better=Better.LOWER,
    text="highest speed of all agents",
)
ENDLESS = Measure("endless", lambda _: float("inf"))


@pytest.fixture
def plugin(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The measure that the test names, installed by an entry point."""
    name = request.param.lower()
    entry = EntryPoint(name, f"{__name__}:{request.param}", plugins.METRICS)
    others = plugins.installed
    monkeypatch.setattr(
        plugins, "installed", lambda group: {name: entry} if group == plugins.METRICS else others(group)
    )
    for made in MADE:
        made.cache_clear()
    yield
    for made in MADE:
        made.cache_clear()


@pytest.fixture
def run() -> Run:
    return make_run([table(k, {"id": 1, "x": float(k), "y": 0.0}, {"id": 2, "x": 50.0, "y": 0.0}) for k in range(3)])


@pytest.mark.parametrize("plugin", ["FASTEST"], indirect=True)
@pytest.mark.usefixtures("plugin")
def test_a_measure_that_is_added_in_one_place_shows_everywhere(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = metrics.compute_metrics(run)
    assert measured["added"] == {"fastest": 10.0}
    print_metrics(measured)
    assert "highest speed" in (out := capsys.readouterr().out) and "10.00 m/s" in out
    slow = Criteria(runs=[{"name": "slow", "field": "added.fastest", "max": 5.0}])
    both = [summarised_metrics(added={"fastest": speed}) for speed in (10.0, 4.0)]
    campaign = stored(tmp_path, both, criteria=slow)
    assert campaign.results[0].reason == "highest speed 10.00 m/s, expected at most 5 m/s"
    print_summary("", {"all": summary.summarise(both) | {"passed": 1}}, Console(width=80))
    assert "highest speed [m/s] ↓" in (out := capsys.readouterr().out) and " 7 " in out
    (field,) = (each for each in fields_of(campaign) if each["path"] == "added.fastest")
    assert (field["label"], field["about"]) == ("highest speed [m/s]", FASTEST.text)
    assert (field["values"], field["limits"], field["main"]) == ([10.0, 4.0], [5.0], True)


@pytest.mark.parametrize("plugin", ["ENDLESS"], indirect=True)
@pytest.mark.usefixtures("plugin")
def test_a_measure_that_is_no_number_is_named(run: Run) -> None:
    with pytest.raises(InputError, match="measure endless is inf, expected a finite number"):
        metrics.compute_metrics(run)


def test_the_page_is_of_today_and_has_all_measures() -> None:
    text = tool.PAGE.read_text(encoding="utf-8")
    assert tool.page(text) == text, "run ./litsim exec python tools/measures.py"
    assert {name for _, names, _ in tool.BLOCK.findall(text) for name in names.split()} == set(tool.DOCUMENTED)
    assert all(measure.text for family in tool.DOCUMENTED.values() for measure in family)
