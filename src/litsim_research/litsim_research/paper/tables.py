"""The paper's tables: rows for CSV files, and short Markdown tables that are made from these rows alone."""

from __future__ import annotations

import csv
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

from litsim_eval.analysis.measure import Metrics
from litsim_eval.analysis.measures.displacement import HORIZONS_S
from litsim_eval.campaign.results import Campaign, RunResult
from litsim_research.paper.experiments import OURS
from litsim_research.paper.measures import (
    COUNTS,
    Key,
    Parts,
    Whose,
    ade_parts,
    by_key,
    count,
    figure,
    interval,
    run_parts,
)
from litsim_research.paper.published import OTHER_DATA
from litsim_research.paper.roads import HIGHWAY, REAL, STREETS, URBAN
from litsim_sim.io.files import replacing
from litsim_sim.scenario.policies import REPLAY

NOTHING = "-"
CLEAR = "\\*"
"""Marks a clear difference from LitSim: its interval excludes zero."""

ALL_SETS = "all"
PUBLISHED = "paper"
"""Sets of rows that are of all sets together, and of the paper's own figures on other data."""

SET_NAMES = {
    REAL: "US-101",
    STREETS: "Lankershim, Peachtree",
    HIGHWAY: "generated motorway",
    URBAN: "generated street",
    ALL_SETS: "all roads",
}
CONFLICTING_EGOS = "conflicting"
"""Ego of rows that are of all of :data:`.experiments.CONFLICTING` together."""

Methods = Mapping[str, Mapping[Key, Metrics | None]]


class Row(NamedTuple):
    """One measure of one method, as the texts of the cells of a CSV file.

    Attributes:
        ego: driver of the ego, or :data:`CONFLICTING_EGOS`.
        set: set of roads, :data:`ALL_SETS` or :data:`PUBLISHED`.
        method: row of the paper's table.
        measure: key of a :class:`Measure`, or of :data:`.measures.COUNTS`.
        unit: `m`, `%`, or empty.
        value: over all runs.
        sd: standard deviation over draws; empty with fewer than two draws, and for counts.
        difference, lower, upper: the method minus LitSim over the cases that both have, with the bounds of its 95 %
            interval; empty for LitSim, replay, and where there is no interval.
        clear: `yes` where that interval excludes zero, otherwise empty.
        runs, failed: number of runs, and of those without metrics.
    """

    ego: str
    set: str
    method: str
    measure: str
    unit: str
    value: str
    sd: str = ""
    difference: str = ""
    lower: str = ""
    upper: str = ""
    clear: str = ""
    runs: str = ""
    failed: str = ""


class ClaimRow(NamedTuple):
    """In how many tables, one for each ego and set of roads, a claim holds.

    Attributes:
        claim: its text.
        litsim, paper: `HELD of TOLD`, where LitSim has its defaults or the paper's configuration; `-` where no table
            tells.
    """

    claim: str
    litsim: str
    paper: str


@dataclass(frozen=True)
class Measure:
    """A column.

    Attributes:
        key: its key in :mod:`.measures` and :mod:`.published`.
        heading: with the unit.
        better: `min` or `max`, whichever is better; None if neither is.
        scale: factor applied to values.
        digits: digits after the point.
    """

    key: str
    heading: str
    better: Callable[[Sequence[float]], float] | None
    scale: float = 1.0
    digits: int = 2

    @property
    def unit(self) -> str:
        """`m`, `%`, or empty."""
        return "%" if self.scale == 100.0 else "m" if self.heading.endswith(", m") else ""

    def text(self, value: float) -> str:
        """Returns `value` as the text of a cell."""
        return f"{self.scale * value:.{self.digits}f}"


ADE = tuple(Measure(f"ade_{h}", f"ADE {h} s, m", min) for h in HORIZONS_S)
OF_THE_PAPER = (
    *ADE,
    Measure("collision", "collision %", min, 100.0),
    Measure("reactivity", "reactivity %", max, 100.0, 1),
    Measure("progress", "progress, m", None, digits=1),
    Measure("relevant", "relevant %", min, 100.0),
)
"""Columns of Table II, by the paper's definitions."""

BESIDE = (
    *(Measure(f"own_{h}", f"own ADE {h} s, m", None) for h in HORIZONS_S),
    *(Measure(f"all_{h}", f"ADE of all {h} s, m", min) for h in HORIZONS_S),
    Measure("collision_beyond", "collision %, log's excluded", min, 100.0),
    Measure("collision_driven", "collision %, driven", min, 100.0),
    Measure("collision_driven_beyond", "collision %, driven, log's excluded", min, 100.0),
    Measure("reactivity_beyond", "reactivity %, log's excluded", max, 100.0, 1),
    Measure("relevant_ours", "relevant %, all taken over", min, 100.0),
    Measure("off_road", "off road %, driven", min, 100.0),
    Measure("realism", "realism", max, digits=3),
)
"""Further columns, by LitSim's definitions where they differ from the paper's."""


MEASURES = (*OF_THE_PAPER, *BESIDE)
BY_KEY = {measure.key: measure for measure in MEASURES}
SUMMARY = tuple(BY_KEY[key] for key in ("ade_15", "collision", "reactivity", "relevant"))
SUMMED = {
    "colliding": "colliding runs",
    "fault_background": "contacts, background's fault",
    "takeovers": "takeovers",
    "hard_brakes": "hard brakes",
}
"""Columns of :func:`summary`: measures, and counts."""


R = TypeVar("R", bound=NamedTuple)
T = TypeVar("T")


def methods_of(campaign: Campaign, egos: Collection[str], tag: str | None) -> dict[str, dict[Key, Metrics | None]]:
    """Returns metrics of the runs of each method with `egos` on the set `tag` (None: all), in the campaign's order."""
    by_method: dict[str, list[RunResult]] = {}
    for result in campaign.results:
        if result.case.ego.name in egos and (tag is None or tag in result.case.tags):
            by_method.setdefault(result.case.label or result.case.policy, []).append(result)
    return {name: by_key(results) for name, results in by_method.items()}


def parts_of(methods: Methods, measures: Sequence[Measure]) -> dict[str, dict[str, Parts]]:
    """Returns contributions of the runs to each measure, by the measure's key, then by method."""
    parts: dict[str, dict[str, Parts]] = {}
    for measure in measures:
        kind, _, horizon = measure.key.rpartition("_")
        if kind in ("ade", "all"):
            whose: Whose = "driven" if kind == "ade" else "all"
            parts[measure.key] = ade_parts(methods, int(horizon), whose)
        elif kind == "own":
            parts[measure.key] = {
                name: ade_parts({name: runs}, int(horizon), "driven")[name] for name, runs in methods.items()
            }
        else:
            parts[measure.key] = {name: run_parts(runs, measure.key) for name, runs in methods.items()}
    return parts


def rows(methods: Methods, ego: str, tag: str | None) -> list[Row]:
    """Returns rows of all measures and counts of `methods` with `ego` on the set `tag` (None: all sets)."""
    parts = parts_of(methods, MEASURES)
    where = tag or ALL_SETS
    records: list[Row] = []
    for name, runs in methods.items():
        numbers = {"runs": str(len(runs)), "failed": str(sum(metrics is None for metrics in runs.values()))}
        for measure in MEASURES:
            of_method = figure(parts[measure.key][name])
            if of_method is None:
                continue
            row = Row(ego, where, name, measure.key, measure.unit, measure.text(of_method.value), **numbers)
            if of_method.spread is not None:
                row = row._replace(sd=measure.text(of_method.spread))
            if OURS in methods and name not in (OURS, REPLAY):
                row = row._replace(**_compared(measure, parts[measure.key][OURS], parts[measure.key][name]))
            records.append(row)
        records += [Row(ego, where, name, key, "", str(count(runs, key)), **numbers) for key in COUNTS]
    return records


def published_rows(ego: str, values: Mapping[str, Mapping[str, float]]) -> list[Row]:
    """Returns rows of the paper's own figures, by method and by the key of the measure."""
    return [
        Row(ego, PUBLISHED, name, measure.key, measure.unit, measure.text(of_method[measure.key]))
        for name, of_method in values.items()
        for measure in MEASURES
        if measure.key in of_method
    ]


def write_csv(path: Path, records: Sequence[NamedTuple]) -> None:
    """Write `records` to the file `path`, with a line of headings."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as new, new.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows([records[0]._fields, *records])


def read_csv(path: Path, kind: Callable[..., R]) -> list[R]:
    """Returns records that :func:`write_csv` wrote."""
    with path.open(encoding="utf-8", newline="") as stream:
        return [kind(**record) for record in csv.DictReader(stream)]


def summary(records: Sequence[Row], *, counts_alone: bool = False) -> list[str]:
    """Returns lines of a short table of the rows of all sets together: a line for each method.

    Clear differences from LitSim are marked. With `counts_alone`, it has no measures.
    """
    measures = () if counts_alone else SUMMARY
    headings = ["method", "runs", *(measure.heading for measure in measures), *SUMMED.values()]
    cells: list[list[str]] = []
    told = [row for row in records if row.ego == CONFLICTING_EGOS and row.set in (ALL_SETS, PUBLISHED)]
    for method, published in _different((row.method, row.set == PUBLISHED) for row in told):
        of_method = {row.measure: row for row in told if (row.method, row.set == PUBLISHED) == (method, published)}
        values = [_cell(of_method.get(measure.key), "" if published else NOTHING) for measure in measures]
        if published:
            label = f"{method}: {OTHER_DATA}".replace("*", "\\*")
            cells.append([label, "", *values, *[""] * len(SUMMED)])
            continue
        row = of_method["takeovers"]
        number = f"{row.runs}, {row.failed} failed" if int(row.failed) else row.runs
        cells.append([f"`{method}`", number, *values, *(of_method[key].value for key in SUMMED)])
    return markdown(headings, cells, right=len(headings) - 1)


def _different(values: Iterable[T]) -> list[T]:
    return list(dict.fromkeys(values))


def _cell(row: Row | None, missing: str = NOTHING) -> str:
    return missing if row is None else f"{row.value}{CLEAR if row.clear else ''}"


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]], right: int = 0) -> list[str]:
    """Returns the lines of a Markdown table, the last `right` columns of which are aligned to the right."""
    rule = ["---"] * (len(headings) - right) + ["---:"] * right
    return [f"| {' | '.join(cells)} |" for cells in (headings, rule, *rows)]


def _compared(measure: Measure, ours: Parts, theirs: Parts) -> dict[str, str]:
    """Returns the cells of :class:`Row` that compare a method with LitSim, over the cases that both have."""
    bounds = interval(ours, theirs)
    both = ({key: parts[key] for key in ours if key in theirs} for parts in (ours, theirs))  # those of the bounds
    mine, other = map(figure, both)
    if bounds is None or mine is None or other is None:
        return {}
    lower, upper = bounds
    return {
        "difference": measure.text(other.value - mine.value),
        "lower": measure.text(lower),
        "upper": measure.text(upper),
        "clear": "yes" if lower > 0.0 or upper < 0.0 else "",
    }
