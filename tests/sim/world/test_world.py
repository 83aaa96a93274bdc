"""The world that the bridge steps, on scenarios of a few vehicles on straight tracks."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from litsim_sim.core.dynamics import Motion, VehicleLimits, bicycle_step
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import (
    ARRAY_FIELDS,
    STEP_S,
    AgentTable,
    Controller,
    ControlSource,
    ControlTable,
    EgoCommand,
    EgoMode,
)
from litsim_sim.core.stages import EndReason, RunEnd
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.entries import GAP
from litsim_sim.world.log_policy import COMFORT_ACCELERATION
from litsim_sim.world.world import World

EGO, OTHER, THIRD = 1, 2, 3
HISTORY = 3

Commands = Mapping[int, tuple[float, float]]


def controls(step: int, commands: Commands, source: ControlSource = ControlSource.POLICY) -> ControlTable:
    """Acceleration and yaw rate of each agent."""
    agents = sorted(commands)
    acceleration, yaw_rate = (np.array([commands[a][i] for a in agents], np.float64) for i in (0, 1))
    sources = np.full(len(agents), source, np.uint8)
    return ControlTable(step, np.array(agents, np.int64), acceleration, np.zeros(len(agents)), yaw_rate, sources)


def follow(step: int) -> EgoCommand:
    return EgoCommand(step, mode=EgoMode.FOLLOW_LOG)


def advance(
    world: World,
    table: AgentTable,
    steps: int,
    commands: Commands | None = None,
    ego: tuple[float, float] | None = None,
) -> list[AgentTable]:
    """The next `steps` tables, everybody else and, without `ego`, the ego following the log."""
    tables = []
    for _ in range(steps):
        now = {agent: command for agent, command in (commands or {}).items() if table.row(agent) >= 0}
        answer = follow(table.step) if ego is None else EgoCommand(table.step, *ego)
        table = world.step(controls(table.step, now), answer)
        tables.append(table)
    return tables


def value(table: AgentTable, agent: int, field: str) -> float:
    row = table.row(agent)
    assert row >= 0, f"agent {agent} is not on the road at step {table.step}"
    return float(getattr(table, field)[row])


def assert_as_logged(table: AgentTable, scenario: Scenario, agent: int) -> None:
    logged = scenario.log.table(table.step)
    for field in set(ARRAY_FIELDS) - {"controller"}:
        assert value(table, agent, field) == value(logged, agent, field), (table.step, agent, field)


def bicycle(table: AgentTable, agent: int, acceleration: float, yaw_rate: float) -> Motion:
    """Where the bicycle model takes an agent from `table`."""
    row = [table.row(agent)]
    motion = Motion(*(getattr(table, f)[row] for f in ("x", "y", "yaw", "speed", "acceleration", "yaw_rate")))
    return bicycle_step(motion, table.length[row], np.array([acceleration]), np.array([yaw_rate]), VehicleLimits())


def assert_moved(before: AgentTable, after: AgentTable, agent: int, acceleration: float, yaw_rate: float) -> None:
    expected = bicycle(before, agent, acceleration, yaw_rate)
    for field in ("x", "y", "yaw", "speed", "acceleration", "yaw_rate"):
        assert value(after, agent, field) == getattr(expected, field)[0], (after.step, agent, field)
    for field in ("length", "width", "kind"):
        assert value(after, agent, field) == value(before, agent, field)


@pytest.fixture(scope="module")
def three(make_scenario: Any, track: Any, lane_centres: tuple[float, ...]) -> Scenario:
    """The ego, a neighbour that leaves after step 40, and a third one that enters at step 10."""
    return make_scenario(
        track(EGO, x=100.0, speed=10.0, last=100),
        track(OTHER, x=100.0, y=lane_centres[3], speed=12.0, last=40),
        track(THIRD, x=50.0, y=lane_centres[0], speed=14.0, first=10, last=100),
        history_steps=HISTORY,
    )


@pytest.fixture(scope="module")
def entry(make_scenario: Any, track: Any) -> Callable[..., Scenario]:
    """The ego brakes to about x = 109 m if it is told so; OTHER enters in its lane at step 20."""

    def make(**values: Any) -> Scenario:
        enters = {"x": 109.0, "speed": 10.0, "first": 20, "last": 90} | values
        return make_scenario(track(EGO, x=100.0, speed=10.0, last=100), track(OTHER, **enters), history_steps=HISTORY)

    return make


@pytest.fixture(scope="module")
def blocked(entry: Callable[..., Scenario]) -> Scenario:
    return entry()


# Replay


def test_replay_is_exactly_the_log(three: Scenario) -> None:
    world = World(three)
    tables = [world.reset()]
    tables += advance(world, tables[0], three.total_steps)
    assert [table.step for table in tables] == list(range(101))
    for table in tables:
        logged = three.log.table(table.step)
        for field in set(ARRAY_FIELDS) - {"controller"}:
            np.testing.assert_array_equal(getattr(table, field), getattr(logged, field), field)
        others = table.id != EGO
        assert (table.controller[others] == Controller.LOG).all()
        assert value(table, EGO, "controller") == (Controller.LOG if table.step < HISTORY else Controller.EGO)
    assert [len(tables[step]) for step in (0, 9, 10, 40, 41, 100)] == [2, 2, 3, 3, 2, 2]
    assert world.contacts == {}
    assert world.summary()["late_entries"] == world.summary()["never_entered"] == []


def test_beyond_the_log_the_road_is_empty(three: Scenario) -> None:
    world = World(three)
    last = advance(world, world.reset(), three.total_steps + 2)[-1]
    assert (last.step, len(last)) == (three.total_steps + 2, 0)


# Ego


def test_the_ego_follows_its_log_through_the_history_and_then_drives(three: Scenario) -> None:
    world = World(three)
    before, seen = world.reset(), []
    for step in range(10):
        assert world.ego_is_driven == (step >= HISTORY)
        after = world.step(ControlTable.empty(step), EgoCommand(step, -2.0, 0.05))
        if step < HISTORY:
            assert_as_logged(after, three, EGO)
        else:
            assert_moved(before, after, EGO, -2.0, 0.05)
        seen.append(int(value(after, EGO, "controller")))
        before = after
    assert seen == [Controller.LOG] * (HISTORY - 1) + [Controller.EGO] * (11 - HISTORY)


def test_an_ego_that_has_driven_comes_back_to_its_log_without_a_jump(three: Scenario) -> None:
    world = World(three)
    tables = advance(world, world.reset(), HISTORY)
    tables += advance(world, tables[-1], 10, ego=(-2.0, 0.0))
    lag = value(three.log.table(13), EGO, "x") - value(tables[-1], EGO, "x")
    assert lag == pytest.approx(1.0)
    tables += advance(world, tables[-1], 60)
    x = np.array([value(table, EGO, "x") for table in tables])
    assert np.abs(np.diff(x, 2)).max() <= 2.01 * STEP_S**2  # no harder than it has braked
    assert {int(value(table, EGO, "controller")) for table in tables[HISTORY:]} == {Controller.EGO}
    assert_as_logged(tables[-1], three, EGO)


def test_an_ego_whose_log_is_over_drives_on(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(track(EGO, x=100.0, last=10), track(OTHER, x=300.0, last=60), history_steps=HISTORY)
    world = World(scenario)
    tables = advance(world, world.reset(), 30, ego=(0.0, 0.0))
    assert value(tables[-1], EGO, "x") == pytest.approx(130.0)
    gone = advance(World(scenario), scenario.log.table(0), 0)
    assert gone == []
    world = World(scenario)
    tables = advance(world, world.reset(), 12)
    assert [table.row(EGO) >= 0 for table in tables[8:]] == [True, True, False, False]
    assert not world.ego_is_driven


# The end of a run


@pytest.fixture(scope="module")
def leaving(make_scenario: Any, track: Any, lane_centres: tuple[float, ...]) -> Scenario:
    """An ego that soon passes the end of the net, at x = 640 m, and somebody far behind it."""
    tracks = track(EGO, x=604.0, speed=10.0, last=35), track(OTHER, x=500.0, y=lane_centres[3], speed=2.0, last=60)
    return make_scenario(*tracks, history_steps=HISTORY)


def test_the_run_is_over_when_the_ego_has_passed_an_end_of_the_net(leaving: Scenario) -> None:
    world = World(leaving)
    tables = [world.reset()]
    while world.ended is None and tables[-1].step < leaving.total_steps:
        tables += advance(world, tables[-1], 1, ego=(2.0, 0.0))
    assert world.ended == RunEnd(EndReason.NET_END, tables[-1].step, "downstream_3")
    assert tables[-1].row(EGO) < 0 and tables[-1].row(OTHER) >= 0
    reach = 642.0  # half a lane's width beyond the end still is on the road
    assert value(tables[-2], EGO, "x") <= reach < value(tables[-2], EGO, "x") + 0.2 * value(tables[-2], EGO, "speed")
    assert world.summary()["ended"] == {"reason": "net_end", "step": tables[-1].step, "lane": "downstream_3"}
    assert world.reset().step == 0 and world.ended is None, "the next run begins anew"


def test_an_ego_that_leaves_the_road_to_the_side_has_not_left_the_net(leaving: Scenario) -> None:
    world = World(leaving)
    tables = advance(world, world.reset(), HISTORY)
    tables += advance(world, tables[-1], 10, ego=(-2.0, 0.4))
    tables += advance(world, tables[-1], 40, ego=(0.0, 0.0))
    on_road = leaving.lane_map.inside_road(*(np.array([value(tables[-1], EGO, f)]) for f in ("x", "y")))
    assert not on_road[0], "nor does it vanish because its log is over"
    assert world.ended is None
    assert world.summary()["ended"] == {"reason": "time", "step": tables[-1].step, "lane": ""}


def test_the_run_is_over_when_the_log_is_that_the_ego_follows(leaving: Scenario) -> None:
    world = World(leaving)
    tables = advance(world, world.reset(), 40)
    assert world.ended == RunEnd(EndReason.LOG_OVER, 36)
    assert tables[34].row(EGO) >= 0 > tables[35].row(EGO)


@pytest.fixture(scope="module")
def bumping(make_scenario: Any, track: Any, lane_centres: tuple[float, ...]) -> Callable[..., Scenario]:
    """An ego 14 m behind somebody whom it does not reach in its log; and two far away who touch in theirs."""

    def make(**fields: Any) -> Scenario:
        ego = track(EGO, x=100.0, y=lane_centres[1], speed=4.0, last=60)
        slow = track(OTHER, x=118.5, y=lane_centres[1], speed=4.0, last=60)
        apart = [track(agent, x=x, y=lane_centres[3], speed=4.0, last=60) for agent, x in ((THIRD, 300.0), (4, 302.0))]
        return make_scenario(ego, slow, *apart, history_steps=HISTORY, **fields)

    return make


@pytest.mark.parametrize(("after", "steps"), [(0.0, 0), (0.5, 5), (None, None)])
def test_the_run_is_over_some_time_after_the_ego_has_touched_somebody(
    bumping: Callable[..., Scenario], after: float | None, steps: int | None
) -> None:
    world = World(bumping(end_after_contact_s=after))
    tables = advance(world, world.reset(), HISTORY)
    while world.ended is None and tables[-1].step < 40:
        tables += advance(world, tables[-1], 1, ego=(3.0, 0.0))
    touched = world.contacts[EGO, OTHER]
    assert world.contacts[THIRD, 4] < touched, "others do not count"
    if steps is None:
        assert world.ended is None
    else:
        assert world.ended == RunEnd(EndReason.CONTACT, touched + steps) == RunEnd(EndReason.CONTACT, tables[-1].step)
        assert world.summary()["ended"] == {"reason": "contact", "step": touched + steps, "lane": ""}
        world.reset()
        assert world.ended is None, "the next run begins anew"


def test_whom_the_ego_touches_in_its_log_ends_no_run(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(
        track(EGO, x=100.0, speed=4.0, last=40), track(OTHER, x=103.0, speed=4.0, last=40), end_after_contact_s=0.0
    )
    world = World(scenario)
    advance(world, world.reset(), 20, ego=(0.0, 0.0))
    assert (EGO, OTHER) in world.contacts and world.ended is None


# Controlled agents


def test_who_is_no_longer_listed_rejoins_its_log_without_a_jump(three: Scenario) -> None:
    world = World(three)
    tables = [world.reset()]
    for step in range(10, 20):  # 1 m/s slower, 0.5 m behind, a little to the left
        tables += advance(world, tables[-1], 10) if step == 10 else []
        command = {THIRD: (-1.0, 0.02 if step < 15 else -0.02)}
        tables.append(world.step(controls(step, command), follow(step)))
    off = three.log.table(20)
    assert value(tables[-1], THIRD, "x") - value(off, THIRD, "x") == pytest.approx(-0.5, abs=0.01)
    assert abs(value(tables[-1], THIRD, "y") - value(off, THIRD, "y")) > 0.05
    tables += advance(world, tables[-1], 50)
    seen = tables[10:]
    assert {int(value(table, THIRD, "controller")) for table in tables[21:]} == {Controller.LOG}
    x, y, speed = (np.array([value(table, THIRD, f) for table in seen]) for f in ("x", "y", "speed"))
    acceleration = np.hypot(np.diff(x, 2), np.diff(y, 2))[10:] / STEP_S**2
    assert acceleration.max() <= 1.02 * COMFORT_ACCELERATION
    assert np.abs(np.diff(speed)).max() <= 1.02 * COMFORT_ACCELERATION * STEP_S
    assert_as_logged(tables[-1], three, THIRD)


# The end of the log under control


def test_who_is_controlled_when_its_log_ends_drives_on_until_off_the_road(
    make_scenario: Any, track: Any, lane_centres: tuple[float, ...]
) -> None:
    scenario = make_scenario(
        track(EGO, x=100.0, last=200),
        track(OTHER, x=560.0, y=lane_centres[3], speed=20.0, last=10),
        history_steps=HISTORY,
    )
    world = World(scenario)
    tables = advance(world, world.reset(), 60, {OTHER: (0.0, 0.0)})
    there = [table for table in tables if table.row(OTHER) >= 0]
    assert len(there) == there[-1].step > 30  # it left once, and did not come back
    inside = [bool(scenario.lane_map.inside_road(t.x, t.y)[t.row(OTHER)]) for t in there]
    assert all(inside[10:])
    assert 640.0 - 2.0 <= value(there[-1], OTHER, "x") <= 640.0
    assert value(there[-1], OTHER, "controller") == Controller.POLICY


def test_who_is_released_after_its_log_has_ended_leaves(three: Scenario) -> None:
    world = World(three)
    tables = advance(world, world.reset(), 44, {OTHER: (0.0, 0.0)})
    assert tables[-1].row(OTHER) >= 0
    tables += advance(world, tables[-1], 3)
    assert [t.row(OTHER) for t in tables[-3:]] == [-1] * 3


def test_who_drives_off_the_road_while_its_log_goes_on_stays(three: Scenario) -> None:
    world = World(three)
    tables = advance(world, world.reset(), 40, {OTHER: (0.0, -0.3)})
    last = tables[-1]
    assert not three.lane_map.inside_road(last.x, last.y)[last.row(OTHER)]
    assert advance(world, last, 1, {OTHER: (0.0, 0.0)})[0].row(OTHER) < 0


# Entries


def test_a_blocked_agent_waits_and_enters_late_under_policy(blocked: Scenario) -> None:
    world = World(blocked)
    tables = advance(world, world.reset(), HISTORY)
    tables += advance(world, tables[-1], 27, ego=(-8.0, 0.0))
    assert value(tables[-1], EGO, "speed") == 0.0
    assert tables[-1].row(OTHER) < 0
    assert world.entries.waiting == {OTHER: 20}
    assert world.summary()["never_entered"] == [OTHER]
    tables += advance(world, tables[-1], 40, {OTHER: (-8.0, 0.0)}, ego=(4.0, 0.0))
    entered = next(table for table in tables if table.row(OTHER) >= 0)
    assert entered.step > 30
    assert all(table.row(OTHER) >= 0 for table in tables[entered.step :])
    assert value(entered, OTHER, "controller") == Controller.POLICY
    assert value(entered, OTHER, "x") == 109.0
    assert 0.0 < value(entered, OTHER, "speed") <= 10.0
    assert value(entered, OTHER, "acceleration") == value(entered, OTHER, "yaw_rate") == 0.0
    assert value(entered, EGO, "x") - value(entered, OTHER, "x") >= 4.5 + GAP
    assert world.contacts == {}
    assert world.entries.waiting == {}
    assert (world.summary()["late_entries"], world.summary()["never_entered"]) == ([OTHER], [])


def test_a_log_that_begins_at_a_standstill_waits_as_well(entry: Callable[..., Scenario]) -> None:
    """And enters once the road is free, although it stands."""
    world = World(entry(speed=0.0))
    tables = advance(world, world.reset(), 30, ego=(-8.0, 0.0))
    assert world.contacts == {}
    assert world.entries.waiting == {OTHER: 20}
    tables += advance(world, tables[-1], 30, {OTHER: (0.0, 0.0)}, ego=(4.0, 0.0))
    assert world.entries.late == {OTHER}
    assert (value(tables[-1], OTHER, "x"), value(tables[-1], OTHER, "speed")) == (109.0, 0.0)
    assert world.contacts == {}


def test_who_would_be_run_into_from_behind_waits_until_it_is_passed(
    entry: Callable[..., Scenario], make_scenario: Any, track: Any
) -> None:
    """OTHER would enter 9 m ahead of the ego, which is 15 m/s faster."""
    scenario = make_scenario(
        track(EGO, x=60.0, speed=20.0, last=60), track(OTHER, x=109.0, speed=5.0, first=20, last=60), history_steps=3
    )
    world = World(scenario)
    tables = advance(world, world.reset(), 20, ego=(0.0, 0.0))
    assert value(tables[-1], EGO, "x") == pytest.approx(100.0)
    assert world.entries.waiting == {OTHER: 20}
    tables += advance(world, tables[-1], 30, {OTHER: (0.0, 0.0)}, ego=(0.0, 0.0))
    entered = next(table for table in tables if table.row(OTHER) >= 0)
    assert value(entered, EGO, "x") > 109.0 + 4.5
    assert world.contacts == {}


def test_two_that_wait_for_one_place_enter_one_after_the_other(make_scenario: Any, track: Any) -> None:
    scenario = make_scenario(
        track(EGO, x=100.0, last=100),
        track(OTHER, x=108.0, first=20, last=99),
        track(THIRD, x=108.5, first=25, speed=12.0, last=99),
        history_steps=HISTORY,
    )
    world = World(scenario)
    tables = advance(world, world.reset(), 30, ego=(-8.0, 0.0))
    assert world.entries.waiting == {OTHER: 20, THIRD: 25}
    tables += advance(world, tables[-1], 69, {OTHER: (1.0, 0.0), THIRD: (-2.0, 0.0)}, ego=(4.0, 0.0))
    first, second = (next(t.step for t in tables if t.row(agent) >= 0) for agent in (OTHER, THIRD))
    assert 30 < first < second
    assert world.contacts == {}
    assert world.entries.late == {OTHER, THIRD}


def test_who_has_entered_late_and_is_not_listed_goes_back_to_its_log(blocked: Scenario) -> None:
    world = World(blocked)
    tables = advance(world, world.reset(), 20, ego=(-8.0, 0.0))
    tables += advance(world, tables[-1], 40, ego=(4.0, 0.0))
    x = np.array([value(table, OTHER, "x") for table in tables if table.row(OTHER) >= 0])
    assert len(x) > 10
    assert x[0] == 109.0
    assert np.diff(x).min() > 0.0
    assert np.diff(x)[0] < 10.5 * STEP_S
    assert np.abs(np.diff(x, 2)).max() <= 1.02 * COMFORT_ACCELERATION * STEP_S**2


# Contacts


def test_a_second_contact_of_a_pair_is_the_same_contact(blocked: Scenario) -> None:
    world = World(blocked, guard_entries=False)
    tables = advance(world, world.reset(), 22, ego=(-8.0, 0.0))
    assert world.contacts == {(EGO, OTHER): 20}
    tables += advance(world, tables[-1], 10, ego=(-8.0, 0.0))
    assert len(overlapping_pairs(*(getattr(tables[-1], f) for f in ("x", "y", "yaw", "length", "width")))) == 0
    advance(world, tables[-1], 40, {OTHER: (-8.0, 0.0)}, ego=(4.0, 0.0))
    assert world.contacts == {(EGO, OTHER): 20} and world.summary()["contacts"] == 1


def test_an_overlap_at_step_0_is_a_contact(make_scenario: Any, track: Any) -> None:
    world = World(make_scenario(track(EGO, x=100.0), track(OTHER, x=103.0), history_steps=HISTORY))
    world.reset()
    assert world.contacts == {(EGO, OTHER): 0}


# Answers that cannot be applied


@pytest.mark.parametrize("of_controls", [-1, 1])
def test_controls_of_another_step_are_refused(three: Scenario, of_controls: int) -> None:
    world = World(three)
    table = advance(world, world.reset(), 5)[-1]
    with pytest.raises(ValueError, match=rf"steps {5 + of_controls} \(controls\) and 5 \(ego\), expected 5"):
        world.step(ControlTable.empty(5 + of_controls), follow(5))
    with pytest.raises(ValueError, match=rf"steps 5 \(controls\) and {5 + of_controls} \(ego\), expected 5"):
        world.step(ControlTable.empty(5), follow(5 + of_controls))
    assert advance(world, table, 1)[0].step == 6  # and nothing has happened


# Again, and shown


def test_a_reset_knows_nothing_of_the_runs_before(blocked: Scenario, entry: Callable[..., Scenario]) -> None:
    """Neither of contacts, nor of agents that waited, nor of residuals that were fading."""
    unguarded, guarded, outwaited = World(blocked, guard_entries=False), World(blocked), World(entry(last=40))
    tables = advance(unguarded, unguarded.reset(), 22, ego=(-8.0, 0.0))
    tables += advance(unguarded, tables[-1], 10, {OTHER: (-3.0, 0.1)}, ego=(-8.0, 0.0))
    advance(unguarded, tables[-1], 2)
    advance(guarded, guarded.reset(), 25, ego=(-8.0, 0.0))
    advance(outwaited, outwaited.reset(), 50, ego=(-8.0, 0.0))
    assert unguarded.contacts
    assert guarded.entries.waiting
    assert outwaited.entries.never_entered
    nothing = {"contacts": 0, "late_entries": [], "never_entered": [], "sumo_deviation_m": None}

    def ended(step: int) -> dict[str, Any]:
        return {"ended": {"reason": "time", "step": step, "lane": ""}}

    for world in (unguarded, guarded, outwaited):
        tables = [world.reset()]
        assert world.summary() == nothing | ended(0)
        tables += advance(world, tables[-1], 60)
        for table in tables:
            for agent in table.id.tolist():
                assert_as_logged(table, world.scenario, agent)
        assert world.summary() == nothing | ended(60)


class RecordingMirror:
    """Notes what it is shown and asked; it is 0.5 m off at step 9 and 0.25 m at step 10."""

    def __init__(self) -> None:
        self.shown: list[AgentTable] = []
        self.asked: list[int] = []
        self.closed = 0

    def show(self, table: AgentTable) -> None:
        self.shown.append(table)

    def deviation(self, table: AgentTable) -> np.ndarray:
        assert table is self.shown[-1]
        self.asked.append(table.step)
        return np.full(len(table), {9: 0.5, 10: 0.25}.get(table.step, 0.0))

    def close(self) -> None:
        self.closed += 1


def test_the_mirror_is_shown_every_step_and_its_deviation_checked_once_a_second(three: Scenario) -> None:
    mirror = RecordingMirror()
    world = World(three, mirror=mirror)
    first = world.reset()
    tables = [first, *advance(world, first, 22)]
    world.catch_up()
    assert all(a is b for a, b in zip(mirror.shown, tables, strict=True))
    assert mirror.asked == [0, 10, 20]
    assert world.summary()["sumo_deviation_m"] == 0.25
    assert mirror.closed == 0
    world.close()
    assert mirror.closed == 1


def test_the_mirror_is_shown_a_step_once_whoever_asks_when(three: Scenario) -> None:
    mirror = RecordingMirror()
    world = World(three, mirror=mirror)
    world.reset()
    assert not mirror.shown, "nobody has had the time"
    for step in range(4):
        if step % 2:
            world.catch_up()
            world.catch_up()
        world.step(ControlTable.empty(step), follow(step))
        assert [table.step for table in mirror.shown] == list(range(step + 1))
    world.summary()
    assert mirror.shown[-1].step == 4, "the last step belongs to the summary"


# Whatever the answers are

answers = st.lists(
    st.tuples(
        st.dictionaries(st.sampled_from([OTHER, THIRD]), st.tuples(st.floats(-20, 20), st.floats(-2, 2)), max_size=2),
        st.tuples(st.floats(-20, 20), st.floats(-2, 2)),
    ),
    min_size=1,
    max_size=45,
)


@settings(max_examples=40)
@given(answers)
def test_invariants_under_any_answers(three: Scenario, given_answers: list[Any]) -> None:
    world = World(three)
    table, ever_off, contacts = world.reset(), {EGO}, {}
    for step, (commands, ego) in enumerate(given_answers):
        before, table = table, world.step(controls(step, commands), EgoCommand(step, *ego))
        assert table.step == step + 1
        assert (np.diff(table.id) > 0).all()
        assert all(np.isfinite(getattr(table, field)).all() for field in ("x", "y", "yaw", "speed"))
        assert (table.speed >= 0).all()
        ever_off |= {agent for agent in commands if before.row(agent) >= 0} | world.entries.late
        for agent in table.id.tolist():
            if agent in commands and before.row(agent) >= 0:
                assert_moved(before, table, agent, *commands[agent])
            elif agent not in ever_off:
                assert_as_logged(table, three, agent)
        boxes = (getattr(table, field) for field in ("x", "y", "yaw", "length", "width"))
        for i, j in overlapping_pairs(*boxes):
            contacts.setdefault((int(table.id[i]), int(table.id[j])), table.step)
    assert world.contacts == contacts


# The ego's vehicle


def test_the_ego_has_a_vehicle_of_its_own_and_nobody_else_notices(make_scenario: Any, track: Any) -> None:
    tracks = (track(EGO, x=100.0, speed=10.0, last=100), track(OTHER, x=150.0, speed=10.0, last=100))
    made = {
        name: make_scenario(*tracks, history_steps=HISTORY, vehicle=values)
        for name, values in (("usual", {}), ("weak", {"deceleration_max": 1.5, "curvature_max": 0.005}))
    }
    ends = {}
    for name, scenario in made.items():
        world = World(scenario)
        table = advance(world, world.reset(), HISTORY)[-1]
        ends[name] = advance(world, table, 10, {OTHER: (-4.0, 0.3)}, ego=(-4.0, 0.3))[-1]
    assert value(ends["usual"], EGO, "acceleration") == pytest.approx(-4.0)
    assert value(ends["weak"], EGO, "acceleration") == pytest.approx(-1.5)
    assert value(ends["weak"], EGO, "yaw_rate") == pytest.approx(0.005 * 8.575)
    for field in set(ARRAY_FIELDS) - {"controller"}:
        assert value(ends["usual"], OTHER, field) == value(ends["weak"], OTHER, field), field


def test_dead_time_begins_with_what_the_ego_did_and_anew_after_its_log(make_scenario: Any, track: Any) -> None:
    tracks = [track(EGO, x=100.0, speed=10.0, last=100)]
    world = World(make_scenario(*tracks, history_steps=HISTORY, vehicle={"delay_s": 0.2}))
    table = advance(world, world.reset(), HISTORY)[-1]
    for _ in range(2):
        driven = advance(world, table, 5, ego=(-2.0, 0.0))
        assert [value(t, EGO, "acceleration") for t in driven[2:]] == pytest.approx([-2.0] * 3)
        assert value(driven[0], EGO, "acceleration") == value(driven[1], EGO, "acceleration") != -2.0
        table = advance(world, driven[-1], 40)[-1]
