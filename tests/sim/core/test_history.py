"""The past of all agents: who was where, and who was not there."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.history import History
from litsim_sim.core.scene import AgentTable
from made_agents import table_of

Build = Callable[..., AgentTable]


def test_a_window_strides_back_from_the_newest_step_as_far_as_the_history_reaches(agent_table: Build) -> None:
    history = History(10, ["x", "speed"])
    for step in range(5):
        late = [{"id": 2, "x": -1.0, "speed": 9.0}] if step >= 4 else []
        history.push(agent_table(step, {"id": 1, "x": float(step), "speed": 10.0 * step}, *late))
    values, valid = history.window(np.array([2, 1]), length=4, stride=2)
    assert values[0].tolist() == [[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [-1.0, 9.0]]
    assert values[1].tolist() == [[0.0, 0.0], [0.0, 0.0], [2.0, 20.0], [4.0, 40.0]]
    assert valid.tolist() == [[False, False, False, True], [False, True, True, True]]
    assert history.window(np.array([1]), length=2)[0][0, :, 0].tolist() == [3.0, 4.0]


@pytest.mark.parametrize("step", [7, 5, 4, 0])
def test_a_step_that_does_not_follow_starts_afresh(agent_table: Build, step: int) -> None:
    history = History(10, ["x", "speed"])
    for before in (3, 4, 5):
        history.push(agent_table(before, {"id": 1, "x": float(before)}))
    history.push(agent_table(step, {"id": 1, "x": 70.0}))
    values, valid = history.window(np.array([1]), 2)
    assert (values[..., 0].tolist(), valid.tolist()) == ([[0.0, 70.0]], [[False, True]])


def test_windows_without_agents_or_steps(agent_table: Build) -> None:
    history = History(3, ["x"])
    assert not history.window(np.array([1, 2]), 2)[1].any()
    history.push(agent_table(0, {"id": 1}))
    history.push(AgentTable.empty(1))
    assert history.window(np.empty(0, np.int64), 2)[0].shape == (0, 2, 1)
    assert history.window(np.array([1]), 2)[1].tolist() == [[True, False]]


@given(st.lists(st.lists(st.integers(0, 8), unique=True, max_size=6), min_size=1, max_size=12), st.integers(1, 6))
def test_a_window_is_what_the_tables_held(present: list[list[int]], length: int) -> None:
    history = History(length, ["x", "width"])
    for step, agents in enumerate(present):
        history.push(table_of(step, agents))
    wanted = np.arange(9)
    kept = present[-length:]
    values, valid = history.window(wanted, len(kept))
    assert valid.shape == (9, len(kept))
    for column, agents in enumerate(kept):
        table = table_of(0, agents)
        for agent in wanted:
            assert valid[agent, column] == (agent in agents)
            assert values[agent, column, 1] == (table.width[table.row(agent)] if agent in agents else 0.0)


def test_who_has_left_takes_no_room(agent_table: Build) -> None:
    history = History(3, ["x"])
    for step in range(50):
        history.push(agent_table(step, {"id": step}, {"id": step + 1}))
    assert history._values.shape[1] <= 6
    valid = history.window(np.array([48, 49, 50]), 3)[1]
    assert valid.tolist() == [[True, True, False], [False, True, True], [False, False, True]]
