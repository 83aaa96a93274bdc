"""Measures by blocks of steps are those of all steps, and take the memory of a block, however long a run is."""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import litsim_sim
from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.analysis.tables import series_tables
from litsim_eval.pictures.overview import overview
from litsim_sim.core import steps
from litsim_sim.core.scene import AgentTable, Controller, Kind
from litsim_sim.core.takeover import TakeoverState
from litsim_sim.record.run import Run, read_run
from litsim_sim.scenario import recording
from made_agents import takeover
from made_runs import make_run, table, write_run

NET = Path(litsim_sim.__file__).parent / "nets/us101_like.net.xml"
FORMAT_1 = Path(__file__).parents[2] / "sim/record/bags/format_1"
HISTORY, STEPS = 10, 150


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A run with all that measures look at: contacts, takeovers, hand-backs, standstill, a walker, late and early ends.

    The ego brakes until it stands, and agent 3 drives into it; agent 2 is under control from step 20 to 60, brakes hard
    and jumps back to its log; agent 4 enters late and leaves early; agent 6 walks across.
    """
    rows = {1: (40.0, -1.83), 2: (20.0, -1.83), 3: (0.0, -1.83), 4: (30.0, -5.49), 5: (60.0, 1.83), 6: (90.0, -8.0)}
    tables, log = [], []
    for k in range(STEPS + 1):
        logged, now = [], []
        for agent, (x, y) in rows.items():
            far = 8.0 * np.sin(0.02 * k)
            row = {
                "id": agent,
                "x": x + k + far,
                "y": y,
                "speed": 10.0 + far,
                "acceleration": 0.5 * far,
                "yaw": 0.01 * far,
            }
            row |= {"kind": Kind.PEDESTRIAN, "x": x, "y": y + 0.1 * k, "speed": 1.0} if agent == 6 else {}
            if agent != 4 or 30 <= k < 120:
                logged.append(row)
            if agent == 4 and not 50 <= k < 100:
                continue
            own = dict(row)
            if agent == 1 and k >= HISTORY:
                own |= {
                    "controller": Controller.EGO,
                    "x": x + 30.0,
                    "speed": 0.0,
                    "acceleration": -4.0 if k < 40 else 0.0,
                }
            if agent == 2 and 20 <= k <= 60:
                own |= {"controller": Controller.POLICY, "x": row["x"] - 3.0, "y": y + 4.0, "acceleration": -3.5}
            now.append(own)
        tables.append(table(k, *now))
        log.append(table(k, *logged))
    states = {k: TakeoverState.HELD if k < 50 else TakeoverState.HANDBACK for k in range(20, 60)}
    states[60] = TakeoverState.RELEASED
    takeovers = {k: [takeover(2, state=state, detected_step=20, time_shift=0.3)] for k, state in states.items()}
    timing = {"policy": dict.fromkeys(range(STEPS + 1), 0.002)}
    values = {"takeovers": takeovers, "timing": timing, "net_xml": NET.read_bytes()}
    return Path(write_run(make_run(tables, log, history_steps=HISTORY, **values), tmp_path / "bag"))


def results(run: Run, folder: Path) -> tuple[str, list[dict[str, Any]], bytes]:
    """Returns metrics, series and picture of a run."""
    overview(run, folder / "overview.png")
    series = pa.concat_tables(series_tables(run)).unify_dictionaries().to_pylist()
    return json.dumps(compute_metrics(run)), series, (folder / "overview.png").read_bytes()


def test_results_by_blocks_are_those_of_all_steps(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bags = (bag, FORMAT_1)
    expected = [results(read_run(path), tmp_path) for path in bags]
    monkeypatch.setattr(steps, "BLOCK_ROWS", 333)
    monkeypatch.setattr(recording, "PART_ROWS", 333)
    for path, whole in zip(bags, expected, strict=True):
        run = read_run(path)
        assert isinstance(run.steps, steps.StoredSteps) and isinstance(run.logged, steps.StoredSteps)
        assert results(run, tmp_path) == whole
    measured = json.loads(expected[0][0])
    assert measured["collision"]["ego_contacts"] and measured["handback"]["count"] and measured["takeovers"]
    assert measured["safety"]["min_pet_s"] is not None and measured["comfort"]["controlled"]["hard_brakes"]


def test_memory_does_not_grow_with_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Held whole, the states of an agent at a step take 82 bytes in the run, and as many in the log."""
    monkeypatch.setattr(steps, "BLOCK_ROWS", 1000)
    monkeypatch.setattr(recording, "PART_ROWS", 1000)
    monkeypatch.setattr("litsim_eval.analysis.tables.ROWS_MAX", 1000)
    agents, peaks = 40, []

    def table(step: int) -> AgentTable:
        ids, zero = np.arange(1, agents + 1), np.zeros(agents)
        x = 20.0 * ids + 0.5 * step
        size = np.full(agents, 4.0), np.full(agents, 2.0)
        return AgentTable(step, ids, *np.zeros((2, agents), np.uint8), x, zero, zero, zero + 5.0, zero, zero, *size)

    for last in (150, 450):
        tables = [table(step) for step in range(last + 1)]
        bag = write_run(make_run(tables, net_xml=NET.read_bytes()), tmp_path / str(last))
        del tables
        tracemalloc.start()
        run = read_run(bag)
        compute_metrics(run)
        assert sum(len(part) for part in series_tables(run)) == agents * last
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / (300 * agents) < 40.0
