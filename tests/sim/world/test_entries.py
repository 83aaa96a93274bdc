"""Who enters when its log begins, who waits, and who never gets onto the road."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from litsim_sim.core.scene import OBSTACLE_KINDS, AgentTable, Controller, Kind
from litsim_sim.scenario.log import Log
from litsim_sim.world.entries import DECELERATION, GAP, Entries

NEW, OTHER, BEGINS, ENDS = 7, 2, 20, 40
PLACE = {"x": 100.0, "y": -5.49}  # where the log of NEW begins


@pytest.fixture(scope="module")
def log(make_scenario: Callable[..., Any], track: type) -> Log:
    entering = track(id=NEW, first=BEGINS, last=ENDS, **PLACE)
    return make_scenario(track(id=1, x=400.0), track(id=OTHER, x=60.0), entering).log  # type: ignore[no-any-return]


@pytest.fixture
def standing(agent_table: Callable[..., AgentTable]) -> Callable[[float], AgentTable]:
    """OTHER, which stands `ahead` of the place of the entry [m, between the centres]."""
    return lambda ahead: agent_table(BEGINS, {"id": OTHER, "speed": 0.0} | PLACE | {"x": PLACE["x"] + ahead})


def begin(entries: Entries, log: Log, driven: AgentTable) -> bool:
    """Whether NEW may follow its log from its first step on."""
    logged = log.table(BEGINS)
    may = entries.may_follow(logged, log.table(BEGINS - 1), driven, np.zeros(len(logged), np.bool_))
    assert may[logged.row(1)], "who was on the road stays on it"
    return bool(may[logged.row(NEW)])


def test_the_free_road_and_the_one_that_is_not(log: Log, standing: Callable[[float], AgentTable]) -> None:
    for ahead, free in ((60.0, True), (4.0, False), (0.0, False)):
        entries = Entries(log)
        assert begin(entries, log, standing(ahead)) is free
        assert entries.waiting == ({} if free else {NEW: BEGINS})


@pytest.mark.parametrize("kind", OBSTACLE_KINDS)
def test_pedestrians_and_cyclists_wait_for_nobody(
    make_scenario: Callable[..., Any], track: type, standing: Callable[[float], AgentTable], kind: Kind
) -> None:
    entering = track(id=NEW, first=BEGINS, last=ENDS, kind=kind, **PLACE)
    other = make_scenario(track(id=1, x=400.0), track(id=OTHER, x=60.0), entering).log
    entries = Entries(other)
    assert begin(entries, other, standing(0.0)) and entries.waiting == {}


def test_who_waits_enters_as_fast_as_the_room_allows(log: Log, standing: Callable[[float], AgentTable]) -> None:
    entries = Entries(log)
    assert not begin(entries, log, standing(4.0))
    after = log.table(BEGINS + 1).take(np.array([0]))
    road = AgentTable.merged(BEGINS + 1, (after, standing(15.0)))
    table = entries.admit(road, log.table(BEGINS + 1))
    row = table.row(NEW)
    assert table.speed[row] == pytest.approx(np.sqrt(2.0 * DECELERATION * (15.0 - 4.5 - GAP)))
    assert (table.x[row], table.acceleration[row], table.controller[row]) == (PLACE["x"], 0.0, Controller.POLICY)
    assert table.id.tolist() == [1, OTHER, NEW]
    assert (entries.waiting, entries.late, entries.never_entered) == ({}, {NEW}, set())


def test_who_waits_until_its_log_ends_never_enters(log: Log, standing: Callable[[float], AgentTable]) -> None:
    entries = Entries(log)
    assert not begin(entries, log, standing(4.0))
    still = entries.admit(standing(4.0), log.table(BEGINS + 1))
    assert still.row(NEW) < 0 and entries.waiting
    gone = entries.admit(standing(60.0), log.table(ENDS + 1))
    assert gone.row(NEW) < 0
    assert (entries.waiting, entries.late, entries.never_entered) == ({}, set(), {NEW})


def test_who_is_on_a_late_log_is_in_the_way_as_well(log: Log, standing: Callable[[float], AgentTable]) -> None:
    """OTHER follows its log, but not where the recording has it: only then does it hold an entry back."""
    nobody = AgentTable.empty(BEGINS)
    before = AgentTable.merged(BEGINS - 1, (log.table(BEGINS - 1).take(np.array([0])), standing(4.0)))
    logged = log.table(BEGINS)
    there = AgentTable.merged(BEGINS, (logged.take(logged.id != OTHER), standing(4.0)))
    late = there.id == OTHER
    for displaced, free in ((np.zeros_like(late), True), (~late, True), (late, False)):
        entries = Entries(log)
        assert bool(entries.may_follow(there, before, nobody, displaced)[there.row(NEW)]) is free
        assert entries.waiting == ({} if free else {NEW: BEGINS})


def test_who_is_in_the_way_in_the_recording_holds_nobody_back(
    make_scenario: Callable[..., Any], track: type, agent_table: Callable[..., AgentTable]
) -> None:
    """OTHER is recorded 4 m ahead of the entry, at its speed; with a residual of 0.1 m that is no reason to wait."""
    entering = track(id=NEW, first=BEGINS, last=ENDS, **PLACE)
    close = make_scenario(track(id=1, x=400.0), track(id=OTHER, x=PLACE["x"] + 4.0 - 20.0), entering).log
    logged = close.table(BEGINS)
    logged.x[logged.row(OTHER)] += 0.1
    entries = Entries(close)
    may = entries.may_follow(logged, close.table(BEGINS - 1), AgentTable.empty(BEGINS), logged.id == OTHER)
    assert may[logged.row(NEW)] and not entries.waiting
