"""Acts that wait for the ego, over real DDS: they begin and end as in one process."""

import json
from typing import Any

import numpy as np
import yaml

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_sim.core.scene import Controller, Kind
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

EGO, LEADER, WALKER = 1, 2, 3
CHANGES = [
    {"kind": "brake", "agent": LEADER, "begin_s": 1.0, "duration_s": 1.0, "deceleration": 3.0, "headway_s": [0.5, 2.3]},
    {"kind": "cross", "agent": WALKER, "begin_s": 1.0, "speed": 1.4, "headway_s": [0.0, 4.0]},
]


def test_acts_begin_where_the_ego_is_over_dds_as_in_one_process(
    graph: Any, make_scenario: Any, track: Any, lane_centres: Any
) -> None:
    walker = {"y": lane_centres[1] - 7.0, "yaw": np.pi / 2, "speed": 0.0, "length": 0.6, "kind": Kind.PEDESTRIAN}
    made = make_scenario(
        track(EGO, x=100.0, speed=12.0), track(LEADER, x=140.0), track(WALKER, x=200.0, **walker), changes=CHANGES
    )
    path, bag = graph.folder / "acts.yaml", graph.folder / "acted"
    path.write_text(yaml.safe_dump(yaml.safe_load(made.to_yaml())))
    done = graph.launch("--scenario", path, "--ego", "log", "--policy", "replay", "--out", bag)
    assert done.returncode == 0, done.stderr
    recorded = json.loads((bag / "metrics.json").read_text())["digest"]
    assert recorded == compute_metrics(record(RunPlan(Scenario.load(path), "log", "replay")))["digest"]
    acting = {
        agent: [table.step for table in read_run(bag).tables if table.controller[table.row(agent)] == Controller.POLICY]
        for agent in (LEADER, WALKER)
    }
    assert all(steps and steps[0] > 11 for steps in acting.values()), "they waited beyond begin_s"
