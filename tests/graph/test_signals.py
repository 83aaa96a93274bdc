"""Signals over real DDS: published, recorded, and equal to those of the scenario."""

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.report.verdict import verdict_in
from litsim_eval.runs.in_process import record
from litsim_predictor.models import predictor_stage
from litsim_sim.core.parameters import ParameterOverrides
from litsim_sim.core.topic_names import FORECASTS
from litsim_sim.record.bag import BagReader
from litsim_sim.record.decoding import decoded
from litsim_sim.record.run import read_run
from litsim_sim.scenario.recording import Recording, RecordingHeader
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.scenario.signals import Signals

EXAMPLES = Path(__file__).parents[2] / "examples"
GROUPS = {"east": ["WA_0", "WA_1"], "left": ["WA_2"]}
CHANGES = [[0.0, "east", "green"], [0.0, "left", "red"], [1.0, "east", "amber"], [2.0, "east", "red"]]


def two_at_a_light(graph: Any) -> Path:
    """A scenario in which the first of two cars passes a stop line at green, and the ego behind it at red."""
    frame = np.arange(36)
    same = {"yaw": 0.0, "speed": 10.0, "acceleration": 0.0, "length": 4.5, "width": 2.0, "kind": 0, "lane": -1}
    cars = [
        pd.DataFrame({"vehicle_id": number, "frame": frame, "x": -114.6 - 2.25 - to_line + frame, "y": -4.95, **same})
        for number, to_line in ((1, 9.0), (2, 28.0))
    ]
    path: Path = graph.scenario(net="urban_like", ego=2, signals={"groups": GROUPS, "changes": CHANGES})
    Recording.from_table(RecordingHeader("two"), pd.concat(cars), "two").write(graph.folder / "traffic.parquet")
    return path


def test_a_stack_on_standard_messages_stops_at_red_where_its_log_does_not(graph: Any) -> None:
    """And `launch` judges the run by criteria."""
    path = two_at_a_light(graph)
    criteria = graph.folder / "criteria.yaml"
    limits = [
        {"name": "no red light", "field": "signals.red_ego", "max": 0},
        {"field": "ego_motion.progress_m", "min": 90},
    ]
    criteria.write_text(yaml.safe_dump({"runs": limits}))
    words = ("--scenario", path, "--ego", "external", "--policy", "replay", "--out", graph.folder / "run")
    done = graph.launch(*words, "--criteria", criteria, "--", sys.executable, EXAMPLES / "minimal_ads.py")
    assert done.returncode == 1, done.stderr
    assert re.search(r"failed  ego: progress [\d.]+ m, expected at least 90 m", done.stderr)
    metrics = json.loads((graph.folder / "run/metrics.json").read_text())
    assert (metrics["signals"]["red_ego"], metrics["signals"]["red_log"]) == (0, 1)
    verdict = json.loads(verdict_in(graph.folder / "run/report.html"))
    assert [each["passed"] for each in verdict["criteria"]] == [True, False]
    check_signals(graph.folder / "run", Scenario.load(path).signals)


def test_forecasts_that_see_signals_are_the_same_over_dds_and_in_one_process(graph: Any) -> None:
    path, bag = two_at_a_light(graph), graph.folder / "seen"
    done = graph.launch("--scenario", path, "--ego", "idm", "--out", bag)
    assert done.returncode == 0, done.stderr
    run = read_run(bag)
    plan = RunPlan(Scenario.load(path), "idm", "litsim")
    assert compute_metrics(record(plan))["digest"] == json.loads((bag / "metrics.json").read_text())["digest"]
    stage = predictor_stage(ParameterOverrides("predictor", {}))("litsim", plan.scenario)
    again = {table.step: stage.forecast(table) for table in run.tables}
    reader = BagReader(bag)
    published = [decoded(reader.topics[FORECASTS], message.data) for message in reader.messages({FORECASTS})]
    assert len(published) > 20
    for forecast in published:
        assert np.array_equal(np.array(forecast.mean), again[forecast.step].mean.reshape(-1)), forecast.step


def check_signals(bag: Path, wanted: Signals | None) -> None:
    """Checks that what was published and recorded is what the scenario shows, and that the map is latched."""
    run = read_run(bag)
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
    topics = BagReader(bag).topics
    assert "transient_local" in topics["/litsim/signals/map"].qos_yaml
    assert "transient_local" not in topics["/litsim/signals"].qos_yaml
