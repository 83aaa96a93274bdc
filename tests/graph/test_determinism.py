"""The same scenario and seed give the same run: twice over DDS, in one process, and in reruns."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.in_process import record
from litsim_eval.runs.recorded_run import open_record
from litsim_eval.runs.rerun import resimulate
from litsim_sim.core.parameters import by_stage
from litsim_sim.record.bag import BagReader
from litsim_sim.record.run import read_run
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario


def metrics_of(run: Any) -> dict[str, Any]:
    assert run.done.returncode == 0, run.done.stderr
    return json.loads((run.bag / "metrics.json").read_text())


def per_step_messages(bag: Path) -> list[tuple[str, int, bytes]]:
    """Messages as they were recorded, but for the name of the execution, which no two runs share."""
    info = read_run(bag).info
    name = info.run_id.encode()
    nameless = name.partition(b"@")[0].ljust(len(name))
    return [(m.topic, m.log_time_ns, m.data.replace(name, nameless)) for m in BagReader(bag).messages(info.topics)]


def test_a_launch_and_a_run_in_process_agree(recorded: Any) -> None:
    """For a policy that is told whom to drive by the region around the ego, see examples/test_extension.py."""
    first = recorded("idm", "litsim")
    metrics = metrics_of(first)
    assert metrics["valid"], metrics["why"]
    assert metrics["steps"] == metrics["total_steps"] == 35
    assert metrics["takeovers"] > 0, "else the comparison would be of little"
    plan = RunPlan(Scenario.load(first.scenario), "idm", "litsim")
    assert metrics["run_id"].partition("@")[0] == plan.identity
    in_process = compute_metrics(record(plan))
    assert in_process["digest"] == metrics["digest"]
    assert in_process["collision"] == metrics["collision"]
    assert in_process["ledger"] == metrics["ledger"]
    assert len(per_step_messages(first.bag)) == 36 * 7


def test_two_launches_publish_the_same_messages(recorded: Any) -> None:
    first, second = recorded("idm", "litsim"), recorded("idm", "litsim", "second")
    assert metrics_of(second)["digest"] == metrics_of(first)["digest"]
    assert metrics_of(second)["run_id"] != metrics_of(first)["run_id"]
    assert per_step_messages(second.bag) == per_step_messages(first.bag)


def test_parameters_are_the_same_over_dds_in_process_and_in_re_runs(graph: Any) -> None:
    scenario, bag = graph.scenario(), graph.folder / "set"
    settings = {"ego.kind": "brake", "ego.time": [0.0, 0.0], "policy.safety.contact": False, "conflict.horizon": 2.5}
    settings["bridge.latency"] = "0.2"
    words = [f"{name}={json.dumps(value)}" for name, value in settings.items()]
    done = graph.launch("--scenario", scenario, "--ego", "perturbed", "--out", bag, "--set", *words)
    assert done.returncode == 0, done.stderr
    metrics = json.loads((bag / "metrics.json").read_text())
    plan = RunPlan(Scenario.load(str(scenario)), "perturbed", "litsim")
    split = [(*name.split(".", 1), value) for name, value in settings.items()]
    assert compute_metrics(record(replace(plan, parameters=by_stage(split))))["digest"] == metrics["digest"]
    assert compute_metrics(record(plan))["digest"] != metrics["digest"]
    with open_record(bag) as recorded_run:
        again = resimulate(recorded_run)
    assert again.computed == again.recorded == metrics["digest"]
    identity = replace(plan, parameters=by_stage(split)).identity
    assert metrics["run_id"].startswith(f"{identity}@") and identity != plan.identity
    assert again.tally.different == 0 and not recorded_run.notes
