"""A stack whose timers run on simulation time starts and drives; the clock never goes back or leaps; frames follow."""

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import Run, read_run

STACK = Path(__file__).parent / "programs/timer_ego.py"


def test_a_timer_on_simulation_time_drives(graph: Any) -> None:
    bag, heard = graph.folder / "run", graph.folder / "times.json"
    setup = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "replay", "--real-time-factor", 5)
    done = graph.launch(*setup, "--out", bag, "--", sys.executable, STACK, 0.1, heard)
    lockstep = json.loads((bag / "metrics.json").read_text())["lockstep"]
    assert done.returncode == 0, done.stderr
    assert (lockstep["missed"], lockstep["ego_port"]["answered"]) == (0, 36)
    run = read_run(bag)
    speed = [table.speed[table.row(run.info.ego_id)] for table in run.tables]
    assert speed == pytest.approx(np.full(36, 15.0), abs=0.01)
    recorded = [message.log_time_ns for message in BagReader(bag).messages(["/clock"])]
    assert recorded == [step * 10**8 for step in range(36)]
    told = json.loads(heard.read_text())
    times = np.array(told["times"])
    apart = np.diff(times)
    assert apart.min() >= 0
    assert times[-1] <= 36 * 10**8
    assert apart.max() <= 20_000_000
    assert np.ptp(told["corners"], axis=0) == pytest.approx([4.5, 2.0])
    if find_spec("tf2_msgs"):
        check_frames(told["frames"], run)


def check_frames(frames: list[list[Any]], run: Run) -> None:
    lever = 0.29 * 4.5
    fixed = {(parent, child): x for parent, child, _, x, _ in frames if child != "base_link"}
    assert fixed == {("map", "odom"): 0.0, ("base_link", "ego"): pytest.approx(lever)}
    moving = {stamp // 10**8: (x, y) for parent, _, stamp, x, y in frames if parent == "odom"}
    assert len(moving) > 30
    for step, (x, y) in moving.items():
        table = run.tables[step]
        row = table.row(run.info.ego_id)
        assert (x, y) == (pytest.approx(table.x[row] - lever), pytest.approx(table.y[row]))
