"""Which scenarios are searched, and the file that comes of it."""

from pathlib import Path

import pytest

from litsim_data import segments
from litsim_data.mining.events import Event, EventKind
from litsim_data.mining.mine import mine
from litsim_data.mining.selection import Chosen
from litsim_data.mining.suite_file import scenario_names, write_suite
from litsim_eval.campaign.suite import Suite
from litsim_sim.core.errors import InputError
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import Scenario, packaged

SMALL = packaged("suites/small.yaml", "litsim_eval")


def chosen(scenario: str) -> Chosen:
    event = Event(EventKind.CUT_IN, 7, 8, 40, 45, 50, 0.5, {"ttc_s": 2.0, "headway_s": None})
    return Chosen(scenario, 7, (EventKind.CUT_IN,), (event,))


def test_folders_of_segments_are_their_scenarios_once_each(tmp_path: Path) -> None:
    recording = Recording.read(packaged("scenarios/us101_like.parquet"))
    settings = segments.Settings(simulation_s=10.0, stride_s=7.0, split=(1.0, 0.0, 0.0))
    segments.write(segments.cut([("us101_like.parquet", "us101_like", None, recording)], settings), tmp_path)
    some = [str(tmp_path / f"us101_like_train_0{number}.yaml") for number in range(3)]
    assert scenario_names(["demo", str(tmp_path), some[1], "demo"]) == ["demo", *some]


def test_a_folder_without_manifest_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no manifest\.yaml"):
        scenario_names([str(tmp_path)])


def test_a_written_suite_reads_back_with_its_events(tmp_path: Path) -> None:
    scenario = tmp_path / "windows" / "a.yaml"
    write_suite(tmp_path / "s.yaml", [chosen("demo"), chosen(str(scenario))], "s", ["idm"])
    assert "scenario: windows/a.yaml" in (tmp_path / "s.yaml").read_text()
    suite = Suite.load(tmp_path / "s.yaml")
    assert [(case.scenario, case.ego_id, case.tags) for case in suite.cases] == [
        ("demo", 7, ["cut_in"]),
        (str(scenario), 7, ["cut_in"]),
    ]
    assert suite.cases[0].events[0]["ttc_s"] == 2.0
    assert suite.cases[0].events[0]["headway_s"] is None


def test_an_empty_suite_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing to write"):
        write_suite(tmp_path / "s.yaml", [], "s", ["idm"])
    assert list(tmp_path.iterdir()) == []


def test_the_packaged_suite_has_forty_cases_of_every_kind_with_what_is_found_in_them() -> None:
    suite = Suite.load(SMALL)
    assert len({(case.scenario, case.ego_id) for case in suite.cases}) == 40
    tags = {tag for case in suite.cases for tag in case.tags}
    assert tags >= {"cut_in", "hard_braking", "leader_braking", "lane_change", "merge", "crossing", "left_turn"}
    for name in sorted({case.scenario for case in suite.cases}):
        found = mine(Scenario.load(name))
        for case in suite.cases:
            entries = [event.entry() for event in found if event.ego == case.ego_id]
            assert case.scenario != name or all(event in entries for event in case.events)
