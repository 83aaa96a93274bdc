"""What a measure of a run is: an object with its name, unit, direction, text and function, ours and a user's alike."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from math import inf
from typing import Any, NamedTuple

import numpy as np

from litsim_sim.record.run import Run

Metrics = Mapping[str, Any]
"""The tree of `metrics.json`, of this version or of an earlier one."""
Figure = Callable[[Metrics], float | None]
"""A number of one run from its metrics; None where the run has none."""
Span = tuple[int, int]
"""First and last step."""


class Better(StrEnum):
    """Which values of a measure are better."""

    LOWER = "lower"
    HIGHER = "higher"
    NEITHER = "neither"

    @property
    def arrow(self) -> str:
        """Arrow to the better values, behind a space; empty for neither."""
        return {Better.LOWER: " ↓", Better.HIGHER: " ↑"}.get(self, "")

    def best(self, values: Sequence[float]) -> float | None:
        """Returns the best of `values`; None for neither, and where they are all the same."""
        if self == Better.NEITHER or len(set(values)) < 2:
            return None
        return min(values) if self == Better.LOWER else max(values)


class Between(NamedTuple):
    """Smallest and largest value."""

    low: float
    high: float


SHARE, COUNT = Between(0.0, 1.0), Between(0.0, inf)
"""Ranges of shares; of integers and of lengths of lists: all integers are counts, ids, steps or seeds."""
ANY_KEY = "*"
"""Placeholder in the name of a field for a key that depends on the run, such as a stage or a topic."""


@dataclass(frozen=True)
class MetricField:
    """A field of `metrics.json`.

    Attributes:
        name: its path, joined by dots; :data:`ANY_KEY` stands for a key that depends on the run.
        kinds: possible types: `int`, `float`, `bool`, `str` or `list`.
        between: range of its value, or of its length as a list; None if unknown.
    """

    name: str
    kinds: frozenset[type]
    between: Between | None = None

    @property
    def counts(self) -> bool:
        """Whether bounds can be set on it: it is a number, or a list, by its length."""
        return bool(self.kinds & {int, float, list})

    def covers(self, name: str) -> bool:
        """Returns whether `name` names this field."""
        before, star, after = self.name.partition(ANY_KEY)
        if not star:
            return name == self.name
        return name.startswith(before) and name.endswith(after) and len(name) > len(before) + len(after)


class Table(StrEnum):
    """Tables of a campaign: of the ego, of the simulation, of driven traffic, of displacements from the log."""

    EGO = "ego"
    SIMULATION = "simulation"
    TRAFFIC = "traffic"
    DISPLACEMENT = "displacement"
    NONE = "none"


def total(values: Sequence[float | None]) -> float | None:
    """Returns the sum of `values`; None if there are none, or if one is None: an older version measured that run."""
    return None if None in values or not values else sum(value for value in values if value is not None)


def known_total(values: Sequence[float | None]) -> float | None:
    """Returns the sum of the known `values`; None if there are none."""
    return sum(numbers) if (numbers := _known(values)) else None


def mean(values: Sequence[float | None]) -> float | None:
    """Returns the mean of the known `values`; None if there are none."""
    return float(np.mean(numbers)) if (numbers := _known(values)) else None


def least(values: Sequence[float | None]) -> float | None:
    """Returns the smallest of the known `values`; None if there are none."""
    return min(_known(values), default=None)


def largest(values: Sequence[float | None]) -> float | None:
    """Returns the largest of the known `values`; None if there are none."""
    return max(_known(values), default=None)


def middle(values: Sequence[float | None]) -> float | None:
    """Returns the median of the known `values`; None if there are none."""
    return float(np.median(numbers)) if (numbers := _known(values)) else None


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


@dataclass(frozen=True)
class Row:
    """What the runs of a variant come to together, a row in a table of a campaign.

    What is empty or None is taken from the measure that the row belongs to.

    Attributes:
        name: in the summary; `BRANCH.LEAF` for one of several.
        over: what is made of the figures of the runs.
        table: that shows it.
        title: in the table.
        unit: of what the table shows, which is a percentage of a share.
        key: of the values of the measure, if it has several.
        figure: of a run; None also if the summary makes the row of the runs themselves, see `of_all`.
        below: figure by whose sum that of `figure` is divided.
        better: which of several values is the best.
        share: whether it is a share of a whole.
        of_all: whether runs without measures count in it.
        of_control: whether it is of agents under control, which a replay has not.
    """

    name: str = ""
    over: Callable[[Sequence[float | None]], float | None] = total
    table: Table = Table.SIMULATION
    title: str = ""
    unit: str = ""
    key: str = ""
    figure: Figure | None = None
    below: Figure | None = None
    better: Better | None = None
    share: bool = False
    of_all: bool = False
    of_control: bool = False

    @property
    def heading(self) -> str:
        """Title, unit, and an arrow to the better values."""
        return f"{self.title} [{self.unit}]".removesuffix(" []") + (self.better.arrow if self.better else "")


@dataclass(frozen=True)
class Branch:
    """A function that makes the values of a whole branch of `metrics.json`; measures of it have it as their `value`."""

    function: Callable[[Run], Mapping[str, Any] | None]

    def __call__(self, run: Run) -> Any:
        """Returns the branch of a run, made once; None if there is nothing to measure."""
        return run.once(self.function)


@dataclass(frozen=True)
class Measure:
    """A measure of a run.

    All that measures are shown in is made of these objects: `metrics.json`, criteria and reasons of verdicts, tables of
    runs and campaigns, pages, and docs/metrics.md. A plug-in of `litsim.metrics` is one, too.

    Attributes:
        name: path in `metrics.json`, joined by dots; of a plug-in `added`, and the name of its entry point.
        value: makes the value of a recorded run, or the branch that has it; None if there is nothing to measure.
        title: short name for tables and pages, without which they call it by its path; `{}` stands for a key.
        unit: of the values, such as "m"; empty for none.
        better: which values are better.
        text: definition, as docs/metrics.md and pages have it.
        kinds: possible types of the values.
        share: whether it is a share, from 0 to 1.
        keys: of the values, if it has several.
        rows: in tables of campaigns.
        sentence: what happened in a run that misses a criterion, from value, limits as text, and metrics; None for one
            of title, value and unit.
        moments: steps at which the ego does what counts against it, for marks on the time line.
        missing: why a run may have no value, as a sentence for criteria that need one.
    """

    name: str
    value: Callable[[Run], Any]
    title: str = ""
    unit: str = ""
    better: Better = Better.NEITHER
    text: str = ""
    kinds: tuple[type, ...] = (float,)
    share: bool = False
    keys: tuple[str, ...] = ()
    rows: tuple[Row, ...] = ()
    sentence: Callable[[Any, str, Metrics], str] | None = None
    moments: Callable[[Run, Metrics], Iterable[Span]] | None = None
    missing: str = ""

    def of(self, run: Run) -> Any:
        """Returns the value of a recorded run."""
        value = self.value(run)
        if isinstance(self.value, Branch):
            for name in self.name.split(".")[1:]:
                value = None if value is None else value[name]
        return value

    @property
    def fields(self) -> Iterator[MetricField]:
        """Its fields in `metrics.json`."""
        kinds = frozenset(self.kinds)
        between = SHARE if self.share else COUNT if kinds & {int, list} and float not in kinds else None
        for key in self.keys or ("",):
            yield MetricField(self.path(key), kinds, between)

    def path(self, key: str) -> str:
        """Returns the path of its value at `key`, empty for a measure with one value."""
        return f"{self.name}.{key}" if key else self.name

    def label(self, path: str) -> str:
        """Returns title and unit of its field at `path`; the path if it has no title."""
        unit = "share" if self.share else self.unit
        key = path.removeprefix(self.name).removeprefix(".")
        return f"{self.title.format(key)} [{unit}]".removesuffix(" []") if self.title else path


SUM, MEAN = (Row(),), (Row(over=mean),)
SUM_CONTROLLED, MEAN_CONTROLLED = (Row(of_control=True),), (Row(over=mean, of_control=True),)
KNOWN_OF_EGO = (Row(over=known_total, table=Table.EGO),)
"""Rows that many measures have."""
LOWER, HIGHER = Better.LOWER, Better.HIGHER
Count = partial(Measure, kinds=(int,))
Share = partial(Measure, share=True)
Text = partial(Measure, kinds=(str,))
Truth = partial(Measure, kinds=(bool,))
Listed = partial(Measure, kinds=(list,))
"""Measures of other types than numbers with a fraction."""


def family(*parts: Measure | str) -> tuple[Measure, ...]:
    """Returns the measures among `parts`, each with the last text before it, which may be of several."""
    text, measures = "", []
    for part in parts:
        if isinstance(part, Measure):
            measures.append(replace(part, text=text))
        else:
            text = part
    return tuple(measures)


def of_log(measures: Iterable[Measure]) -> Iterator[Measure]:
    """Yields the same `measures` of the recorded vehicle, without titles, rows and texts."""
    plain: dict[str, Any] = {"title": "", "rows": (), "moments": None, "sentence": None}
    yield from (replace(measure, name=measure.name.replace(".", ".log."), **plain) for measure in measures)


def moments_of(events: Callable[[Metrics], Iterable[Mapping[str, Any]]]) -> Callable[[Run, Metrics], Iterable[Span]]:
    """Returns the function of the moments of events in metrics, from their `step` to their `end_step`, if they last."""
    return lambda _, metrics: ((event["step"], event.get("end_step", event["step"])) for event in events(metrics))


def figure_at(path: str) -> Figure:
    """Returns the figure at `path` in metrics, None where older versions, or some runs, have none.

    Of a list it is the length.
    """

    def figure(run: Metrics) -> float | None:
        value: Any = run
        for key in path.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        return len(value) if isinstance(value, list) else value

    return figure


def share_of(count: int, whole: int) -> float | None:
    """Returns a share; None of nothing."""
    return count / whole if whole else None


def finite(value: float) -> float | None:
    """Returns a number; None if it is not finite."""
    return float(value) if np.isfinite(value) else None


def mean_of(values: np.ndarray) -> float | None:
    """Returns the mean of `values` (n,), such as the share of true; None of nothing."""
    return float(values.mean()) if len(values) else None


def percent(share: float) -> str:
    """Returns a share as a percentage with three digits."""
    return f"{100.0 * share:.3g} %"


def in_percent(limit: str) -> str:
    """Returns the text of a limit on a share with its numbers as percentages."""
    return re.sub(r"\d+(\.\d+)?", lambda number: percent(float(number[0])), limit)
