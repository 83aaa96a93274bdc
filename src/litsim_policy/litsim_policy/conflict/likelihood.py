"""How likely logs still are: would a person do what the log does, in the scene as it is?

A log says by how much an agent changes its speed within the next second, now and in one second. Its log-ratio compares
the probability that a person gains at least that much behind the leader as it is now, with that behind the leader of
the recorded scene. Both are taken alike, so the ratio is 0 for whoever has the leader of the record.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from litsim_policy.conflict.detector import Conflict
from litsim_policy.motion.habits import Habits, usual_headway
from litsim_policy.motion.log_leaders import (
    BACK,
    VERTICES,
    Leader,
    LogColumns,
    lay_way,
    leader_now,
    logged_leader,
    may_lead,
)
from litsim_policy.motion.speed_change import (
    FAR,
    LOOK_S,
    Situation,
    SpeedChange,
    log_chance,
    packaged_speed_change,
)
from litsim_sim.core.pair_geometry import behind_scene
from litsim_sim.core.scene import STEP_S, AgentArrays, AgentTable, BoolArray, Controller, FloatArray, IntArray
from litsim_sim.core.takeover import TakeoverReason
from litsim_sim.kernels.compiled import Bools, Bools2, Floats, Floats2, Ints, OutFloats2, kernel
from litsim_sim.scenario.log import Log

LOOK = round(LOOK_S / STEP_S)
AHEAD = 20  # [steps] on the log, at which an agent whose log is unlikely has its goal
SMOOTHING = 2  # [steps] before and after, over which the speeds of logs are averaged: recorded speeds are noisy
LOG = int(Controller.LOG)
SAME_POSITION, SAME_SPEED = 0.5, 0.5  # [m], [m/s] deviations up to which an agent is where its log is


@dataclass(frozen=True)
class LogRatios:
    """How likely the logs of all agents of a step are; arrays (n,).

    Attributes:
        ratio: logarithm of the ratio of both probabilities: 0 where the leader is that of the record, negative where
            the log has become less likely.
        leader: row of the leader behind which the log is judged; -1 where it is not.
        lag: steps by which the log lags.
        as_recorded: whether the agent is where its log is, without a lag.
    """

    ratio: FloatArray
    leader: IntArray
    lag: IntArray
    as_recorded: BoolArray

    @classmethod
    def equal(cls, lag: IntArray) -> LogRatios:
        """Returns the ratios of agents with these lags (n,) whose logs are not judged."""
        return cls(np.zeros(len(lag)), np.full(len(lag), -1), lag, np.zeros(len(lag), np.bool_))


class Judged(NamedTuple):
    """Whose logs are judged, of the n agents of a step, and where these logs are.

    Attributes:
        which: (n,) whether it is.
        log_row: (n,) of the agent in the log.
        lag: (n,) steps by which its log lags, so that it does not know who is ahead; 0 for none.
        step: present one.
        elapsed: since the table before [s].
    """

    which: Bools
    log_row: Ints
    lag: Ints
    step: int
    elapsed: float


@dataclass
class LogLikelihood:
    """The likelihood of all logs of a scenario, in runs of which each step is shown once, in order.

    Attributes:
        log: of all agents.
        density: of people's changes of speed.
    """

    log: Log
    density: SpeedChange = field(default_factory=packaged_speed_change)

    def __post_init__(self) -> None:
        self._past = deque[AgentTable](maxlen=BACK + 1)
        self._habits = Habits(self.log)
        self._then = np.full((len(self.log.ids), 2), -1.0)  # of each log, the last step judged, and its chance then

    def observe(self, table: AgentTable) -> None:
        """Take note of a step."""
        self._past.append(table)

    def at(self, table: AgentTable, lag: IntArray, judged: BoolArray) -> LogRatios:
        """Returns the ratios at a step of the agents in the mask `judged` (n,), whose logs lag by `lag` (n,) steps.

        They are judged behind leaders that are not where they were recorded; those with a lag behind any.
        """
        before, log_row = self._past[0], self.log.ids.searchsorted(table.id)
        whose = Judged(judged, log_row, lag, table.step, (table.step - before.step) * STEP_S)
        scene, habits = (table.arrays, before.arrays), self._habits
        ratio, leader, recorded = _log_ratios(whose, *scene, habits.columns, habits.seen, self._then, self.density)
        return LogRatios(ratio, leader, lag, recorded)


def as_recorded(log: Log, table: AgentTable) -> BoolArray:
    """Returns the mask (n,) of agents that are where their logs are at this step, without a lag."""
    return _as_recorded((log.x, log.y, log.speed, log.valid), table.arrays, log.ids.searchsorted(table.id), table.step)


def unlikely_logs(ratios: LogRatios, table: AgentTable, log: Log, which: BoolArray) -> list[Conflict]:
    """Returns conflicts of the agents in the mask `which` (n,) with their leaders: their logs have become unlikely.

    The goal of such an agent is AHEAD on its log.
    """
    conflicts = []
    for row in (which & (ratios.leader >= 0)).nonzero()[0].tolist():
        log_row = log.row(int(table.id[row]))
        then = min(table.step - int(ratios.lag[row]) + AHEAD, int(log.last_step[log_row]))
        pose = np.array([log.x[log_row, then], log.y[log_row, then], log.yaw[log_row, then]])
        opponent = int(table.id[ratios.leader[row]])
        conflicts.append(
            Conflict(int(table.id[row]), opponent, AHEAD * STEP_S, pose, 0.0, reason=TakeoverReason.UNLIKELY)
        )
    return conflicts


def with_changed(conflicts: list[Conflict], ratios: LogRatios, table: AgentTable) -> list[Conflict]:
    """Returns the `conflicts` but those of agents and opponents that both are where they were recorded.

    What is expected of them is not what happened: recorded accelerations are noisy, and end.
    """

    def changed(conflict: Conflict) -> bool:
        row, opponent = table.row(conflict.agent), table.row(conflict.opponent)
        return bool(ratios.lag[row] > 0 or not ratios.as_recorded[opponent])

    return [conflict for conflict in conflicts if changed(conflict)]


@kernel
def _as_recorded(log: tuple[Floats2, Floats2, Floats2, Bools2], agents: AgentArrays, rows: Ints, step: int) -> Bools:
    """See :func:`as_recorded`; of the log x, y [m], speed [m/s] and validity (N, S), in which agents are in `rows`."""
    (x, y, speed, valid), recorded = log, np.zeros(len(rows), np.bool_)
    for i in range(len(rows)):
        if step < x.shape[1] and valid[rows[i], step]:
            place = rows[i], step
            apart = math.hypot(agents.x[i] - x[place], agents.y[i] - y[place])
            recorded[i] = apart <= SAME_POSITION and abs(agents.speed[i] - speed[place]) <= SAME_SPEED
    return recorded


@kernel
def _acceleration(agents: AgentArrays, row: int, before: AgentArrays, elapsed: float) -> float:
    """Return the acceleration [m/s2] of the agent in `row` since the table `before`; of a new one that of the step."""
    earlier = np.searchsorted(before.id, agents.id[row])
    if elapsed > 0.0 and earlier < len(before.id) and before.id[earlier] == agents.id[row]:
        return (agents.speed[row] - before.speed[earlier]) / elapsed
    return agents.acceleration[row]


@kernel
def _may_be_led(agents: AgentArrays, row: int, leaders: Ints) -> bool:
    """Returns whether one of the agents in the rows `leaders` of its scene may lead the one in `row`."""
    cos, sin = math.cos(agents.yaw[row]), math.sin(agents.yaw[row])
    for j in leaders:
        if j != row and may_lead(agents.x[j] - agents.x[row], agents.y[j] - agents.y[row], cos, sin):
            return True
    return False


@kernel
def _planned_speed(log: LogColumns, row: int, step: int) -> float:
    """Returns the speed [m/s] of a log at `step`, smoothed; before its first and after its last step, that then."""
    total = 0.0
    for t in range(step - SMOOTHING, step + SMOOTHING + 1):
        total += log.speed[row, min(max(t, log.first_step[row]), log.last_step[row])]
    return total / (2 * SMOOTHING + 1)


@kernel
def _log_chance_of_plan(
    log: LogColumns, row: int, step: int, speed: float, leader: Leader, usual: float, density: SpeedChange
) -> float:
    """Returns the log-probability of at least the gains of a log within the second from `step`, and in the next one.

    The vehicle begins at `speed` [m/s], and the leader keeps its acceleration for one second.
    """
    planned, later = _planned_speed(log, row, step + LOOK), _planned_speed(log, row, step + 2 * LOOK)
    if leader.row < 0:
        soon = log_chance(planned - speed, Situation(speed, FAR, 0.0, 0.0, usual), density)
        return soon + log_chance(later - planned, Situation(planned, FAR, 0.0, 0.0, usual), density)
    now = Situation(speed, leader.gap, speed - leader.speed, leader.acceleration, usual)
    travelled = 0.0
    for k in range(LOOK):
        travelled += _planned_speed(log, row, step + k) * STEP_S
    braking = -min(leader.acceleration, -1e-3)
    until = min(LOOK_S, max(leader.speed, 0.0) / braking) if leader.acceleration < 0.0 else LOOK_S
    reached = leader.speed + leader.acceleration * until
    gap = leader.gap + leader.speed * until + 0.5 * leader.acceleration * until**2 - travelled
    then = Situation(planned, gap, planned - reached, 0.0, usual)
    return log_chance(planned - speed, now, density) + log_chance(later - planned, then, density)


@kernel
def _log_ratios(
    judged: Judged,
    agents: AgentArrays,
    before: AgentArrays,
    log: LogColumns,
    habits: OutFloats2,
    then: OutFloats2,
    density: SpeedChange,
) -> tuple[Floats, Ints, Bools]:
    """See :meth:`LogLikelihood.at`; returns ratios (n,), leaders (n,) and who is where its log is (n,).

    An agent that is off its log is judged by its present speed in place of that of its log. Agents that none of those
    could lead that are off their logs and not where they were recorded, even if nobody else were there, are passed
    over. `before` are the agents BACK steps ago. `then` (n, 2) are by row of the log the step of the last judgement,
    and the log-probability in the recorded scene: a log that waits for its agent, at the same step again, needs no
    second one.
    """
    ratio, leaders = np.zeros(len(agents.x)), np.full(len(agents.x), -1, np.int64)
    driven = agents.controller != LOG
    recorded = _as_recorded((log.x, log.y, log.speed, log.valid), agents, judged.log_row, judged.step)
    is_changed = driven & ~recorded
    changed, end, way = is_changed.nonzero()[0], 0, np.empty((VERTICES, 5))
    scene = changed_here = np.arange(0)
    for i in range(len(agents.x)):
        if i == end:
            end = behind_scene(agents.scene, i)
            scene, changed_here = np.arange(i, end), changed[(changed >= i) & (changed < end)]
        row, lagged = judged.log_row[i], judged.lag[i] > 0
        step = min(judged.step - judged.lag[i], log.last_step[row])
        if not (judged.which[i] and step >= log.first_step[row]):
            continue
        if not (lagged or _may_be_led(agents, i, changed_here)):
            continue
        count = lay_way(log, row, step, way)
        if not lagged and leader_now(way, count, agents, i, changed_here).row < 0:
            continue
        leader = leader_now(way, count, agents, i, scene)
        if leader.row < 0 or not (lagged or is_changed[leader.row]):
            continue
        acceleration = _acceleration(agents, leader.row, before, judged.elapsed)
        leader = Leader(leader.row, leader.gap, leader.speed, acceleration)
        again = then[row, 0] == step
        recorded_leader = leader if again else logged_leader(way, count, log, row, step)
        usual = usual_headway(log, row, step, habits, way)
        planned = _planned_speed(log, row, step)
        now = _log_chance_of_plan(log, row, step, agents.speed[i] if driven[i] else planned, leader, usual, density)
        if not again:
            chance = _log_chance_of_plan(log, row, step, planned, recorded_leader, usual, density)
            then[row, 0], then[row, 1] = step, chance
        ratio[i], leaders[i] = now - then[row, 1], leader.row
    return ratio, leaders, recorded
