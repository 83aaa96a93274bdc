"""Tests of the plug-ins, in the way in which a package of your own can test its own: pytest examples/extension."""

import json
from pathlib import Path

import pandas as pd
import pytest

from litsim import Scenario, Simulation, Step
from litsim_data.exports.export import Content, format_of
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.launch.adapters import adapter_of
from litsim_sim.scenario.policies import setup_of


def run(**ego: float) -> list[Step]:
    """Returns the steps of the demo, driven by `cruise` with these parameters, and forecast by `straight_on`."""
    parameters = {"ego": ego, "predictor": {"model": "straight_on"}}
    return list(Simulation(Scenario.load("demo"), "cruise", "litsim", parameters).steps())


def test_cruise_holds_its_speed_and_others_make_way() -> None:
    steps = run(**{"cruise.speed": 5.0})
    assert steps[-1].table.speed[steps[-1].table.of_ego] == pytest.approx(5.0, abs=0.1)
    assert any(step.table.of_policy.any() for step in steps)


def test_a_speed_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match=r"cruise.speed is -1, expected a number of more than 0 \[m/s\]"):
        run(**{"cruise.speed": -1})


def test_cautious_agents_keep_two_seconds() -> None:
    assert setup_of("cautious").stage_parameters()["policy"] == {"follower.headway": 2.0}


def test_centre_lines_become_a_net(tmp_path: Path) -> None:
    table = pd.DataFrame({"lane": [1, 1], "x": [0.0, 100.0], "y": [0.0, 0.0]})
    table.to_csv(tmp_path / "map.csv", index=False)
    plugins.load(plugins.MAPS, "centre_lines")().write_net(tmp_path / "map.csv", None, tmp_path / "map.net.xml")
    assert "100.00" in (tmp_path / "map.net.xml").read_text()


def test_lines_are_rows(tmp_path: Path) -> None:
    rows = pd.DataFrame({"vehicle_id": [7, 7], "frame": [0, 1], "x": [0.0, 1.0]})
    out = tmp_path / "rows.jsonl"
    format_of(out).write(Content("rows", tmp_path, rows), out)
    assert [json.loads(line)["x"] for line in out.read_text().splitlines()] == [0.0, 1.0]


def test_the_adapter_starts_the_stack_with_our_profile() -> None:
    adapter = adapter_of("our_autoware")
    assert adapter is not None
    assert adapter.command(["./start.sh"])[1:] == ["--profile", "our_profile.yaml", "--", "./start.sh"]
