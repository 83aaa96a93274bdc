"""The verdicts of a campaign as JUnit XML, which CI servers show."""

from __future__ import annotations

import re
from pathlib import Path

from junitparser import Error, Failure, JUnitXml, TestCase, TestSuite

from litsim_eval.campaign.case import Case
from litsim_eval.campaign.criteria import CriterionResult, Verdict
from litsim_eval.campaign.results import RUNS_FOLDER, Campaign, RunResult, rerun_command
from litsim_sim.io.files import replacing

JUNIT_FILE = "junit.xml"
NOT_RUN = "it has not been run"
TYPE_OF_FAILURE, TYPE_OF_ERROR, TYPE_OF_GAP = "criterion", "not judged", "not run"

_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_junit(campaign: Campaign, path: Path) -> None:
    """Writes the verdicts of `campaign` to `path`.

    A test suite is a variant, a test one of its cases; a criterion that is not met is a failure, a run that could not
    be judged or was not run an error. The last test suite holds the criteria of the campaign as a whole.

    Raises:
        Unwritable: `path` cannot be written.
    """
    document = JUnitXml(_clean(campaign.name))
    results = {result.case.id: result for result in campaign.results}
    variants: dict[str, list[Case]] = {}  # in the order of the table
    for case in campaign.cases:
        variants.setdefault(case.variant, []).append(case)
    for variant, cases in variants.items():
        document.add_testsuite(
            _suite(variant, campaign, [_run(case, results.get(case.id), campaign.folder) for case in cases])
        )
    whole = f"campaign {campaign.name}"
    document.add_testsuite(_suite(whole, campaign, [_criterion(judged, whole) for judged in campaign.judged]))
    document.update_statistics()
    with replacing(path) as new:
        document.write(str(new))


def _suite(name: str, campaign: Campaign, tests: list[TestCase]) -> TestSuite:
    suite = TestSuite(_clean(name))
    suite.timestamp = campaign.begun_at
    for package, version in campaign.versions.items():
        suite.add_property(package, _clean(version))
    suite.add_testcases(tests)
    return suite


def _run(case: Case, result: RunResult | None, campaign: Path) -> TestCase:
    again = f"run it again: {rerun_command(campaign, case)}"
    test = TestCase(_clean(case.name), _clean(case.variant))
    test.time = 0.0 if result is None or result.wall_s is None else round(result.wall_s, 3)
    if result is None:
        test.result = [_with_text(Error(NOT_RUN, TYPE_OF_GAP), NOT_RUN)]
    elif result.verdict == Verdict.FAILED:
        faults = [criterion.reason for criterion in result.criteria if not criterion.passed]
        text = "\n".join([*faults, *_files(result), again])
        test.result = [_with_text(Failure(_clean(faults[0]), TYPE_OF_FAILURE), text)]
    elif result.verdict == Verdict.ERROR:
        text = "\n".join([result.reason, *_files(result), again])
        test.result = [_with_text(Error(_clean(result.reason), TYPE_OF_ERROR), text)]
    return test


def _criterion(criterion: CriterionResult, of: str) -> TestCase:
    test = TestCase(_clean(criterion.name), _clean(of), 0.0)
    if not criterion.passed:
        test.result = [_with_text(Failure(_clean(criterion.reason), TYPE_OF_FAILURE), criterion.reason)]
    return test


def _files(result: RunResult) -> list[str]:
    """Returns files with details of a run, relative to the folder of the campaign."""
    folder = f"{RUNS_FOLDER}/{result.case.id}"
    return [f"{what}: {folder}/{name}" for what, name in (("report", result.report), ("log", result.log)) if name]


def _with_text(element: Failure | Error, text: str) -> Failure | Error:
    element.text = _clean(text)
    return element


def _clean(text: str) -> str:
    """Returns `text` without the control characters that XML cannot hold, as logs of stacks have them."""
    return _NO_XML.sub("", text)
