"""Margins: what a search leaves, as files, and the comparison of two searches."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from junitparser import Failure, JUnitXml, TestCase, TestSuite

from litsim_eval.campaign.comparison import paired_interval
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import replacing

FORMAT = 1
MARGINS_FILE, TABLE_FILE, PAGE_FILE, JUNIT_FILE = "margins.json", "tried.parquet", "margins.html", "junit.xml"
FAILURES_FILE = "failures.yaml"


@dataclass(frozen=True)
class CriticalChange:
    """The nearest failure of a group, shrunk and repeated.

    Attributes:
        name: of its scenario in `scenarios/`.
        act: kind of what an agent does.
        distance: from reality, in standard deviations.
        distances: the same by parameter.
        changes: what is changed, as sentences.
        reason: what happened.
        holds: whether it failed likewise when it was repeated.
        same_digest: whether the repeated run was equal bit by bit; None without a digest.
        careful_driver: whether the careful driver avoids the first contact; None without a contact.
        digest: of the run.
        rerun: command that runs it again, with a report.
    """

    name: str
    act: str
    distance: float
    distances: Mapping[str, float]
    changes: Sequence[str]
    reason: str
    holds: bool
    same_digest: bool | None
    careful_driver: bool | None
    digest: str
    rerun: str


@dataclass(frozen=True)
class Margin:
    """What a search has learnt of one scenario.

    Attributes:
        name: of the case as recorded.
        margin: least distance of a failure that counts, an upper bound; 0 if it fails as recorded, None if none failed.
        recorded: why it fails as recorded; empty if it does not.
        runs, failed, forced, errors: numbers of runs, those for shrinking included.
        drawn, drawn_failed: numbers of runs that were drawn from the declared distribution.
        rate: bounds of the share of these that fail at 95 %, by Clopper and Pearson (1934); None without any.
        by_act: least distance of a failure by kind of act.
        failures: the nearest failure of each group, the nearest first.
    """

    name: str
    margin: float | None
    recorded: str
    runs: int
    failed: int
    forced: int
    errors: int
    drawn: int
    drawn_failed: int
    rate: tuple[float, float] | None
    by_act: Mapping[str, float]
    failures: Sequence[CriticalChange]


@dataclass(frozen=True)
class Margins:
    """The content of `margins.json`.

    Attributes:
        ego, policy: names of what drove.
        bound: distance of a parameter up to which the search looked.
        people: recordings by which distances are measured.
        settings: of the search.
        versions: of the dependencies.
        wall_s: time that the search took [s].
        scenarios: margins, in the order of the suite.
    """

    ego: str
    policy: str
    bound: float
    people: str
    settings: Mapping[str, Any]
    versions: Mapping[str, str]
    wall_s: float
    scenarios: Sequence[Margin]

    @property
    def median(self) -> float:
        """Median margin [standard deviations]; scenarios without failure count with the bound."""
        return float(np.median([self.of(each) for each in self.scenarios]))

    def of(self, margin: Margin) -> float:
        """Returns the margin of a scenario; the bound if no failure is known."""
        return self.bound if margin.margin is None else margin.margin

    def write(self, folder: Path) -> None:
        """Writes `margins.json`.

        Raises:
            Unwritable: that is impossible.
        """
        with replacing(folder / MARGINS_FILE) as new:
            text = json.dumps({"format": FORMAT, **asdict(self)}, indent=1, allow_nan=False, ensure_ascii=False)
            new.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def read(cls, folder: Path) -> Margins:
        """Reads `margins.json`.

        Raises:
            InputError: there is none, or it is of another format.
        """
        path = folder / MARGINS_FILE
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
            written = values.pop("format")
            scenarios = [
                Margin(**{**each, "failures": [CriticalChange(**failure) for failure in each["failures"]]})
                for each in values.pop("scenarios")
            ]
            margins = cls(scenarios=scenarios, **values)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path}: not the margins of a search: {error}") from error
        if written != FORMAT:
            raise InputError(f"{path}: format {written}, expected {FORMAT}")
        return margins


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
    """Writes the margins as JUnit XML: a test is a scenario, and fails if its margin is below `at_least`, or 0.

    Raises:
        Unwritable: `path` cannot be written.
    """
    document, suite = JUnitXml("margins"), TestSuite(f"{margins.ego}, {margins.policy}")
    for each in margins.scenarios:
        test = TestCase(each.name, suite.name)
        if is_short(each, at_least):
            text = f"margin {each.margin:.2f}, expected at least {at_least:g}"
            failure = Failure(text, "margin")
            failure.text = "\n".join([text, each.recorded, *(line for f in each.failures for line in told(f))]).strip()
            test.result = [failure]
        suite.add_testcase(test)
    document.add_testsuite(suite)
    document.update_statistics()
    with replacing(path) as new:
        document.write(str(new))


def is_short(margin: Margin, at_least: float) -> bool:
    """Returns whether a scenario fails as recorded, or has a margin below `at_least`."""
    return margin.margin is not None and (bool(margin.recorded) or margin.margin < at_least)


def told(failure: CriticalChange) -> list[str]:
    """Returns lines that say what is changed in a failure, what happened, and how to run it again."""
    return [f"{failure.distance:.2f}: {'; '.join(failure.changes)}", f"    {failure.reason}", f"    {failure.rerun}"]


@dataclass(frozen=True)
class MarginChange:
    """The change of the margins of the scenarios that two searches have in common.

    Attributes:
        names: of the scenarios.
        before, after: margins, the bound where no failure is known.
        interval: bounds of the mean change at 95 % by the paired bootstrap; None for fewer than two scenarios.
    """

    names: Sequence[str]
    before: Sequence[float]
    after: Sequence[float]
    interval: tuple[float, float] | None

    @property
    def mean(self) -> float:
        """Mean change, after minus before."""
        return float(np.mean(np.subtract(self.after, self.before)))

    @property
    def worse(self) -> bool:
        """Whether margins have clearly become smaller, or a scenario that passed as recorded does not any more."""
        newly = any(b > 0.0 >= a for b, a in zip(self.before, self.after, strict=True))
        return newly or (self.interval is not None and self.interval[1] < 0.0)


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
    ours, theirs = ({_case(each.name): each for each in one.scenarios} for one in (before, after))
    names = [name for name in theirs if name in ours]
    if not names:
        raise InputError("the two searches have no scenario in common")
    was, now = [before.of(ours[name]) for name in names], [after.of(theirs[name]) for name in names]
    interval = paired_interval(np.subtract(now, was), np.arange(len(names)))
    return MarginChange(names, was, now, interval)


def _case(name: str) -> str:
    """Returns scenario and vehicle in the name of a case; two versions of a stack may have different names."""
    return "/".join(name.split("/")[:2])
