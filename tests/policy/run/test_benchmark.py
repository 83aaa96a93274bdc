"""What the benchmark runs on, and how it says what it found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from litsim_policy.run.benchmark import Sample, measure, rows, write_scenario
from litsim_policy.run.conflict_benchmark import detection_rows, measure_detection
from litsim_predictor.benchmark import LANES, SPACING, SPEED, columns_of_traffic
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.scenario.scenario import Scenario


@pytest.mark.parametrize("agents", [10, 50, 100, 250])
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


def test_the_ego_of_the_benchmark_has_followers_close_behind(tmp_path: Path) -> None:
    scenario = Scenario.load(write_scenario(tmp_path, 50, seconds=5.0))
    table = scenario.log.table(0)
    ego = table.row(scenario.ego_id)
    behind = table.x[ego] - table.x[np.abs(table.y - table.y[ego]) < 0.1]
    assert SPACING in np.round(behind, 6)


def test_an_ego_that_keeps_more_distance_makes_the_benchmark_work(tmp_path: Path, drive) -> None:
    """It would measure nothing, if nobody were taken over."""
    run = drive(Scenario.load(write_scenario(tmp_path, 50, seconds=8.0)), "idm")
    assert max(len(r.takeovers.takeovers) for r in run.results) > 0
    assert run.world.contacts == {}


def test_columns_can_be_generated_twice_the_same() -> None:
    assert columns_of_traffic(20, 5.0).table.equals(columns_of_traffic(20, 5.0).table)


def test_samples_are_said_as_median_and_range() -> None:
    samples = [Sample(2.0, 10.0, 3.0), Sample(1.0, 4.0, 5.0), Sample(4.0, 12.0, 4.0)]
    said = dict(rows(samples))
    assert said["in_process"] == "2.00 (1.00 to 4.00)"
    assert said["ratio"] == "4.00 (3.00 to 5.00)", "of the pairs, not of the medians"
    assert said["graph"] == "10.00 (4.00 to 12.00)" and said["realtime_factor"] == "4.00 (3.00 to 5.00)"


def test_a_run_that_fails_is_an_input_error(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(
        "litsim_policy.run.benchmark.NET", "us101"
    )  # it lies elsewhere: the columns are not on its road
    with pytest.raises(InputError, match="run ended with status"):
        measure(tmp_path, 10, 5.0, 1, lambda: None)


def test_conflict_detection_is_timed_on_traffic_in_which_there_are_conflicts() -> None:
    timing = measure_detection(60, repeats=2)
    assert (timing.agents, timing.off_log) == (60, 6) and timing.pairs > 100
    assert 4 <= timing.conflicts <= 6, "the follower of each that has braked, but for the ends of the columns"
    assert len(timing.wall) == len(timing.cpu) == 2 and min(timing.wall) > 0.0
    said = list(detection_rows(timing))
    assert said[:2] == ["60", "6"] and "to" in said[-1] and len(said) == 6
