"""Margins: what a search leaves, as files, and the comparison of two searches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from junitparser import Failure, JUnitXml, TestCase, TestSuite
from pydantic import BaseModel, ConfigDict

from litsim_eval.campaign.comparison import paired_interval
from litsim_eval.report.margins import tries_text
from litsim_eval.search.judging import Outcome
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing, write_text
from litsim_sim.io.yaml_input import read_yaml

MARGINS_FILE, TABLE_FILE, PAGE_FILE, JUNIT_FILE = "margins.json", "tried.parquet", "margins.html", "junit.xml"
FAILURES_FILE = "failures.yaml"


class _Content(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CriticalChange(_Content):
    """The nearest failure of a group, shrunk and repeated.

    Attributes:
        name: of its scenario in `scenarios/`.
        act: kind of what an agent does.
        distance: from reality, in standard deviations.
        distances: the same by parameter.
        changes: what is changed, as sentences.
        reason: what happened.
        holds: whether it failed likewise when it was repeated.
        careful_driver: whether the careful driver avoids the first contact; None without a contact.
        digest: of the run.
        rerun: command that runs it again, with a report.
    """

    name: str
    act: str
    distance: float
    distances: dict[str, float]
    changes: list[str]
    reason: str
    holds: bool
    careful_driver: bool | None
    digest: str
    rerun: str


class Margin(_Content):
    """What a search has learnt of one scenario.

    Attributes:
        name: of the case as recorded.
        margin: least distance of a failure that counts, an upper bound; 0 if it fails as recorded, None if none failed.
        recorded: what becomes of it as recorded; only if it passes it is searched.
        reason: why it does not pass as recorded; empty if it does.
        runs, failed, forced, errors: numbers of runs, those for shrinking included.
        tries: number of runs that were judged, and in which something was different, by kind of act.
        drawn, drawn_failed: numbers of runs that were drawn from the declared distribution.
        rate: bounds of the share of these that fail at 95 %, by Clopper and Pearson (1934); None without any.
        failures: the nearest failure of each group, the nearest first.
    """

    name: str
    margin: float | None
    recorded: Outcome
    reason: str
    runs: int
    failed: int
    forced: int
    errors: int
    tries: dict[str, int]
    drawn: int
    drawn_failed: int
    rate: tuple[float, float] | None
    failures: list[CriticalChange]

    @property
    def broken(self) -> bool:
        """Whether it fails as recorded, or cannot be judged."""
        return self.recorded in (Outcome.FAILED, Outcome.ERROR)

    def none_up_to(self, bound: float) -> list[str]:
        """Returns a line on what was tried up to a bound without a failure that counts; none if it was not searched."""
        return [f"{self.name}: none up to {bound:g} in {tries_text(self.tries)}"] if self.tries else []

    def short_of(self, at_least: float) -> str:
        """Returns what is wrong with a scenario that fails as recorded, or has a margin below `at_least`."""
        if self.broken:
            return f"as recorded: {self.recorded}, {self.reason}"
        short = self.margin is not None and self.margin < at_least
        return f"margin {self.margin:.2f}, expected at least {at_least:g}" if short else ""


class Margins(_Content):
    """The content of `margins.json`.

    Attributes:
        format: of the file.
        ego, policy: names of what drove.
        bound: distance of a parameter up to which the search looked.
        people: recordings by which distances are measured.
        settings: of the search.
        versions: of the dependencies.
        wall_s: time that the search took [s].
        scenarios: margins, in the order of the suite.
    """

    format: Literal[3] = 3
    ego: str
    policy: str
    bound: float
    people: str
    settings: dict[str, Any]
    versions: dict[str, str]
    wall_s: float
    scenarios: list[Margin]

    def write(self, folder: Path) -> None:
        """Writes `margins.json`.

        Raises:
            Unwritable: that is impossible.
        """
        write_text(folder / MARGINS_FILE, self.model_dump_json(indent=1) + "\n")

    @classmethod
    def read(cls, folder: Path) -> Margins:
        """Reads `margins.json`.

        Raises:
            InputError: there is none, or it is of another format.
        """
        return read_yaml(folder / MARGINS_FILE, cls)


def is_search(path: Path) -> bool:
    """Returns whether `path` is the folder of a finished search."""
    return (path / MARGINS_FILE).is_file()


def write_tried(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Writes a table with a row for each run, and a column for each of what the rows say.

    Raises:
        Unwritable: `path` cannot be written.
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    with replacing(path) as new:
        pq.write_table(pa.table({name: [row.get(name) for row in rows] for name in names}), new)


def write_junit(margins: Margins, at_least: float, path: Path) -> None:
    """Writes the margins as JUnit XML: a test is a scenario, and fails as :meth:`Margin.short_of` says.

    Raises:
        Unwritable: `path` cannot be written.
    """
    document, suite = JUnitXml("margins"), TestSuite(f"{margins.ego}, {margins.policy}")
    for scenario in margins.scenarios:
        test = TestCase(scenario.name, suite.name)
        if text := scenario.short_of(at_least):
            failure = Failure(text, "margin")
            failure.text = "\n".join([text, *(line for f in scenario.failures for line in told(f))])
            test.result = [failure]
        suite.add_testcase(test)
    document.add_testsuite(suite)
    document.update_statistics()
    with replacing(path) as new:
        document.write(str(new))


def told(failure: CriticalChange) -> list[str]:
    """Returns lines that say what is changed in a failure, what happened, and how to run it again."""
    return [f"{failure.distance:.2f}: {'; '.join(failure.changes)}", f"    {failure.reason}", f"    {failure.rerun}"]


@dataclass(frozen=True)
class MarginChange:
    """The change of the margins of the scenarios that two searches have in common, but for those forced as recorded.

    Attributes:
        names: of the scenarios.
        before, after: margins, the bound where no failure is known, 0 where it fails as recorded.
        broken: names of those that fail as recorded, and did not before.
        interval: bounds of the mean change at 95 % by the paired bootstrap; None for fewer than two scenarios.
    """

    names: Sequence[str]
    before: Sequence[float]
    after: Sequence[float]
    broken: Sequence[str]
    interval: tuple[float, float] | None

    @property
    def mean(self) -> float:
        """Mean change, after minus before."""
        return float(np.mean(np.subtract(self.after, self.before)))

    @property
    def worse(self) -> bool:
        """Whether margins have clearly become smaller, or a scenario that passed as recorded does not any more."""
        return bool(self.broken) or (self.interval is not None and self.interval[1] < 0.0)


def compare_margins(before: Margins, after: Margins) -> MarginChange:
    """Compares two searches.

    Raises:
        InputError: they have no scenario in common, or different bounds or people.
    """
    if (before.bound, before.people) != (after.bound, after.people):
        raise InputError(
            f"margins by {before.people} up to {before.bound:g} and by {after.people} up to {after.bound:g}, "
            "expected the same measure"
        )
    ours, theirs = (
        {_case(scenario.name): scenario for scenario in margins.scenarios if scenario.recorded != Outcome.FORCED}
        for margins in (before, after)
    )
    names = [name for name in theirs if name in ours]
    if not names:
        raise InputError("the two searches have no scenario in common")
    was, now = ([_least(scenarios[name], before.bound) for name in names] for scenarios in (ours, theirs))
    broken = [name for name in names if theirs[name].broken and not ours[name].broken]
    interval = paired_interval(np.subtract(now, was), np.arange(len(names)))
    return MarginChange(names, was, now, broken, interval)


def _least(margin: Margin, bound: float) -> float:
    """Returns the margin of a scenario; `bound` if no failure is known, 0 if it fails as recorded."""
    if margin.broken:
        return 0.0
    return bound if margin.margin is None else margin.margin


def _case(name: str) -> str:
    """Returns scenario and vehicle in the name of a case; two versions of a stack may have different names."""
    return "/".join(name.split("/")[:2])
