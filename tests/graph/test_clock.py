"""A stack whose timers run on simulation time starts and drives; the clock never goes back, stands or leaps."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run

STACK = Path(__file__).parent / "timer_ego.py"


@pytest.mark.parametrize(
    ("mode", "period_s", "options"),
    [("lockstep", 0.1, ("--real-time-factor", 5)), ("lockstep", 0.03, ()), ("realtime", 0.03, ())],
)
def test_a_timer_on_simulation_time_drives(graph: Any, mode: str, period_s: float, options: tuple[object, ...]) -> None:
    bag, heard = graph.folder / "run", graph.folder / "times.json"
    stack = ("--", sys.executable, STACK, period_s, heard)
    setup = ("--scenario", graph.scenario(), "--ego", "external", "--policy", "replay", "--mode", mode, *options)
    done = graph.launch(*setup, "--out", bag, *stack)
    lockstep = json.loads((bag / "metrics.json").read_text())["lockstep"]
    if mode == "lockstep":
        assert done.returncode == 0, done.stderr
        assert (lockstep["missed"], lockstep["ego_port"]["answered"]) == (0, 36)
    run = read_run(bag)
    speed = [table.speed[table.row(run.info.ego_id)] for table in run.tables]
    assert speed == pytest.approx(np.full(36, 15.0), abs=0.01)
    recorded = [message.log_time_ns for message in BagReader(bag).messages(["/clock"])]
    assert recorded == [step * 10**8 for step in range(36)]
    times = np.array(json.loads(heard.read_text()))
    apart = np.diff(times)
    assert apart.min() >= 0
    assert times[-1] <= 36 * 10**8
    assert apart.max() <= 20_000_000
