"""The suite of jams: its scenarios can be run, and traffic stands behind what is in its way."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import pytest

from litsim_eval.campaign.case import cases_of
from litsim_eval.campaign.suite import Suite
from litsim_sim.scenario.scenario import Scenario

ROOT = Path(__file__).parents[3]
spec = spec_from_file_location("jam_suite", ROOT / "benchmarks/jam/suite.py")
assert spec is not None and spec.loader is not None
program = module_from_spec(spec)
spec.loader.exec_module(program)


def test_traffic_stands_behind_accident_closed_lane_and_red_light(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("sumo", reason="netconvert is not installed (requirements/maps.txt)")
    monkeypatch.setattr(program, "FOLDER", tmp_path / "jams")
    program.main()
    (tmp_path / "jams.yaml").write_text((ROOT / "examples/suites/jams.yaml").read_text())
    assert len(cases_of(Suite.load(tmp_path / "jams.yaml"))) == 36
    for name, standing in program.SITUATIONS.items():
        scenario = Scenario.load(tmp_path / f"jams/{name}.yaml")
        table = scenario.recording.table
        last = table[table.frame == table.frame.max()]
        still = last[(last.speed < 0.1) & (last.vehicle_id <= program.COLUMN * program.LANES)]
        assert set(still.lane - 1) == set(standing or range(program.LANES))
        line = program.STANDING if standing else program.STOP_LINE
        assert (still.x + 0.5 * program.SIZE[0]).max() < line
        assert (scenario.signals is None) == bool(standing)
