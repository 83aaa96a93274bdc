"""One run as one HTML file that opens anywhere: player, plots, ledger, measures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from markupsafe import Markup
from pydantic import ValidationError

from litsim_eval.analysis.measures.timing import pace_text
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report.content import pack_run
from litsim_eval.report.events import contact_table, takeover_table
from litsim_eval.report.forecasts import read_forecasts
from litsim_eval.report.pages import render_page
from litsim_eval.report.plans import read_plans
from litsim_eval.report.verdict import verdict_in
from litsim_eval.report.wording import NOTHING, lockstep_text, measured
from litsim_sim.core.errors import InputError
from litsim_sim.core.topic_names import RUN_INFO
from litsim_sim.io.files import write_text
from litsim_sim.io.yaml_input import load_yaml
from litsim_sim.record.bag import FAILURE_FILE
from litsim_sim.record.run import Run, read_run
from litsim_sim.scenario.changes import changes_of

REPORT_FILE = "report.html"
DATA_MAX = 8_000_000  # most characters of packed data; the page must stay below 10 MB
THINNING = (1, 2, 5, 10)  # steps between forecasts, tried in this order until the data fit


def write_report(bag: Path, out: Path | None = None) -> Path:
    """Writes the report of the run in `bag` (folder or MCAP file), and returns the path of the page.

    That is `out`, by default `report.html` beside the bag; a verdict in an earlier report is kept.

    Raises:
        InputError: `bag` is not a LitSim run, or the page cannot be written.
    """
    run = read_run(bag)
    path = out or run.path.parent / REPORT_FILE
    write_text(path, render(run, compute_metrics(run), verdict_in(path)))
    return path


def render(run: Run, metrics: dict[str, Any], verdict: str = "") -> str:
    """Returns the page of a run as HTML; for its `verdict` see :func:`litsim_eval.report.verdict.verdict_text`."""
    info = run.info
    data, stride = _packed(run, metrics)
    thinned = "" if stride == 1 else f" Forecasts are shown every {stride * info.dt:.1f} s to keep this file small."
    beside = f" and {FAILURE_FILE}" if run.failure else ""
    return render_page(
        "report.html.j2",
        title=f"{info.scenario}, ego {info.ego_id} by {info.ego}, {info.policy}",
        subtitle=f"ego {info.ego_id} by {info.ego} · background by {info.policy} · seed {info.seed}",
        info=info,
        complete=run.complete,
        verdict=Markup(verdict),  # noqa: S704 - JSON, in which < is escaped
        metrics=metrics,
        takeovers=takeover_table(metrics["ledger"], info.dt, info.ego_id),
        contacts=contact_table(metrics, info.dt, info.ego_id),
        measures=list(_measures(metrics)),
        every_measure={name: value for name, value in metrics.items() if name != "ledger"},
        what_was_run=_what_was_run(run),
        scenario_yaml=run.scenario_yaml.strip(),
        footnote=f"Everything on this page comes from {run.path.name}{beside}.{thinned}",
        data=data,
    )


def _measures(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields title and text of what the page tells of a run."""
    yield from measured(metrics)
    if slow := pace_text(metrics):
        yield "pace", slow
    yield "lock-step", lockstep_text(metrics["lockstep"])


def _packed(run: Run, metrics: dict[str, Any]) -> tuple[str, int]:
    """Returns packed data, and the number of steps between forecasts."""
    forecasts, plans = read_forecasts(run), read_plans(run)
    data = ""
    for stride in THINNING:
        data = pack_run(run, metrics, forecasts.every(stride), stride, plans)
        if len(data) <= DATA_MAX:
            return data, stride
    raise InputError(
        f"{run.path}: too long for one page: {len(data) / 1e6:.1f} MB of data, at most {DATA_MAX / 1e6:.1f}"
    )


def _what_was_run(run: Run) -> Iterator[tuple[str, str]]:
    info = run.info
    steps = (
        f"{run.tables[-1].step} of {info.total_steps}, {info.dt:g} s each, the first {info.history_steps} are history"
    )
    yield from (("run", info.run_id), ("scenario", info.scenario), ("seed", str(info.seed)), ("steps", steps))
    if changes := run.scenario.get("changes"):
        with suppress(ValidationError):  # of a record that a later version has made
            yield "changes of the scenario", "; ".join(change.text for change in changes_of(changes))
    yield "ended", NOTHING if run.ended is None else run.ended.sentence
    yield from (("ego", f"agent {info.ego_id}, driven by {info.ego}"), ("background", info.policy), ("mode", info.mode))
    versions = load_yaml(info.versions, f"{run.path}: topic {RUN_INFO}, field versions") if info.versions else None
    for name, version in versions.items() if isinstance(versions, dict) else ():
        yield str(name), str(version)
