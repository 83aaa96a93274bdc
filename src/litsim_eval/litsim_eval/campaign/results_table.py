"""The results of a campaign as one Parquet table with a row for each run, for pandas, DuckDB and the like."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from litsim_eval.analysis.measure import ANY_KEY
from litsim_eval.analysis.metrics import leaves, metric_fields
from litsim_eval.campaign.criteria import counted
from litsim_eval.campaign.results import RunResult
from litsim_sim.io.files import replacing

TABLE_FILE = "results.parquet"
OF_THE_RUN: dict[str, tuple[pa.DataType, Callable[[RunResult], Any]]] = {
    "id": (pa.string(), attrgetter("case.id")),
    "scenario": (pa.string(), lambda result: Path(result.case.scenario).stem),
    "ego_id": (pa.int64(), attrgetter("case.ego_id")),
    "ego": (pa.string(), attrgetter("case.ego.name")),
    "policy": (pa.string(), attrgetter("case.policy")),
    "variant": (pa.string(), attrgetter("case.variant")),
    "seed": (pa.int64(), lambda result: (result.metrics or {}).get("seed", result.case.seed)),
    "draw": (pa.int64(), attrgetter("case.draw")),
    "tags": (pa.list_(pa.string()), attrgetter("case.tags")),
    "verdict": (pa.string(), attrgetter("verdict.value")),
    "reason": (pa.string(), attrgetter("reason")),
    "digest": (pa.string(), lambda result: (result.metrics or {}).get("digest")),
    "wall_s": (pa.float64(), attrgetter("wall_s")),
}
"""The first columns, each with its type and its value for a result; those of the measures follow."""


def write_results_table(results: Sequence[RunResult], path: Path) -> None:
    """Writes :func:`results_table` to `path`; raises Unwritable if it cannot be written."""
    with replacing(path) as new:
        pq.write_table(results_table(results), new)


def results_table(results: Sequence[RunResult]) -> pa.Table:
    """Returns the results as a table: :data:`OF_THE_RUN`, then each measure that is a number, a boolean or a list.

    A column is called by the dotted path of its measure in `metrics.json`. Of a list it has the length, as in criteria.
    A value is null if a run does not have the measure, or could not be measured.
    """
    columns = {name: pa.array(map(value, results), kind) for name, (kind, value) in OF_THE_RUN.items()}
    runs = [{name: counted(value) for name, value in leaves(result.metrics or {}).items()} for result in results]
    of_any = dict.fromkeys(name for run in runs for name in run)
    for field in metric_fields():
        if str in field.kinds:
            continue
        kind = pa.bool_() if field.kinds == {bool} else pa.float64() if float in field.kinds else pa.int64()
        for name in filter(field.covers, of_any) if ANY_KEY in field.name else [field.name]:
            values = [pa.scalar(run.get(name)).cast(kind).as_py() for run in runs]
            columns.setdefault(name, pa.array(values, kind))
    return pa.table(columns)
