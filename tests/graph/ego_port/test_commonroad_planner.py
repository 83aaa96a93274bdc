"""A planner that is not ours drives the demo's ego through the port, from an environment that does not know us."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from campaigns import scenario_file

EXAMPLE = Path(__file__).parents[3] / "examples/commonroad_planner"
PYTHON = EXAMPLE / ".venv/bin/python"
STEPS = 80  # of 3 s of history and 5 s of simulation

pytestmark = pytest.mark.skipif(
    not (EXAMPLE / ".venv/.made-from").is_file(),
    reason="the planner's environment is not there; make it: examples/commonroad_planner/setup.sh",
)


def test_its_environment_does_not_know_us(tmp_path: Path) -> None:
    unknown = "import importlib.util as u, sys; sys.exit(any(map(u.find_spec, ('litsim_msgs', 'litsim_sim'))))"
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "LD_LIBRARY_PATH", "AMENT_PREFIX_PATH")}
    subprocess.run([PYTHON, "-c", unknown], env=clean, cwd=tmp_path, check=True)


def test_it_drives_the_demo(graph: Any) -> None:
    figures, bag = graph.folder / "figures.json", graph.folder / "run"
    environment = os.environ | {"ROS_DOMAIN_ID": str(graph.domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command = [str(EXAMPLE / "run.sh"), "--ros-args", "-p", f"figures:={figures}"]
    with subprocess.Popen(command, env=environment, cwd=graph.folder) as planner:
        try:
            options = ("--ego", "external", "--policy", "litsim", "--answer-timeout", 60, "--domain-id", graph.domain)
            demo = scenario_file(graph.folder, "demo", simulation_s=5.0)  # its first seconds
            done = graph.launch("--scenario", demo, "--out", bag, *options)
            assert done.returncode == 0, done.stderr
            assert planner.wait(timeout=120) == 0  # it has heard that the run is over
        finally:
            planner.kill()
    metrics = json.loads((bag / "metrics.json").read_text())
    assert (metrics["valid"], metrics["steps"]) == (True, STEPS)
    port = metrics["lockstep"]["ego_port"]
    assert (port["interface"], port["answered"], port["invalid"]) == ("trajectory", STEPS + 1, 0)
    told = json.loads(figures.read_text())
    assert (told["steps"], told["plans"], told["without_solution"]) == (STEPS + 1, STEPS + 1, 0)
    assert metrics["collision"]["ego_contacts"] == []
    assert metrics["ego_motion"]["off_road"] == 0.0
    assert metrics["ade_ego_m"]["5"] > 0.1  # it does not follow the log
