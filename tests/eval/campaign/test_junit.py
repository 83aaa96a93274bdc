"""JUnit XML of a campaign, read back with a parser that has not written it, and with that of the standard library."""

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from junit2htmlreport.parser import Junit

from campaigns import CRITERIA, EGO, VERSIONS, cases, metrics, suite
from litsim_eval.campaign.folder import CampaignFolder
from litsim_eval.campaign.junit import write_junit
from litsim_eval.campaign.results import Campaign, RunResult, read_campaign, rerun_command


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """Of five cases one passes, one fails, one could not be judged, one has not been run, and one passes again."""
    made = cases(policies=["litsim"], seeds=[1, 2, 3, 4]) + cases(policies=["replay"], seeds=[1])
    folder = CampaignFolder(tmp_path)
    folder.begin(suite(name="night & day"), made, VERSIONS)
    folder.store(RunResult.judged(made[0], metrics(), CRITERIA, wall_s=1.25))
    folder.store(RunResult.judged(made[1], metrics(at_fault=2), CRITERIA, wall_s=2.0, report="report.html"))
    folder.store(RunResult.error(made[2], 'the stack said "\x1b[31m<no>\x1b[0m"', log="ads.log", wall_s=0.5))
    folder.store(RunResult.judged(made[4], metrics(), CRITERIA, wall_s=1.0))
    return read_campaign(tmp_path)


def test_another_reader_finds_every_case_and_why_it_did_not_pass(campaign: Campaign, tmp_path: Path) -> None:
    path = tmp_path / "junit.xml"
    write_junit(campaign, path)
    read = Junit(str(path))
    assert [found.name for found in read.suites] == ["idm, litsim", "idm, replay", "campaign night & day"]
    tests = {(test.testclass.name, test.name): test for found in read.suites for test in found.all()}
    assert {name for name in tests if not name[0].startswith("campaign")} == {
        (c.variant, c.name) for c in campaign.cases
    }

    passed, failed, error, gap = (tests["idm, litsim", f"demo/{EGO}/idm/litsim/{seed}"] for seed in (1, 2, 3, 4))
    assert not passed.failed() and passed.duration == 1.25
    reason = "no contact at fault: collision.ego_at_fault is 2, expected at most 0"
    assert failed.failure_msg == reason
    again = [f"run it again: {rerun_command(campaign.folder, case)}" for case in campaign.cases]
    assert failed.failure == f"{reason}\nreport: runs/{campaign.cases[1].id}/report.html\n{again[1]}"
    assert error.failure == f'the stack said "[31m<no>[0m"\nlog: runs/{campaign.cases[2].id}/ads.log\n{again[2]}'
    assert gap.failure == "it has not been run"
    whole = tests["campaign night & day", "all runs pass"]
    assert whole.failure == "passed_share is 0.4, expected at least 1"


def test_variants_are_in_the_order_of_the_table(tmp_path: Path) -> None:
    asked = {"policies": ["replay", "litsim"], "egos": ["log", "bat"], "seeds": [1, 2]}
    CampaignFolder(tmp_path).begin(suite(**asked), cases(**asked), VERSIONS)
    campaign = read_campaign(tmp_path)
    write_junit(campaign, tmp_path / "junit.xml")
    found = [each.attrib["name"] for each in ET.parse(tmp_path / "junit.xml").getroot()]
    assert found == [*campaign.variants, "campaign some"] and found[:2] == ["log, replay", "log, litsim"]


def test_counts_and_times_of_suites_and_kinds_of_failures(campaign: Campaign, tmp_path: Path) -> None:
    path = tmp_path / "junit.xml"
    write_junit(campaign, path)
    root = ET.parse(path).getroot()
    litsim, replay, whole = root

    def counts(element: ET.Element) -> list[str]:
        return [element.attrib[name] for name in ("tests", "failures", "errors", "skipped", "time")]

    assert counts(litsim) == ["4", "1", "2", "0", "3.75"]
    assert counts(replay) == ["1", "0", "0", "0", "1.0"]
    assert counts(whole) == ["2", "2", "0", "0", "0.0"]
    assert counts(root) == ["7", "3", "2", "0", "4.75"]
    kinds = [(child.tag, child.get("type")) for test in litsim.iter("testcase") for child in test]
    assert kinds == [("failure", "criterion"), ("error", "not judged"), ("error", "not run")]
    assert all("time" in test.attrib for test in root.iter("testcase"))
    names = [(test.get("classname"), test.get("name")) for test in root.iter("testcase")]
    assert len(set(names)) == len(names)
    assert litsim.get("timestamp") == campaign.begun_at
    assert {each.get("name"): each.get("value") for each in litsim.iter("property")} == VERSIONS
