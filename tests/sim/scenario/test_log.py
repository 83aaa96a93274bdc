"""Steps of a log as tables, and by how much it lags, against looking up every agent."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.scene import ARRAY_FIELDS, Controller
from litsim_sim.core.steps import Steps
from litsim_sim.scenario.log import LAG_TOLERANCE, REPLAYS, Log, logged_steps
from litsim_sim.scenario.recording import COLUMNS


@pytest.fixture(scope="module")
def log() -> Log:
    """Nine agents that come and go within thirty steps, every number another."""
    random = np.random.default_rng(0)
    first = random.integers(0, 15, 9)
    last = first + random.integers(0, 15, 9)
    valid = (np.arange(30) >= first[:, None]) & (np.arange(30) <= last[:, None])
    columns = random.normal(size=(6, 9, 30)) * valid
    sizes = random.uniform(2.0, 6.0, (2, 9))
    return Log(np.arange(9) * 3 + 5, np.arange(9, dtype=np.uint8), *sizes, first, last, valid, *columns)


@pytest.mark.parametrize("lagged", [False, True])
@pytest.mark.parametrize("step", range(-2, 34, 3))
def test_a_step_holds_whom_the_log_has_on_the_road_then(log: Log, step: int, lagged: bool) -> None:
    lag = np.random.default_rng(step + 2).integers(0, 12, 9) if lagged else np.zeros(9, np.int64)
    table = log.table(step, lag if lagged else None)
    there = [k for k in range(9) if 0 <= step - lag[k] < 30 and log.valid[k, step - lag[k]]]
    assert table.step == step and table.id.tolist() == [int(log.ids[k]) for k in there]
    assert (table.controller == Controller.LOG).all()
    for field in ("kind", "length", "width"):
        assert getattr(table, field).tolist() == [getattr(log, field)[k] for k in there]
    for field in ("x", "y", "yaw", "speed", "acceleration", "yaw_rate"):
        assert getattr(table, field).tolist() == [getattr(log, field)[k, step - lag[k]] for k in there]


@given(st.integers(0, 2**32), st.booleans(), st.integers(1, 6))
def test_logged_steps_are_the_tables_of_the_log(seed: int, with_gaps: bool, parts: int) -> None:
    random = np.random.default_rng(seed)
    first = random.integers(0, 15, 6)
    tracks = [np.arange(begin, begin + random.integers(1, 12)) for begin in first]
    frame, agent = np.concatenate(tracks), np.repeat(np.arange(6), list(map(len, tracks)))
    columns = {name: random.normal(size=len(frame)).astype(dtype) for name, dtype in COLUMNS.items()}
    columns |= {"frame": frame + 100, "vehicle_id": agent * 7 + 1, "yaw": random.uniform(-4.0, 4.0, len(frame))}
    order = np.lexsort((agent, frame))
    columns = {name: values[order] for name, values in columns.items()}
    recording = SimpleNamespace(columns=columns)
    recording.take = lambda rows: SimpleNamespace(columns={name: values[rows] for name, values in columns.items()})
    wanted = np.flatnonzero(random.random(20) < (0.7 if with_gaps else 2.0))
    log = Log.from_recording(recording, 102, int(max(wanted, default=0)) + 1)
    cuts = np.sort(random.integers(0, len(frame) + 1, parts - 1))
    pieces = (np.split(values, cuts) for values in columns.values())
    steps = logged_steps([dict(zip(columns, piece, strict=True)) for piece in zip(*pieces, strict=True)], 102, wanted)
    assert steps.step.tolist() == wanted.tolist()
    for table in steps:
        for name in ARRAY_FIELDS:
            assert getattr(table, name).tolist() == getattr(log.table(table.step), name).tolist(), name


def test_a_log_of_rows_has_them_at_their_steps_and_holes_between(log: Log) -> None:
    steps = Steps(log.table(step) for step in range(log.steps))
    kept = steps.stacked.take(steps.stacked.number % 4 != 2)
    part = Log.from_rows(kept, log.steps)
    shown = log.valid & (np.arange(log.steps) % 4 != 2)
    rows = shown.any(axis=1)
    assert part.ids.tolist() == log.ids[rows].tolist() and np.array_equal(part.valid, shown[rows])
    assert np.array_equal(part.x[part.valid], log.x[shown])
    assert part.last_step.tolist() == [int(np.flatnonzero(row)[-1]) for row in shown[rows]]


def test_tables_are_copies(log: Log) -> None:
    before = log.x.copy()
    log.table(10).x[:] = 0.0
    assert (log.x == before).all()


# Lags


def waiting(seed: int) -> Log:
    """Four agents that drive along x, wait and drive on, each on the road for some of forty steps."""
    random = np.random.default_rng(seed)
    first, last = np.sort(random.integers(0, 40, (2, 4)), axis=0)
    valid = (np.arange(40) >= first[:, None]) & (np.arange(40) <= last[:, None])
    x = np.cumsum(random.choice([0.0, 0.05, 1.5], (4, 40)), axis=1)
    others = np.zeros((4, 4, 40))
    kind, size = np.zeros(4, np.uint8), np.full((2, 4), 2.0)
    return Log(np.arange(4), kind, *size, first, last, valid, x, random.normal(0.0, 0.1, (4, 40)), *others)


@given(st.integers(0, 2**32), st.integers(-2, 45))
def test_a_lag_is_the_time_since_the_latest_of_the_places_that_are_nearly_nearest(seed: int, step: int) -> None:
    logs, random = waiting(seed), np.random.default_rng(seed + 1)
    rows = random.integers(0, 4, 12)
    x, y = random.uniform(-5.0, 40.0, 12), random.normal(0.0, 1.0, 12)
    found = logs.lags(rows, step, x, y)
    for k, row in enumerate(rows):
        so_far = np.flatnonzero(logs.valid[row] & (np.arange(40) <= step))
        if len(so_far):
            distance = np.hypot(logs.x[row, so_far] - x[k], logs.y[row, so_far] - y[k])
            assert found[k] == step - so_far[distance <= distance.min() + LAG_TOLERANCE][-1]
        else:
            assert found[k] == 0, "it has been nowhere yet"


def test_replays_of_one_length_are_one_object_and_few_are_kept(log: Log) -> None:
    last = log.steps - 1
    replay = log.replay(last)
    assert replay is log.replay(last) and len(replay) == log.steps
    for step, table in enumerate(replay):
        expected = log.table(step)
        assert all(np.array_equal(getattr(table, f), getattr(expected, f)) for f in ARRAY_FIELDS)
    for end in range(REPLAYS):
        assert len(log.replay(end)) == end + 1
    assert log.replay(last) is not replay
