"""Agent tables and the history window."""

from collections.abc import Callable

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable, Controller
from made_agents import table_of

Build = Callable[..., AgentTable]
ids = st.lists(st.integers(-(2**62), 2**62), unique=True, max_size=20)


# AgentTable


@given(ids, ids)
def test_rows_of_present_and_absent_agents(present: list[int], others: list[int]) -> None:
    table = table_of(0, present)
    wanted = present + others
    rows = table.rows(np.array(wanted, np.int64))
    ordered = sorted(present)
    assert rows.tolist() == [ordered.index(agent) if agent in ordered else -1 for agent in wanted]
    assert [table.row(agent) for agent in wanted] == rows.tolist()


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
    assert table.off_log.tolist() == [False, True, True]
