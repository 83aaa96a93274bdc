"""What the runs of one variant come to together: the rows of the tables of campaigns, which the measures declare."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from litsim_eval.analysis.measure import Better, Measure, Metrics, Row, Table, figure_at, total
from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_eval.analysis.metrics import ADDED, leaves, measures, metric_fields
from litsim_sim.core.errors import shown

MARK = "*"
"""Behind values that leave out runs without measures."""
OF_CAMPAIGN = (
    Row("runs", table=Table.EGO, title="runs", of_all=True),
    Row("passed", table=Table.EGO, title="passed", better=Better.HIGHER, of_all=True),
    Row("not_passed", table=Table.EGO, title="failed", better=Better.LOWER, of_all=True),
    Row("errors", table=Table.EGO, title="errors", better=Better.LOWER, of_all=True),
)
"""Rows of the verdicts, the first of all."""


@cache
def all_rows() -> tuple[Row, ...]:
    """Returns the rows of all tables."""
    return (*OF_CAMPAIGN, *(_complete(row, measure) for measure in measures() for row in measure.rows))


def _complete(row: Row, measure: Measure) -> Row:
    """Returns a row with all that it takes from its measure."""
    path = measure.path(row.key)
    return replace(
        row,
        name=row.name or path.rpartition(".")[2],
        title=row.title or measure.title.format(row.key),
        unit=row.unit or ("%" if row.share or measure.share else measure.unit),
        figure=None if row.of_all else row.figure or figure_at(path),
        better=measure.better if row.better is None else row.better,
        share=row.share or measure.share,
    )


def rows_of(*tables: Table) -> list[Row]:
    """Returns the rows of some tables, in the order of the tables."""
    return [row for table in tables for row in all_rows() if row.table == table]


def table_rows() -> list[Row]:
    """Returns the rows that are made of figures of the runs."""
    return [row for row in all_rows() if row.figure is not None]


def value_of(row: Row, runs: Sequence[Metrics]) -> float | None:
    """Returns what the measured `runs` come to in a row that is made of figures."""
    assert row.figure is not None
    above = row.over([row.figure(run) for run in runs])
    if row.below is None:
        return above
    below = total([row.below(run) for run in runs])
    return above / below if above is not None and below else None


def mark_of(row: Row, values: Mapping[str, Any]) -> str:
    """Returns the mark of a row among `values`, the leaves of a summary; empty if it is over all runs."""
    return MARK if values["failed"] and not row.of_all else ""


def reached(row: Row, values: Mapping[str, Any]) -> str:
    """Returns how many runs lasted up to the horizon of a displacement, as a suffix; empty if all of them did."""
    runs = values.get(f"ade_runs.{row.name.rpartition('.')[2]}", values["measured"])
    return f" ({runs} of {values['measured']})" if runs < values["measured"] and values[row.name] is not None else ""


def check_summable(metrics: Metrics) -> None:
    """Checks that measures read from a file can be summarised, and that what criteria judge has its type.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: they cannot; a branch is missing or a field has another type.
    """
    for row in table_rows():
        for figure in filter(None, (row.figure, row.below)):
            figure(metrics)
    steps = [entry["detected_step"] for entry in metrics["ledger"]]
    steps += [contact["step"] for contact in metrics["collision"]["contacts"]]
    if max(steps, default=0) > metrics["steps"]:
        raise ValueError(f"a takeover or contact at step {max(steps)}, expected at most {metrics['steps']}")
    kinds = {field.name: field.kinds for field in metric_fields()}
    for name, value in leaves(metrics).items():
        expected = kinds.get(name)
        if value is None or expected is None or type(value) in expected:
            continue
        if not (type(value) is int and float in expected):
            names = " or ".join(sorted(kind.__name__ for kind in expected))
            raise ValueError(f"field {name} is {shown(value)}, expected {names}")


def summarise(runs: Iterable[Metrics], failed: int = 0) -> dict[str, Any]:
    """Returns all measures of the measured runs by name, those of one branch together; None where there are no values.

    Args:
        runs: metrics of the measured runs, valid or not.
        failed: number of runs without metrics. They count in `runs` and in the denominator of `reactive`, the share of
            runs known to be free of excess collisions; all other measures are of the `measured` runs alone, and ADE up
            to a horizon of those that lasted that long: as many as `ade_runs` says.
    """
    runs = list(runs)
    count = len(runs) + failed
    summary: dict[str, Any] = {
        "runs": count,
        "failed": failed,
        "measured": len(runs),
        "invalid": sum(not run["valid"] for run in runs),
        "reactive": sum(run["reactive"] for run in runs) / count if count else None,
        "ade_runs": {str(horizon): sum(str(horizon) in run["ade_all_m"] for run in runs) for horizon in HORIZONS_S},
        ADDED: {},
    }
    for row in table_rows():
        branch, _, leaf = row.name.rpartition(".")
        (summary.setdefault(branch, {}) if branch else summary)[leaf] = value_of(row, runs)
    return summary
