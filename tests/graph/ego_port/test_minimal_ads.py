"""The examples drive the demo's ego, in an environment that knows nothing of LitSim."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from campaigns import scenario_file
from litsim_sim.core.scene import Controller
from litsim_sim.record.run import read_run
from litsim_sim.scenario.scenario import Scenario

ROOT = Path(__file__).parents[3]
EXAMPLES = ROOT / "examples"


def bare_environment() -> dict[str, str]:
    """The environment of ROS 2 alone: whatever lies below a prefix that holds LitSim is taken out of every path."""
    ours = [prefix for prefix in os.environ["AMENT_PREFIX_PATH"].split(":") if Path(prefix).name.startswith("litsim_")]
    roots = {Path(prefix).parents[0] for prefix in ours} | {ROOT / "src", ROOT / "build", ROOT / "install"}
    kept = dict(os.environ)
    for name in ("PYTHONPATH", "AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH"):
        parts = [part for part in os.environ.get(name, "").split(":") if part]
        outside = [
            part for part in parts if "litsim_" not in part and not any(Path(part).is_relative_to(r) for r in roots)
        ]
        kept[name] = ":".join(outside)
    return kept


def test_its_environment_does_not_know_us(tmp_path: Path) -> None:
    names = ["rclpy", "nav_msgs", "litsim_msgs", "litsim_sim", "litsim_policy"]
    script = f"from importlib.util import find_spec; print(*[name for name in {names} if find_spec(name)])"
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, env=bare_environment(), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["rclpy", "nav_msgs"], done.stderr


@pytest.mark.parametrize(
    ("example", "simulation_s", "wanted", "lanes"),
    [
        ("minimal_ads.py", 10.0, 12.0, 1),
        ("lane_changing_ads.py", 25.0, 15.0, 3),
    ],
)
def test_it_drives_the_demo(graph: Any, example: str, simulation_s: float, wanted: float, lanes: int) -> None:
    environment = bare_environment() | {
        "ROS_DOMAIN_ID": str(graph.domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    bag = graph.folder / "run"
    with subprocess.Popen([sys.executable, EXAMPLES / example], env=environment, cwd=graph.folder) as ads:
        try:
            options = ("--ego", "external", "--policy", "litsim", "--out", bag, "--domain-id", graph.domain)
            demo = scenario_file(graph.folder, simulation_s=simulation_s)  # its first seconds
            done = graph.launch("--scenario", demo, *options)
            assert done.returncode == 0, done.stderr
            if example == "minimal_ads.py":
                assert ads.poll() is None, "it waits for another run"
                ads.send_signal(signal.SIGINT)
            assert ads.wait(timeout=120) == 0  # it has heard that the run is over
        finally:
            ads.kill()
    metrics = json.loads((bag / "metrics.json").read_text())
    steps = round(10 * (3.0 + simulation_s))
    assert (metrics["valid"], metrics["steps"]) == (True, steps)
    port = metrics["lockstep"]["ego_port"]
    assert (port["interface"], port["answered"], port["invalid"], port["late"]) == ("twist", steps + 1, 0, 0)
    assert metrics["collision"]["ego_at_fault"] == 0
    run = read_run(bag)
    egos = [table.take(table.id == run.info.ego_id) for table in run.tables[run.info.history_steps :]]
    assert all((ego.controller == Controller.EGO).all() and len(ego) == 1 for ego in egos)
    last, logged = egos[-1], run.log[-1]
    away = logged.x[logged.row(run.info.ego_id)] - last.x[0]
    assert abs(away) > 1.0  # it does not follow the log
    assert max(float(ego.speed[0]) for ego in egos[30:]) <= wanted + 0.2
    lane_map = Scenario.load("demo").lane_map
    driven_in = {int(lane_map.nearest(ego.x, ego.y, ego.yaw).lane[0]) for ego in egos}
    assert len(driven_in) >= lanes
