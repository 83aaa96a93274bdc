"""Signals over real DDS: published, recorded, and equal to those of the scenario."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd

from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.scenario import Scenario

GROUPS = {"east": ["WA_0", "WA_1"], "left": ["WA_2"]}
CHANGES = [[0.0, "east", "green"], [0.0, "left", "red"], [1.0, "east", "amber"], [2.0, "east", "red"]]


def test_they_are_published_recorded_and_counted(graph: Any) -> None:
    frame = np.arange(36)
    same = {"yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "length": 4.5, "width": 2.0, "kind": 0, "lane": -1}
    cars = [
        pd.DataFrame({"vehicle_id": number, "frame": frame, "x": -114.6 - 2.25 - to_line + frame, "y": -4.95, **same})
        for number, to_line in ((1, 9.0), (2, 28.0))
    ]
    path = graph.scenario(net="urban_like", ego=2, signals={"groups": GROUPS, "changes": CHANGES})
    Recording.from_table(RecordingHeader("two"), pd.concat(cars), "two").write(graph.folder / "traffic.parquet")
    done = graph.launch("--scenario", path, "--ego", "log", "--policy", "replay", "--out", graph.folder / "run")
    assert done.returncode == 0, done.stderr
    run, wanted = read_run(graph.folder / "run"), Scenario.load(path).signals
    assert run.signals is not None and wanted is not None
    np.testing.assert_array_equal(run.signals.states, wanted.states)
    assert run.signals.groups == wanted.groups
    assert run.signals.link_names == wanted.link_names
    assert run.signals.link_group.tolist() == wanted.link_group.tolist()
    for here, there in zip(run.signals.links, wanted.links, strict=True):
        assert (here.stop.tolist(), here.exit.tolist(), here.width) == (
            there.stop.tolist(),
            there.exit.tolist(),
            there.width,
        )
    metrics = json.loads((graph.folder / "run/metrics.json").read_text())
    assert metrics["valid"], metrics["why"]
    reds = [{"agent": 2, "step": 29, "connection": "WA_1 -> AB_1", "group": "east", "by": "ego"}]
    assert metrics["signals"] == {"passed": 2, "red_ego": 1, "red_controlled": 0, "red_log": 1, "reds": reds}
    topics = BagReader(graph.folder / "run").topics
    assert "transient_local" in topics["/litsim/signals/map"].qos_yaml
    assert "transient_local" not in topics["/litsim/signals"].qos_yaml
