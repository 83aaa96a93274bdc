"""A run over DDS ends when the ego has left the net, as one in process does, and its record says so."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import resimulate
from litsim_sim.core.stages import EndReason, StageState
from litsim_sim.record.run import read_run
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EGO, SPEED = 1, 15.0
TOTAL = 65


def leaving(graph: Any) -> Path:
    """A scenario whose ego is 36 m before the end of the net, somebody close behind it and somebody far away."""
    cars = [(EGO, 604.0, 30), (2, 596.0, 32), (3, 100.0, 99)]
    parts = []
    for agent, x, last in cars:
        frames = np.arange(last + 1)
        same = {"y": -5.49, "yaw": 0.0, "speed": SPEED, "acceleration": 0.0, "length": 4.5, "width": 2.0}
        same |= {"kind": 0, "lane": -1, "vehicle_id": agent}
        parts.append(pd.DataFrame({"frame": frames, "x": x + 0.1 * SPEED * 0.8 * frames, **same}))
    table = pd.concat(parts, ignore_index=True)
    table["speed"] *= 0.8
    Recording.from_table(RecordingHeader("leaving"), table, "leaving").write(graph.folder / "leaving.parquet")
    return graph.scenario(recording="leaving.parquet", ego=EGO, simulation_s=6.0)


def check(bag: Path) -> int:
    """See that the record is whole and says why it ended; returns its last step."""
    metrics, run = json.loads((bag / "metrics.json").read_text()), read_run(bag)
    assert metrics["valid"], metrics["why"]
    last = metrics["steps"]
    assert last < metrics["total_steps"] == TOTAL
    time_s = pytest.approx(0.1 * last)
    assert metrics["ended"] == {"reason": "net_end", "step": last, "time_s": time_s, "lane": "downstream_3"}
    assert run.ended is not None and run.ended.reason == EndReason.NET_END
    said = {(each.state, each.step) for each in run.statuses if each.stage == "bridge"}
    assert said == {(StageState.ENDING, last), (StageState.FINISHED, last)}
    assert not any(run.gaps.values())
    return last


def test_the_graph_ends_where_a_run_in_process_does(graph: Any) -> None:
    scenario, bag = leaving(graph), graph.folder / "run"
    done = graph.launch("--scenario", scenario, "--ego", "idm", "--policy", "litsim", "--out", bag)
    assert done.returncode == 0, done.stderr
    assert "the ego has left the net at its end" in " ".join(done.stdout.split())
    last = check(bag)
    in_process = compute_metrics(record(RunPlan(Scenario.load(scenario), "idm", "litsim")))
    metrics = json.loads((bag / "metrics.json").read_text())
    assert in_process["steps"] == last
    assert in_process["digest"] == metrics["digest"]
    assert in_process["ended"] == metrics["ended"]
    with open_record(bag) as found:
        again = resimulate(found)
        assert (again.steps, again.recorded, again.computed) == (last + 1, metrics["digest"], metrics["digest"])
        assert not [note for note in found.notes if "the record ends" in note]
