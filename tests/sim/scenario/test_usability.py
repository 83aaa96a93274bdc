"""Which scenarios can be loaded, and what is said of the others."""

from pathlib import Path

import pytest
import yaml

from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.load import load_recording
from litsim_sim.scenario.scenario import Scenario, Sources, packaged
from litsim_sim.scenario.usability import Usability, describe, survey

RECORDING = packaged("scenarios/us101_like.parquet")
NET = packaged("nets/us101_like.net.xml")


def scenario(folder: Path, name: str, **fields: object) -> Path:
    given = {"name": name, "recording": str(RECORDING), "net": "us101_like", "ego": 7, "simulation_s": 5.0, **fields}
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(given))
    return path


@pytest.mark.parametrize("in_memory", [True, False])
def test_what_scenarios_lack(tmp_path: Path, in_memory: bool) -> None:
    paths = [
        scenario(tmp_path, "sound"),
        scenario(tmp_path, "stranger", ego=987654),
        scenario(tmp_path, "late", start_frame=10**6),
        scenario(tmp_path, "field", roi_m=-1.0),
    ]
    sources = Sources(load_recording(RECORDING), LaneMap.from_net(NET)) if in_memory else None
    found = survey(paths, [sources] * len(paths))
    assert [each.lacks for each in found] == ["", "ego", "length", "files"]
    assert found[0].coverage == Scenario.load(paths[0]).coverage > 0.99
    assert "no vehicle 987654" in found[1].why and "start_frame is 1000000" in found[2].why
    assert "roi_m" in found[3].why
    lines = describe(found).splitlines()
    assert lines[0] == "1 of 4 scenarios can be loaded; 100.0% to 100.0% of the box centres on lanes"
    assert lines[1:4] == ["1 cannot for their ego", "1 cannot for their length", "1 cannot for their files"]
    assert [line.strip() for line in lines[4:]] == [each.why for each in found[1:]]


def test_many_that_cannot_be_loaded_are_counted() -> None:
    text = describe([Usability(f"{n}.yaml", "coverage", f"scenario {n}") for n in range(12)])
    assert text.splitlines()[:2] == ["0 of 12 scenarios can be loaded", "12 cannot for their coverage"]
    assert "scenario 9" in text and "scenario 10" not in text and text.endswith("and 2 more")
