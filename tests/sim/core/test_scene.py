"""Agent tables and the history window."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable, Controller, ControlTable, History

Build = Callable[..., AgentTable]
ids = st.lists(st.integers(-(2**62), 2**62), unique=True, max_size=20)


def table_of(step: int, agents: list[int]) -> AgentTable:
    """Agents whose every column is their position plus a constant of the column."""
    count = len(agents)
    columns = [np.arange(count, dtype=DTYPES[f]) + i for i, f in enumerate(ARRAY_FIELDS)]
    columns[0] = np.array(sorted(agents), np.int64)
    return AgentTable(step, *columns)


# AgentTable


@given(ids, ids)
def test_rows_of_present_and_absent_agents(present: list[int], others: list[int]) -> None:
    table = table_of(0, present)
    wanted = present + others
    rows = table.rows(np.array(wanted, np.int64))
    ordered = sorted(present)
    assert rows.tolist() == [ordered.index(agent) if agent in ordered else -1 for agent in wanted]
    assert [table.row(agent) for agent in wanted] == rows.tolist()


def test_rows_beyond_the_last_and_before_the_first(agent_table: Build) -> None:
    table = agent_table(0, {"id": 10}, {"id": 20})
    assert table.rows(np.array([30, 20, 15, 10, 5])).tolist() == [-1, 1, -1, 0, -1]
    assert (table.row(30), table.row(20), table.row(15), table.row(10), table.row(5)) == (-1, 1, -1, 0, -1)


def test_an_empty_table_has_no_rows() -> None:
    table = AgentTable.empty(7)
    assert (table.step, len(table), table.row(1)) == (7, 0, -1)
    assert table.rows(np.array([1, 2])).tolist() == [-1, -1]
    assert table.rows(np.empty(0, np.int64)).tolist() == []
    for field in ARRAY_FIELDS:
        assert getattr(table, field).dtype == DTYPES[field]


def test_take_by_positions_and_by_mask_are_the_same() -> None:
    table = table_of(3, [5, 6, 7, 8])
    by_rows, by_mask = table.take(np.array([1, 3])), table.take(np.array([False, True, False, True]))
    assert by_rows.step == by_mask.step == 3
    for field in ARRAY_FIELDS:
        kept = getattr(table, field)[[1, 3]]
        assert kept.dtype == DTYPES[field]
        np.testing.assert_array_equal(getattr(by_rows, field), kept, field)
        np.testing.assert_array_equal(getattr(by_mask, field), kept, field)


def test_take_gives_arrays_of_their_own() -> None:
    table = table_of(0, [1, 2])
    table.take(np.array([0])).x[0] = 99.0
    assert table.x[0] != 99.0
    assert len(table.take(np.zeros(2, np.bool_))) == 0


def test_off_log_is_everybody_but_the_logged(agent_table: Build) -> None:
    table = agent_table(0, *({"id": int(c), "controller": c} for c in Controller))
    assert table.off_log.tolist() == [False, True, True, True]


def test_empty_controls_have_the_types_of_full_ones() -> None:
    controls = ControlTable.empty(4)
    assert (controls.step, len(controls.id)) == (4, 0)
    assert (controls.id.dtype, controls.source.dtype, controls.yaw_rate.dtype) == (np.int64, np.uint8, np.float64)


# History


def test_series_of_agents_that_stay_enter_and_leave(agent_table: Build) -> None:
    history = History(4)
    history.push(agent_table(0, {"id": 1, "x": 10.0}, {"id": 3, "x": 30.0}))
    history.push(agent_table(1, {"id": 1, "x": 11.0}, {"id": 3, "x": 31.0}))
    history.push(agent_table(2, {"id": 1, "x": 12.0}, {"id": 2, "x": 22.0}))
    values, valid = history.series("x", np.array([1, 2, 3, 4]))
    assert values.tolist() == [[10.0, 11.0, 12.0], [0.0, 0.0, 22.0], [30.0, 31.0, 0.0], [0.0, 0.0, 0.0]]
    assert valid.tolist() == [[True] * 3, [False, False, True], [True, True, False], [False] * 3]


def test_series_keeps_the_order_that_was_asked_for(agent_table: Build) -> None:
    history = History(2)
    history.push(agent_table(0, {"id": 1, "speed": 1.0}, {"id": 2, "speed": 2.0}))
    values, valid = history.series("speed", np.array([2, 9, 1]))
    assert values[:, 0].tolist() == [2.0, 0.0, 1.0]
    assert valid[:, 0].tolist() == [True, False, True]


def test_only_the_last_steps_are_kept(agent_table: Build) -> None:
    history = History(3)
    for step in range(7):
        history.push(agent_table(step, {"id": 1, "x": float(step)}))
        assert len(history) == min(step + 1, 3)
    assert [table.step for table in history] == [4, 5, 6]
    assert history.series("x", np.array([1]))[0].tolist() == [[4.0, 5.0, 6.0]]


def test_a_window_strides_back_from_the_newest_step_as_far_as_the_history_reaches(agent_table: Build) -> None:
    history = History(10)
    for step in range(5):
        late = [{"id": 2, "x": -1.0, "speed": 9.0}] if step >= 4 else []
        history.push(agent_table(step, {"id": 1, "x": float(step), "speed": 10.0 * step}, *late))
    values, valid = history.window(("x", "speed"), np.array([2, 1]), length=4, stride=2)
    assert values[0].tolist() == [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [-1.0, 9.0]]
    assert values[1].tolist() == [[0.0, 0.0], [0.0, 0.0], [2.0, 20.0], [4.0, 40.0]]
    assert valid.tolist() == [[False, False, False, True], [False, True, True, True]]
    assert history.window(("x",), np.array([1]), length=2)[0][0, :, 0].tolist() == [3.0, 4.0]


@pytest.mark.parametrize("step", [7, 5, 4, 0])
def test_a_step_that_does_not_follow_starts_afresh(agent_table: Build, step: int) -> None:
    history = History(10)
    for before in (3, 4, 5):
        history.push(agent_table(before, {"id": 1, "x": float(before)}))
    history.push(agent_table(step, {"id": 1, "x": 70.0}))
    assert [table.step for table in history] == [step]
    values, valid = history.series("x", np.array([1]))
    assert (values.tolist(), valid.tolist()) == ([[70.0]], [[True]])


def test_a_step_that_follows_continues(agent_table: Build) -> None:
    history = History(10)
    for step in (3, 4, 5, 6):
        history.push(agent_table(step, {"id": 1}))
    assert [table.step for table in history] == [3, 4, 5, 6]


def test_series_without_agents_or_steps(agent_table: Build) -> None:
    history = History(3)
    values, valid = history.series("x", np.array([1, 2]))
    assert values.shape == valid.shape == (2, 0)
    history.push(agent_table(0, {"id": 1}))
    history.push(AgentTable.empty(1))
    assert history.series("x", np.empty(0, np.int64))[0].shape == (0, 2)
    assert history.series("x", np.array([1]))[1].tolist() == [[True, False]]


@given(st.lists(st.lists(st.integers(0, 8), unique=True, max_size=6), min_size=1, max_size=12), st.integers(1, 6))
def test_series_is_what_the_tables_held(present: list[list[int]], length: int) -> None:
    history = History(length)
    for step, agents in enumerate(present):
        history.push(table_of(step, agents))
    wanted = np.arange(9)
    values, valid = history.series("width", wanted)
    kept = present[-length:]
    assert valid.shape == (9, len(kept))
    for column, agents in enumerate(kept):
        table = table_of(0, agents)
        for agent in wanted:
            assert valid[agent, column] == (agent in agents)
            assert values[agent, column] == (table.width[table.row(agent)] if agent in agents else 0.0)
