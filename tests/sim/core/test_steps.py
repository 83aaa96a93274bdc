"""Successive steps as arrays are the same steps."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from litsim_data.surrogates.safety import following, times_to_collision
from litsim_sim.core import steps as module
from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import ARRAY_FIELDS, DTYPES, AgentTable
from litsim_sim.core.steps import Steps, StepsBuilder, StoredSteps

Crowd = Callable[[int], list[AgentTable]]


@pytest.fixture
def crowd() -> Crowd:
    def make(count: int) -> list[AgentTable]:
        """Tables of agents that come and go, close together; one is empty."""
        random, tables = np.random.default_rng(3), []
        for step in range(5, 5 + count):
            ids = np.flatnonzero(random.random(12) < (0.0 if step == 7 else 0.7)) * 3
            n = len(ids)
            columns = {f: random.uniform(0.0, 1.0, n).astype(DTYPES[f]) for f in ARRAY_FIELDS}
            columns |= {"id": ids, "x": random.uniform(0.0, 40.0, n), "y": random.uniform(0.0, 8.0, n)}
            columns |= {"speed": random.uniform(0.0, 20.0, n), "length": np.full(n, 4.5), "width": np.full(n, 1.8)}
            tables.append(AgentTable(step, **columns))
        return tables

    return make


def test_every_row_is_where_its_table_has_it(crowd: Crowd) -> None:
    tables = crowd(8)
    steps = Steps(tables)
    assert list(steps) == tables and steps.step.tolist() == list(range(5, 13))
    assert steps.ids.tolist() == sorted({agent for table in tables for agent in table.id.tolist()})
    asked = np.array([0, 3, 4, 33, 99])
    for k, table in enumerate(tables):
        own = slice(steps.begin[k], steps.begin[k + 1])
        for field in ARRAY_FIELDS:
            assert np.array_equal(getattr(steps.stacked, field)[own], getattr(table, field))
        assert (steps.stacked.scene[own] == k).all()
        assert np.array_equal(steps.ids[steps.agent[own]], table.id)
        expected = table.rows(asked)
        expected = np.where(expected >= 0, expected + steps.begin[k], -1)
        assert np.array_equal(steps.rows_of(asked)[k], expected)
        number = np.full(len(asked), k)
        assert np.array_equal(steps.rows_at(number, asked), expected)
        until = [max(steps.rows_of(np.array([agent]))[: k + 1, 0], default=-1) for agent in asked]
        assert np.array_equal(steps.rows_until(number, asked), until)
        for field in ARRAY_FIELDS:
            assert np.array_equal(getattr(steps[k], field), getattr(table, field)), "a part of the stack"
    assert (steps.rows_at(np.array([-1, 8]), np.array([0, 0])) == -1).all(), "before the first and after the last"


def test_the_track_of_an_agent_is_of_the_steps_at_which_it_is_there(crowd: Crowd) -> None:
    tables = crowd(8)
    steps = Steps(tables)
    for agent in [*steps.ids.tolist(), 4]:
        x = [float(table.x[table.row(agent)]) for table in tables if table.row(agent) >= 0]
        assert steps.stacked.x[steps.track(agent)].tolist() == x


def test_steps_behind_a_gap_follow_no_other(crowd: Crowd) -> None:
    tables = crowd(8)
    assert Steps(tables).follows.tolist() == [False] + [True] * 7
    assert Steps([tables[0], tables[1], tables[5], tables[6]]).follows.tolist() == [False, True, False, True]
    assert Steps([]).follows.tolist() == []


def test_nobody_at_all_is_no_rows() -> None:
    for steps in (Steps([]), Steps([AgentTable.empty(3), AgentTable.empty(4)])):
        assert not len(steps.stacked) and not len(steps.overlaps) and not len(steps.track(1))
        assert steps.rows_of(np.array([1, 2])).shape == (len(steps), 2) and (steps.rows_of(np.array([1])) == -1).all()
        assert steps.rows_at(np.array([0]), np.array([1])).tolist() == [-1]


def test_steps_are_asked_together_as_one_by_one(crowd: Crowd) -> None:
    tables = crowd(12)
    steps = Steps(tables)
    rows = np.arange(len(steps.stacked))
    behind, ttc = following(steps.stacked, rows), times_to_collision(steps.stacked, rows)
    leads, met, pairs = 0, 0, []
    for k, table in enumerate(tables):
        own, begin = slice(steps.begin[k], steps.begin[k + 1]), steps.begin[k]
        alone = following(table, np.arange(len(table)))
        for name in ("gap", "closing", "headway", "drac"):
            assert np.array_equal(getattr(behind, name)[own], getattr(alone, name))
        assert np.array_equal(behind.leader[own], np.where(alone.leader >= 0, alone.leader + begin, -1))
        expected = times_to_collision(table, np.arange(len(table)))
        assert np.array_equal(ttc[own], expected)
        leads, met = leads + int((alone.leader >= 0).sum()), met + int(np.isfinite(expected).sum())
        of_step = overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width)
        pairs += (of_step + begin).tolist()
    assert steps.overlaps.tolist() == pairs
    assert leads and met and pairs, "there is something to compare"


def test_what_is_made_of_steps_is_made_once(crowd: Crowd) -> None:
    steps, made = Steps(crowd(6)), []

    def count(of: Steps, least: int) -> int:
        made.append(least)
        return sum(len(table) >= least for table in of)

    assert steps.once(count, 1) == steps.once(count, 1) == 5
    assert steps.once(count, 100) == 0 and made == [1, 100]
    later = steps.after(8)
    assert later is steps.after(8) and later.step.tolist() == [9, 10] and Steps.of(steps) is steps
    own = steps.stacked.x[steps.begin[4] :]
    assert np.shares_memory(later.stacked.x, own) and np.array_equal(later.stacked.x, own)
    assert np.shares_memory(later[1].x, own) and later.begin.tolist() == [0, len(later[0]), len(own)]
    assert later.stacked.number.tolist() == [0] * len(later[0]) + [1] * len(later[1])
    assert len(steps.after(99)) == 0 and steps.after(-1) is steps


def test_a_part_of_a_stack_keeps_the_steps_of_its_rows(crowd: Crowd) -> None:
    stacked = Steps(crowd(4)).stacked
    some = stacked.take(stacked.x > 20.0)
    assert len(some) and (some.x > 20.0).all() and np.array_equal(some.scene, stacked.scene[stacked.x > 20.0])


def equal(steps: Steps, expected: Steps) -> bool:
    """Returns whether both have the same steps and rows."""
    fields = (*ARRAY_FIELDS, "scene")
    same = np.array_equal(steps.step, expected.step) and np.array_equal(steps.begin, expected.begin)
    return same and all(np.array_equal(getattr(steps.stacked, f), getattr(expected.stacked, f)) for f in fields)


@pytest.fixture(params=[10, 100_000], ids=["stored", "in memory"])
def rows_max(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "BLOCK_ROWS", request.param)
    return int(request.param)


def collected(tables: list[AgentTable]) -> Steps:
    builder = StepsBuilder()
    for table in tables:
        builder.add(table)
    return builder.steps()


def test_collected_tables_are_the_same_steps(crowd: Crowd, rows_max: int) -> None:
    tables = crowd(9)
    for order in (tables, tables[::-1], [*tables[3:], *tables[:3]]):
        steps = collected([*order, *crowd(4)[:2]])  # of two for one step, the first counts
        assert isinstance(steps, StoredSteps) == (rows_max == 10) and equal(steps, Steps(tables))
        assert [table.id.tolist() for table in steps] == [table.id.tolist() for table in tables]
        assert steps[-1].x.tolist() == tables[-1].x.tolist() and len(steps[2:5]) == 3
        later = steps.after(8)
        assert equal(later, Steps(tables[4:])) and equal(later.after(9), Steps(tables[5:]))
        assert later.ids.tolist() == Steps(tables[4:]).ids.tolist()


def test_blocks_are_parts_of_the_steps(crowd: Crowd, rows_max: int) -> None:
    tables = crowd(9)
    for steps in (collected(tables), Steps(tables)):
        blocks = [*steps.blocks()]
        assert [k for begin, end in blocks for k in range(begin, end)] == [*range(9)]
        for begin, end in blocks:
            assert equal(steps.part(begin, end), Steps(tables[begin:end]))
            assert len(steps.part(begin, end).stacked) <= rows_max or end - begin == 1
        assert equal(steps.part(7, 12), Steps(tables[7:])) and not len(steps.part(20, 30))
    assert (len(blocks) > 1) == (rows_max == 10)
    assert steps.part(0, 9) is steps, "with what is kept of it"


def test_a_few_agents_are_taken_out_of_all_steps(crowd: Crowd, rows_max: int) -> None:
    tables = crowd(9)
    asked = [33, 3, 4]
    expected = Steps([table.take(np.isin(table.id, asked)) for table in tables])
    for steps in (collected(tables), Steps(tables)):
        assert equal(steps.only(asked), expected)
        groups = [*steps.groups(asked)]
        assert [agent for group, _ in groups for agent in group] == sorted(asked)
        assert all(equal(own, steps.only(group)) for group, own in groups)
    assert (len(groups) > 1) == (rows_max == 10)
    assert not [*Steps([]).groups([])] and not len(Steps([]).only([1]))


def test_stored_steps_take_the_memory_of_a_block(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BLOCK_ROWS", 2000)
    columns = [np.zeros(100, DTYPES[field]) for field in ARRAY_FIELDS]
    tracemalloc.start()
    steps = collected([])  # numpy's own, once
    tracemalloc.reset_peak()
    builder = StepsBuilder()
    for step in range(1000):
        builder.add(AgentTable(step, *(column.copy() for column in columns)))
    steps = builder.steps()
    assert sum(float(steps.part(begin, end).stacked.x.sum()) for begin, end in steps.blocks()) == 0.0
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(steps) == 1000 and peak < 0.2 * 100_000 * module.ROW.itemsize


def test_a_full_disk_is_told(monkeypatch: pytest.MonkeyPatch, crowd: Crowd) -> None:
    builder = StepsBuilder()
    monkeypatch.setattr(builder, "_file", open("/dev/full", "wb", buffering=0))  # noqa: PTH123, SIM115
    with pytest.raises(InputError, match="cannot hold the data of a run: No space left on device"):
        builder.add(crowd(1)[0])


def test_tracks_of_later_steps_are_those_of_all(crowd: Crowd) -> None:
    tables = crowd(12)
    later, expected = Steps(tables).after(9), Steps(tables[5:])
    assert later.ids.tolist() == expected.ids.tolist() and np.array_equal(later.agent, expected.agent)
    asked = np.array([0, 3, 4, 33, 99])
    for agent in asked.tolist():
        assert np.array_equal(later.track(agent), expected.track(agent))
    for k in range(-1, 9):
        number = np.full(len(asked), k)
        assert np.array_equal(later.rows_until(number, asked), expected.rows_until(number, asked))
    assert later.ids.tolist() == Steps(tables).after(8).after(9).ids.tolist(), "later ones of later ones"
    assert not len(Steps(tables).after(99).ids) and not len(Steps([]).after(0).ids)
