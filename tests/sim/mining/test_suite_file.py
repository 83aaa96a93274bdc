"""Which scenarios are searched, and the file that comes of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from litsim_sim.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.mining.events import Event, EventKind
from litsim_sim.mining.selection import Chosen
from litsim_sim.mining.suite_file import scenario_names, suite_fields, write_suite
from litsim_sim.scenario.scenario import Scenario, packaged

SMALL = packaged("suites/small.yaml")


def chosen(scenario: str) -> Chosen:
    event = Event(EventKind.CUT_IN, 7, 8, 40, 45, 50, 0.5, {"ttc_s": 2.0, "headway_s": None})
    return Chosen(scenario, 7, (EventKind.CUT_IN,), (event,))


def test_folders_of_segments_are_their_scenarios_once_each() -> None:
    folder = packaged("suites/small")
    names = scenario_names(["demo", str(folder), str(folder / "street_train_00.yaml"), "demo"])
    assert names[0] == "demo"
    assert set(names[1:]) == {str(path) for path in folder.glob("*.yaml") if path.name != "manifest.yaml"}
    assert len(names) == len(set(names))


def test_a_folder_without_manifest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no manifest\.yaml"):
        scenario_names([str(tmp_path)])


def test_a_written_suite_reads_back_with_its_events(tmp_path: Path) -> None:
    scenario = tmp_path / "windows" / "a.yaml"
    values = suite_fields([chosen("demo"), chosen(str(scenario))], tmp_path, name="s", egos=["idm"])
    assert values["cases"][1]["scenario"] == "windows/a.yaml"
    write_suite(tmp_path / "s.yaml", values)
    suite = Suite.load(tmp_path / "s.yaml")
    assert [(case.scenario, case.ego_id, case.tags) for case in suite.cases] == [
        ("demo", 7, ["cut_in"]),
        (str(scenario), 7, ["cut_in"]),
    ]
    assert suite.cases[0].events[0]["ttc_s"] == 2.0
    assert suite.cases[0].events[0]["headway_s"] is None


def test_an_empty_suite_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to write"):
        write_suite(tmp_path / "s.yaml", suite_fields([], tmp_path, name="s", egos=["idm"]))
    assert list(tmp_path.iterdir()) == []


def test_the_packaged_suite_has_forty_cases_of_every_kind_whose_egos_are_there() -> None:
    suite = Suite.load(SMALL)
    assert len({(case.scenario, case.ego_id) for case in suite.cases}) == 40
    tags = {tag for case in suite.cases for tag in case.tags}
    assert tags >= {"cut_in", "hard_braking", "leader_braking", "lane_change", "merge", "crossing", "left_turn"}
    for name in sorted({case.scenario for case in suite.cases}):
        egos = Scenario.load(name).possible_egos
        assert {case.ego_id for case in suite.cases if case.scenario == name} <= set(egos)
