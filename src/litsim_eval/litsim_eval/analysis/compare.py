"""Measures of several runs side by side."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from math import isclose
from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import compute_metrics, leaves
from litsim_sim.core.errors import InputError
from litsim_sim.record.bag import find_mcap
from litsim_sim.record.run import read_run

SAME_RELATIVE = 1e-12
"""Relative difference up to which numbers count as equal: rounding of sums in another order."""

OF_AN_EXECUTION = ("run_id", "timing")
"""Branches of the measures that differ between equal runs."""

_SUFFIX = ".json"


@dataclass(frozen=True)
class Row:
    """One measure of all runs.

    Attributes:
        name: path in `metrics.json`, joined by dots.
        values: its value in each run; None where a run has none; the length of a list.
        differs: whether any value differs from the first; lists are compared entry by entry.
    """

    name: str
    values: tuple[Any, ...]
    differs: bool

    @property
    def of_the_run(self) -> bool:
        """Whether equal runs agree on it: false for the run id and wall times."""
        return self.name.split(".")[0] not in OF_AN_EXECUTION

    @property
    def marked(self) -> bool:
        """Whether the row tells unequal runs apart: its values differ, and those of equal runs do not."""
        return self.differs and self.of_the_run

    @property
    def change(self) -> float | None:
        """Difference of the second run's value from the first one's; None where either is not a number."""
        first, second = self.values[:2]
        return second - first if _number(first) and _number(second) else None


@dataclass(frozen=True)
class Comparison:
    """Runs side by side.

    Attributes:
        names: unique names of the runs.
        rows: measures in the order of `metrics.json`.
    """

    names: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def equal(self) -> bool:
        """Whether only the run id and wall times differ."""
        return not any(row.marked for row in self.rows)

    def to_json(self) -> dict[str, Any]:
        """Returns names of the runs, whether they are equal, and all rows, as values for JSON."""
        return {"runs": self.names, "equal": self.equal, "rows": [asdict(row) for row in self.rows]}


def compare(metrics: dict[str, dict[str, Any]]) -> Comparison:
    """Compares trees of :func:`litsim_eval.analysis.metrics.compute_metrics`, keyed by name of the run.

    A branch of one run that is null in another has rows for its leaves alone.
    """
    columns = [leaves(tree) for tree in metrics.values()]
    names = list(dict.fromkeys(name for column in columns for name in column))
    branches = {name[:dot] for name in names for dot, letter in enumerate(name) if letter == "."}
    rows = []
    for name in names:
        if name in branches:
            continue
        values = [column.get(name) for column in columns]
        shown = tuple(len(value) if isinstance(value, list) else value for value in values)
        rows.append(Row(name, shown, any(not _same(values[0], value) for value in values[1:])))
    return Comparison(tuple(metrics), tuple(rows))


def load(path: Path) -> dict[str, Any]:
    """Returns measures of a run, read from a JSON file or computed from a bag (a `metrics.json` beside it is ignored).

    Raises:
        InputError: `path` is neither.
    """
    if path.suffix != _SUFFIX:
        return compute_metrics(read_run(find_mcap(path)))
    try:
        metrics = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable file of measures: {error}") from error
    if not isinstance(metrics, dict) or "run_id" not in metrics:
        raise InputError(f"{path}: not measures of a run: no field run_id")
    return metrics


def names_of(paths: list[Path]) -> list[str]:
    """Returns short unique names: as many of the last parts of the paths as it takes."""
    parts = [path.resolve().with_suffix("").parts for path in paths]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{index + 1}: {path.name}" for index, path in enumerate(paths)]


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _same(a: Any, b: Any) -> bool:
    if _number(a) and _number(b):
        return isclose(a, b, rel_tol=SAME_RELATIVE)
    return bool(a == b) and type(a) is type(b)
