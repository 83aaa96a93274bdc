"""The examples for Ackermann steering and for nav2 let a stack drive that knows nothing of LitSim."""

import shlex
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from litsim_sim.record.run import read_run

HERE = Path(__file__).parents[1]
EXAMPLES = HERE.parents[1] / "examples"


@pytest.mark.parametrize(
    ("example", "needed", "mode", "options"),
    [
        ("ackermann_bridge.py", "ackermann_msgs", "ackermann", ()),
        ("nav2_bridge.py", "tf2_msgs", "nav2", ("--set", "bridge.clock=false")),
    ],
)
def test_it_drives(graph: Any, example: str, needed: str, mode: str, options: tuple[str, ...]) -> None:
    if not find_spec(needed):
        pytest.skip(f"{needed} is not built (tools/interfaces.sh)")
    stack = shlex.join([sys.executable, str(HERE / "programs/drive_by.py"), mode])
    script = f"{stack} & exec {shlex.join([sys.executable, str(EXAMPLES / example)])}"
    setup = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "replay", "--out", graph.folder / "run")
    done = graph.launch(*setup, *options, "--", "sh", "-c", script)
    assert done.returncode == 0, done.stderr + (graph.folder / "run/log/ads.log").read_text()
    assert not graph.running()
    run = read_run(graph.folder / "run")
    speed = [float(table.speed[table.row(run.info.ego_id)]) for table in run.tables]
    assert speed[-1] == pytest.approx(14.0, abs=0.1)
