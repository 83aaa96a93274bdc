"""What the benchmark runs on, and how it says what it found."""

import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_eval.benchmark import steps as benchmark
from litsim_eval.benchmark.steps import (
    LANES,
    SPEED,
    execute,
    graph_sample,
    straight_road,
    table_rows,
    time_highway_env,
    time_in_process,
    time_recording,
    write_scenario,
)
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.record.bag import BagReader, BagTopic, BagWriter
from litsim_sim.scenario.scenario import Scenario


@pytest.mark.parametrize("agents", [10, 250])
def test_columns_of_traffic_are_a_valid_scenario(tmp_path: Path, agents: int) -> None:
    scenario = Scenario.load(write_scenario(tmp_path, agents, seconds=13.0))
    log = scenario.log
    assert len(log.ids) == agents and scenario.total_steps == 130 and not scenario.shortened
    assert log.valid.all(), "everybody is there all the time"
    assert scenario.lane_map.inside_road(log.x.ravel(), log.y.ravel()).all()
    for step in (0, 130):
        table = log.table(step)
        assert len(overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width)) == 0
    assert len(np.unique(np.round(log.y[:, 0], 2))) == min(agents, LANES)
    assert (log.x[:, -1] - log.x[:, 0]) == pytest.approx(np.full(agents, 13.0 * SPEED))


def test_an_ego_that_keeps_more_distance_makes_the_benchmark_work(tmp_path: Path, drive) -> None:
    """It would measure nothing, if nobody were taken over."""
    run = drive(Scenario.load(write_scenario(tmp_path, 50, seconds=8.0)), "idm")
    assert max(len(r.takeovers.takeovers) for r in run.results) > 0
    assert run.world.contacts == {}


def test_figures_are_said_as_median_and_range_of_the_repetitions() -> None:
    samples = [{"in process": 2.0, "graph / in process": 5.0}, {"in process": 1.0, "graph / in process": 4.0}]
    samples.append({"in process": 4.0, "graph / in process": 3.0})
    rows = list(table_rows({50: samples, 150: [{"in process": 1.0}]}))
    assert rows == [
        ["in process, ms", "2.00 (1.00 to 4.00)", "1.00 (1.00 to 1.00)"],
        ["graph / in process", "4.00 (3.00 to 5.00)", "-"],
    ]


def test_a_step_in_process_is_told_apart_by_stage(tmp_path: Path) -> None:
    """In a process of its own, as the benchmark does it: libsumo holds one simulation."""
    scenario = write_scenario(tmp_path, 20, seconds=5.0)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as process:
        sample = process.submit(time_in_process, scenario, sumo=True).result()
    parts = ("world", "SUMO", "predictor", "conflict", "policy", "ego")
    assert set(sample) == {*parts, "in process"} and min(sample.values()) > 0.0


def test_a_step_without_sumo_is_timed_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark, "TimedMirror", None)  # calling it would fail
    sample = time_in_process(write_scenario(tmp_path, 20, seconds=5.0), sumo=False)
    assert set(sample) == {"in process without SUMO"} and min(sample.values()) > 0.0


def test_a_step_over_the_graph_is_what_lies_between_steps_after_the_history() -> None:
    """Three steps of 20 ms after two of 1 ms; each stage computes for 4 ms, the bridge for 1 ms."""
    begins = [0.0, 0.001, 0.002, 0.022, 0.042, 0.062]
    bridge = {
        step: {"begin": at, "shown": at + 0.001, "free": at + 0.002, "answered": at + 0.017, "complete": at + 0.018}
        for step, at in enumerate(begins)
    }
    bridge[3] |= {"watch": 0.023, "watched": 0.0232}
    stages = {
        stage: {
            step: {"begin": at + 0.002 + 0.005 * k, "answered": at + 0.006 + 0.005 * k}
            for step, at in enumerate(begins)
        }
        for k, stage in enumerate(("predictor", "conflict", "policy"))
    }
    timing = {stage: dict.fromkeys(range(6), 0.004) for stage in stages} | {"bridge": dict.fromkeys(range(6), 0.001)}
    run: Any = SimpleNamespace(marks={"bridge": bridge, **stages}, timing=timing, info=SimpleNamespace(history_steps=2))
    sample = graph_sample(run)
    assert sample["graph with recording"] == pytest.approx(20.0)
    assert sample["transport and waiting"] == pytest.approx(20.0 - 3 * 4.0 - 1.0)
    assert sample["graph: hop to conflict"] == pytest.approx(1.0)
    assert sample["watch over publishers, once a second"] == pytest.approx(0.2)


def test_recording_is_timed_by_writing_the_messages_again(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", "bag") as writer:
        writer.add_topic(BagTopic("/made", "made_msgs/msg/Made", "uint8 value", "[]", ""))
        for step in range(10):
            writer.write("/made", bytes([0, 1, 0, 0, step]), step * 10**8)
    assert time_recording(tmp_path / "bag", tmp_path / "again")["recording"] > 0.0
    both = [[m.data for m in BagReader(tmp_path / name).messages()] for name in ("bag", "again")]
    assert both[0] == both[1] and len(both[0]) == 10


def test_what_a_program_says_of_its_failure_is_passed_on(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="ended with status 3: it broke"):
        execute(Path("/bin/sh"), "-c", "echo it broke >&2; exit 3")
    with pytest.raises(InputError, match="nothing: cannot be run"):
        time_highway_env(tmp_path / "nothing", tmp_path / "step_time.py", 50, 1)


def test_the_straight_road_is_one_that_sumo_loads(tmp_path: Path) -> None:
    net = tmp_path / "road.net.xml"
    net.write_text(straight_road(2500.0))
    program = "import libsumo, sys; libsumo.start(['sumo', '-n', sys.argv[1]]); print(libsumo.lane.getLength('road_4'))"
    assert execute(Path(sys.executable), "-c", program, str(net)).split()[-1] == "2500.0"
