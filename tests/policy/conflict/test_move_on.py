"""The next state of each agent off its log, whatever the others are in."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from litsim_policy.conflict import own_intent
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.diverged import DivergedAgents, DivergedNow
from litsim_policy.conflict.takeover import move_on
from litsim_policy.conflict.way_back import obstructed
from litsim_policy.motion.reference_path import ReferencePath
from litsim_sim.core.takeover import PathSource, TakeoverReason, TakeoverState

NOW = 40
HELD, HANDBACK, RELEASED, OWN = TakeoverState
CONFIG = ConflictConfig(held_steps_min=5, clear_steps=5)


def lane(y: float) -> ReferencePath:
    return ReferencePath(np.column_stack([np.arange(500.0), np.full(500, y)]))


def diverged(count: int) -> DivergedAgents:
    """Agents 1 .. count, far apart in y, held since step 10 with their goals at x = 50."""
    off = DivergedAgents.empty()
    for agent in range(1, count + 1):
        y = 20.0 * agent
        goal, reason = np.array([50.0, y, 0.0]), TakeoverReason.CONFLICT
        off = off.joined(DivergedAgents.opened(agent, 99, 10, reason, goal, (lane(y), PathSource.ROUTE, lane(y))))
    return off


@pytest.fixture
def here(agent_table):
    """Agents of `off` at x and 10 m/s, on their paths; their logs are `ahead` of them. And others."""

    def make(off: DivergedAgents, *others: dict[str, float], x: float = 100.0, ahead: float = 0.0) -> DivergedNow:
        mine = ({"id": a, "x": x, "y": 20.0 * a, "speed": 10.0} for a in off.agent.tolist())
        table = agent_table(NOW, *mine, *others)
        rows, many = table.rows(off.agent), np.ones(len(off))
        log: Any = SimpleNamespace(ids=table.id)
        place = (x + ahead) * many, off.pose[:, 1], 0.0 * many, 10.0 * many
        own = table.x[rows], table.y[rows], table.yaw[rows], table.speed[rows]
        return DivergedNow(off, table, rows, log, rows, 0 * rows, many > 0, *place, *own)

    return make


def moved_on(now: DivergedNow, *held_back: int, config: ConflictConfig = CONFIG) -> list[int]:
    """The states of all agents after a step at which all but those `held_back` are free."""
    everybody = np.ones(len(now.agents), np.bool_)
    free = ~np.isin(np.arange(len(everybody)), held_back)
    move_on(config, now, everybody, free, ~everybody, ~everybody)
    return now.agents.state.tolist()


def test_each_agent_goes_its_own_way(here) -> None:
    off = diverged(7)
    off.clear[:] = [3, 4, 9, 4, 0, 0, 0]
    off.state[:] = [HELD, HELD, HELD, HELD, HANDBACK, HANDBACK, HANDBACK]
    off.detected_step[3] = NOW - 4
    now = here(off)
    now.log_speed[5] = 8.0
    assert moved_on(now, 2, 6) == [
        HELD,  # free for four steps only
        HANDBACK,  # the fifth, beyond its goal
        HELD,  # not free: begins to count again
        HELD,  # free for long enough, but not held for long enough
        RELEASED,  # back on its log
        HANDBACK,  # too fast for its log as yet
        HELD,  # not free any more
    ]
    assert off.clear.tolist() == [4, 5, 0, 5, 1, 1, 0]
    assert off.source.tolist() == [PathSource.LOGGED if k in (1, 5) else PathSource.ROUTE for k in range(7)]


def test_by_its_own_intent_an_agent_drives_on_until_its_log_is_likely_again(here) -> None:
    off = diverged(4)
    off.state[:] = [HELD, OWN, HANDBACK, OWN]
    off.clear[:] = [0, 4, 5, 9]
    own, everybody = np.array([True, False, True, True]), np.ones(4, np.bool_)
    move_on(CONFIG, here(off), everybody, np.array([False, False, False, True]), own, ~everybody)
    assert off.state.tolist() == [OWN, HELD, OWN, HANDBACK]


def test_own_intent_takes_steady_driving_and_ends_with_a_conflict_of_the_own_way(here) -> None:
    """Of agents 1 to 5, the second brakes, the third stands, the fourth passes, and the last meets somebody."""
    off = diverged(5)
    off.source[3] = PathSource.LANE
    now = here(off)
    now.table.acceleration[1], now.speed[2] = -1.01 * own_intent.BRAKING, 0.5
    meets = np.array([False, False, False, False, True])
    detector: Any = SimpleNamespace(drive_into_conflict=lambda _, pairs: np.isin(np.arange(5), pairs[:, 0]) & meets)
    futures: Any = SimpleNamespace(rows=np.arange(5))
    pairs = np.column_stack([np.arange(5), np.roll(np.arange(5), 1)])
    look = partial(own_intent.drive_by_own_intent, CONFIG, detector, now, futures, pairs)
    for _ in range(own_intent.STEADY_STEPS - 1):
        assert not look().any()
    assert look().tolist() == [True, False, False, False, False]
    off.state[[0, 3, 4]] = OWN
    meets[0] = True
    assert off.steady.tolist()[3:] == [own_intent.STEADY_STEPS, -own_intent.STEADY_STEPS]
    assert [look().tolist()[0] for _ in range(CONFIG.confirm_steps)] == [True, True, False]
    assert look().tolist() == [False, False, False, True, False], "who passes goes on to drive by its own intent"


def test_those_taken_over_at_this_step_stay_as_they_are(here) -> None:
    off = diverged(2)
    off.clear[:] = 9
    everybody = np.ones(2, np.bool_)
    move_on(CONFIG, here(off), np.array([True, False]), everybody, ~everybody, ~everybody)
    assert (off.state.tolist(), off.clear.tolist()) == ([HANDBACK, HELD], [10, 9])


def test_one_that_is_not_needed_is_released_once_it_was_held_for_long_enough(here) -> None:
    off = diverged(3)
    off.detected_step[1] = NOW - 4
    everybody = np.ones(3, np.bool_)
    move_on(CONFIG, here(off), everybody, ~everybody, ~everybody, np.array([True, True, False]))
    assert off.state.tolist() == [RELEASED, HELD, HELD]


def test_before_the_goal_an_agent_is_free_for_twice_as_long(here) -> None:
    off = diverged(2)
    off.clear[:] = [8, 9]
    assert moved_on(here(off, x=40.0)) == [HELD, HANDBACK]


@pytest.mark.parametrize(
    ("field", "limit"),
    [("log_x", 0.5), ("log_y", 0.5), ("log_speed", 1.5), ("log_speed", -1.5), ("log_yaw", 0.1), ("log_yaw", -0.1)],
)
def test_release_needs_every_residual_within_its_bound(here, field: str, limit: float) -> None:
    off = diverged(2)
    off.state[:] = HANDBACK
    now = here(off)
    now = replace(now, **{field: getattr(now, field) + limit * np.array([0.999, 1.001])})
    assert moved_on(now) == [RELEASED, HANDBACK]
    off.state[:] = HANDBACK
    assert moved_on(now, config=replace(CONFIG, handback="at_once")) == [RELEASED, RELEASED]


def test_who_stands_between_an_agent_and_its_log_obstructs_it_unless_it_overlaps_it_there_in_the_log(here) -> None:
    off = diverged(3)
    others = [{"id": 50, "x": 130.0, "y": 20.0}, {"id": 51, "x": 190.0, "y": 40.0}, {"id": 52, "x": 130.0, "y": 63.0}]
    now, everybody = here(off, *others, ahead=50.0), np.arange(3)
    new, known = (SimpleNamespace(meets=lambda *_, answer=answer: answer) for answer in (False, True))
    assert obstructed(now, everybody, new).tolist() == [True, False, False]
    assert obstructed(now, everybody, known).tolist() == [False, False, False]
    assert obstructed(now, np.array([1]), new).tolist() == [False]
    assert obstructed(now, everybody[:0], new).tolist() == []
