"""Pedestrians and cyclists in a run over real DDS: the same as in process, and always on their log."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.runner import Runner, record
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from walkers import CYCLIST, PEDESTRIAN, walking_scenario


def test_the_graph_and_the_runner_agree(graph: Any) -> None:
    scenario = walking_scenario(graph.folder, frames=91, history_s=3.0, simulation_s=6.0)
    done = graph.launch("--scenario", scenario, "--ego", "idm", "--out", graph.folder / "run")
    assert done.returncode == 0, done.stderr
    metrics = json.loads((graph.folder / "run/metrics.json").read_text())
    assert metrics["valid"], metrics["why"]
    loaded = Scenario.load(scenario)
    in_process = compute_metrics(record(Runner(RunPlan(loaded, "idm", "litsim"))))
    assert metrics["digest"] == in_process["digest"] and metrics["collision"] == in_process["collision"]
    assert metrics["collision"]["by_kind"]["pedestrian"] == 1, "the embedded traffic knows nothing of them"
    run = read_run(graph.folder / "run")
    for agent, kind in ((PEDESTRIAN, Kind.PEDESTRIAN), (CYCLIST, Kind.BICYCLE)):
        row = loaded.log.row(agent)
        for table in run.tables:
            at = table.row(agent)
            assert (table.kind[at], table.controller[at]) == (kind, Controller.LOG)
            np.testing.assert_array_equal(
                (table.x[at], table.y[at]), (loaded.log.x[row, table.step], loaded.log.y[row, table.step])
            )
