"""Left-hand traffic: a world seen in a mirror gives the run seen in a mirror, where no network takes part."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from litsim_data.maps.lane_graph import LaneGraph, Lanelet, around
from litsim_data.maps.net_builder import write_graph
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.cli.run import parser
from litsim_eval.runs.in_process import record
from litsim_sim.cli.run_arguments import plan_of
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.recording import Recording
from litsim_sim.scenario.scenario import packaged
from litsim_sim.world.sumo import SumoMirror

SIMULATION_S = 6.0
BRAKING = ["ego.kind=brake", "ego.deceleration=3", "ego.duration=3", "ego.time=[0.5, 0.5]"]


def write(folder: Path, *, left_hand: bool) -> Path:
    """The scenario demo on a net of our own, as it is or mirrored."""
    flip = np.array([1.0, -1.0 if left_hand else 1.0])
    lanes = []
    for lane in LaneMap.from_net(packaged("nets/us101_like.net.xml")).lanes:
        bounds = [bound * flip for bound in around(lane.centerline, lane.width)]
        sides = [other and other.replace("_", "x") for other in (lane.left, lane.right)]
        bounds, sides = (bounds[::-1], sides[::-1]) if left_hand else (bounds, sides)
        after = tuple(name.replace("_", "x") for name in lane.successors)
        limit = lane.speed_limit
        lanes.append(Lanelet(lane.id.replace("_", "x"), *bounds, after, *sides, speed_limit=limit))
    write_graph(LaneGraph(tuple(lanes), left_hand=left_hand), folder / "net.net.xml")
    recording = Recording.read(packaged("scenarios/demo.parquet"))
    columns = dict(recording.columns) | {"lane": np.full_like(recording.columns["lane"], -1)}
    columns |= {name: flip[1] * columns[name] for name in ("y", "yaw")}
    Recording(replace(recording.header, net="net.net.xml"), columns).write(folder / "recording.parquet")
    fields = yaml.safe_load(packaged("scenarios/demo.yaml").read_text(encoding="utf-8"))
    fields |= {"recording": "recording.parquet", "net": "net.net.xml", "egos": [], "tuning": []}
    fields |= {"simulation_s": SIMULATION_S}
    (folder / "scenario.yaml").write_text(yaml.safe_dump(fields))
    return folder / "scenario.yaml"


def driven(folder: Path, *, left_hand: bool) -> dict[str, Any]:
    """What is measured of a run in which the ego brakes, and those behind it are taken over."""
    folder.mkdir()
    scenario = write(folder, left_hand=left_hand)
    words = ["--scenario", str(scenario), "--ego", "perturbed", "--policy", "yield", "--predictor", "kinematic"]
    plan = plan_of(parser().parse_args([*words, "--set", *BRAKING]))
    mirror = SumoMirror(plan.scenario.net_path, plan.scenario.seed, plan.scenario.signals)
    metrics = compute_metrics(record(plan, mirror))
    return {name: value for name, value in metrics.items() if name not in ("run_id", "digest", "timing")}


@pytest.mark.usefixtures("netconvert")
def test_a_mirrored_world_gives_the_mirrored_run(tmp_path: Path) -> None:
    right, left = driven(tmp_path / "right", left_hand=False), driven(tmp_path / "left", left_hand=True)
    assert right["takeovers"] > 0
    same(left, right, "")


def same(one: Any, other: Any, where: str) -> None:
    """Compares two values of measures, numbers to a millionth."""
    if isinstance(other, dict):
        assert one.keys() == other.keys(), where
        for name in other:
            same(one[name], other[name], f"{where}.{name}")
    elif isinstance(other, list):
        assert len(one) == len(other), where
        for number, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, f"{where}[{number}]")
    elif isinstance(other, float):
        assert one == pytest.approx(other, rel=1e-6, abs=1e-6, nan_ok=True), where
    else:
        assert one == other, where
