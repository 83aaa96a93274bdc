"""The suite of jams: its scenarios can be run, and traffic stands behind what is in its way."""

from pathlib import Path

import pytest

from documentation import ROOT
from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.suite import Suite
from litsim_sim.scenario.scenario import Scenario
from programs import program

jam_suite = program("benchmarks/jam/suite.py")


def test_traffic_stands_behind_accident_closed_lane_and_red_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sumo", reason="netconvert is not installed (requirements/maps.txt)")
    monkeypatch.setattr(jam_suite, "FOLDER", tmp_path / "jams")
    jam_suite.main()
    (tmp_path / "jams.yaml").write_text((ROOT / "examples/suites/jams.yaml").read_text())
    assert len(cases_of(Suite.load(tmp_path / "jams.yaml"))) == 36
    for name, standing in jam_suite.SITUATIONS.items():
        scenario = Scenario.load(tmp_path / f"jams/{name}.yaml")
        table = scenario.recording.table
        last = table[table.frame == table.frame.max()]
        still = last[(last.speed < 0.1) & (last.vehicle_id <= jam_suite.COLUMN * jam_suite.LANES)]
        assert set(still.lane - 1) == set(standing or range(jam_suite.LANES))
        line = jam_suite.STANDING if standing else jam_suite.STOP_LINE
        assert (still.x + 0.5 * jam_suite.SIZE[0]).max() < line
        assert (scenario.signals is None) == bool(standing)
