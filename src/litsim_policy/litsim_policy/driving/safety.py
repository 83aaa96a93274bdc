"""The safety layer between policy C's network and the vehicle: limits that always hold, and optional guards.

For any command of the network, an agent keeps comfort bounds, does not run into the agent ahead, touches no other, and
stays on the road, as far as the look-ahead can tell. Only a guard may brake harder than is comfortable. All
interventions are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba.types import Tuple
from pydantic import model_validator

from litsim_policy.driving.look_ahead import first_touch, rolled_out, stay_on_road, steps_of
from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.car_following import LEADER_BRAKES, braking_behind, safe_speed
from litsim_policy.motion.followers import PathFollowers
from litsim_policy.motion.stop_lines import StopLines
from litsim_sim.core.compiled import (
    BOOLS2,
    FLOATS,
    FLOATS2,
    FLOATS3,
    INTS,
    OUT_BOOLS,
    OUT_FLOATS,
    OUT_FLOATS2,
    OUT_FLOATS3,
    OUT_INTS,
    float64,
    kernel,
)
from litsim_sim.core.dynamics import SPEED_MIN
from litsim_sim.core.pair_geometry import within
from litsim_sim.core.quantities import (
    Acceleration,
    AngularAcceleration,
    AngularRate,
    Duration,
    Flag,
    Horizon,
    Jerk,
    Length,
    NonNegative,
    Positive,
    at_most,
    configuration,
)
from litsim_sim.core.quickly_made import quickly_made
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.scenario.signals import LinkSignals

GUARDS = ("limits", "following", "contact", "road")
SAME = 1e-9  # [m/s2], [rad/s] up to which a command counts as unchanged
BRAKING = np.array([2.0, 3.0, 4.0, 6.0])  # [m/s2] braking that the guard for contact tries before the hardest


@configuration
class SafetyConfig:
    """Limits, which always hold, and guards. Bounds are those of nuPlan's comfort measure unless stated otherwise.

    Attributes:
        following: brake for the agent ahead on the path, and for red, when braking can no longer wait.
        contact: brake or steer where the command leads into another box within `horizon`.
        road: do not steer off the road.
        acceleration_max, deceleration_max: of the network's commands.
        jerk_max: with which the network's acceleration grows, and its braking is eased.
        braking_jerk_max: with which the network's braking grows. With nuPlan's longitudinal 4.13 m/s3 it would take a
            second to brake as hard as people do within a quarter of one; this is nuPlan's bound on the whole jerk. The
            careful and competent driver of UN Regulation 157 has 12.65.
        lateral_acceleration_max: of the network's turns.
        yaw_rate_max: of the network's turns.
        yaw_acceleration_max: change of the network's yaw rate.
        braking_max: of the guards in an emergency, the most that the vehicle can do.
        leader_braking: hardest braking that the agent ahead may begin at any time.
        own_braking: own braking assumed in reply.
        standstill_gap: kept behind the agent ahead.
        relax: time constant of widening a gap that is too short.
        widening: hardest braking for that alone, outside emergencies.
        imminent: an approach that needs harder braking is an emergency; by default, the most that the network may
            command.
        leader_brakes: a leader that brakes harder is assumed to stop.
        horizon: of the look-ahead for other boxes.
        settle: time constant with which turns are expected to end.
        margin: distance kept to other boxes.
        road_horizon: of the look-ahead for the road, at most `horizon`.
    """

    following: Flag = True
    contact: Flag = True
    road: Flag = True
    acceleration_max: Positive[Acceleration] = 2.40
    deceleration_max: Positive[Acceleration] = 4.05
    jerk_max: Positive[Jerk] = 4.13
    braking_jerk_max: Positive[Jerk] = 8.37
    lateral_acceleration_max: Positive[Acceleration] = 4.89
    yaw_rate_max: Positive[AngularRate] = 0.95
    yaw_acceleration_max: Positive[AngularAcceleration] = 1.93
    braking_max: Positive[Acceleration] = 8.0
    leader_braking: Positive[Acceleration] = 8.0
    own_braking: Positive[Acceleration] = 7.5
    standstill_gap: NonNegative[Length] = 1.0
    relax: Positive[Duration] = 1.0
    widening: Positive[Acceleration] = 2.5
    imminent: NonNegative[Acceleration] = 4.05
    leader_brakes: NonNegative[Acceleration] = LEADER_BRAKES
    horizon: Horizon = 1.5
    settle: Positive[Duration] = 0.5
    margin: NonNegative[Length] = 0.15
    road_horizon: Horizon = 0.8

    @model_validator(mode="after")
    def _check(self) -> SafetyConfig:
        at_most(self, "road_horizon", "horizon")
        return self


LIMITS_ONLY = SafetyConfig(following=False, contact=False, road=False)
"""The layer in training: limits without guards; need of a guard is penalised instead."""


@quickly_made
@dataclass(frozen=True)
class SafeCommands:
    """Commands after the layer; arrays (m,).

    Attributes:
        acceleration: [m/s2].
        yaw_rate: [rad/s].
        changed: (m, 4) which of :data:`GUARDS` changed what the agent does.
    """

    acceleration: FloatArray
    yaw_rate: FloatArray
    changed: BoolArray

    @property
    def guarded(self) -> BoolArray:
        """Mask (m,) of agents for which a guard, not only a limit, has intervened."""
        return np.asarray(self.changed[:, 1:].any(axis=1))


class SafetyLayer:
    """The safety layer on one net.

    Attributes:
        interventions: number of agent-steps in which each guard has intervened since the layer was made.
    """

    def __init__(
        self, lane_map: LaneMap, config: SafetyConfig | None = None, signals: LinkSignals | None = None
    ) -> None:
        self.config = config or SafetyConfig()
        self._stop_lines = StopLines(signals)
        self.interventions = dict.fromkeys(GUARDS, 0)
        self.agent_steps = 0
        self.lane_map = lane_map

    def apply(
        self, table: AgentTable, tasks: Sequence[DrivingTask], acceleration: FloatArray, yaw_rate: FloatArray
    ) -> SafeCommands:
        """The safe commands of the agents with `tasks` (m); see :meth:`guard`."""
        return self.guard(DrivingScene.of(self.lane_map, table, tasks), acceleration, yaw_rate)

    def guard(self, scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray) -> SafeCommands:
        """The commands of the m agents of `scene`, with the least changes needed.

        Args:
            scene: the agents, their paths, and all other agents.
            acceleration, yaw_rate: (m,) requested [m/s2], [rad/s].
        """
        config, agents = self.config, scene.agents
        table, rows = agents.table, agents.rows
        changed = np.zeros((len(scene), len(GUARDS)), np.bool_)
        safe, changed[:, 0] = _limited(
            acceleration,
            yaw_rate,
            table.acceleration[rows],
            table.yaw_rate[rows],
            agents.speed,
            config.deceleration_max,
            config.acceleration_max,
            config.jerk_max,
            config.braking_jerk_max,
            config.yaw_rate_max,
            config.lateral_acceleration_max,
            config.yaw_acceleration_max,
        )
        cap = np.full(len(scene), config.acceleration_max)
        if config.following:
            cap = following_cap(config, agents)
            lines = self._stop_lines.of(agents)
            if (lines < np.inf).any():
                cap = np.minimum(cap, stopping_cap(config, agents, lines))
        stands = stopping(agents.speed)
        changed[:, 1] = np.maximum(cap, stands) < np.maximum(safe[:, 0], stands)
        safe[:, 0] = np.minimum(safe[:, 0], cap)
        if (config.contact or config.road) and len(scene):
            safe, changed[:, 2], changed[:, 3] = self._guarded(agents, safe, cap)
        self.agent_steps += len(scene)
        for name, count in zip(GUARDS, changed.sum(axis=0).tolist(), strict=True):
            self.interventions[name] += count
        return SafeCommands(safe[:, 0], safe[:, 1], changed)

    def _guarded(
        self, agents: PathFollowers, commands: FloatArray, cap: FloatArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """The least changes to `commands` (m, 2) with which agents touch no other and stay on the road.

        If no choice does, the one that touches latest, and of these the one that brakes hardest.

        Args:
            agents: m agents.
            commands: accelerations [m/s2] and yaw rates [rad/s].
            cap: (m,) acceleration that the agent ahead allows [m/s2].

        Returns:
            the commands (m, 2), and which of them (m,) were changed for contact, and for the road.
        """
        config, rows = self.config, agents.rows
        first, on_road = self._look_ahead(agents.table, rows, commands[:, None])
        touches = config.contact & (first[:, 0] < np.inf)
        leaves = config.road & ~on_road[:, 0]
        at = (touches | leaves).nonzero()[0]
        if not len(at):
            return commands, touches, leaves
        choices = _choices(
            commands[at],
            cap[at],
            agents.speed[at],
            agents.table.yaw_rate[rows[at]],
            agents.path_yaw_rate[at],
            agents.lane_yaw_rate[at],
            config.yaw_acceleration_max * STEP_S,
            config.lateral_acceleration_max,
            config.acceleration_max,
            config.braking_max,
        )
        touch, stays = self._look_ahead(agents.table, rows[at], choices)
        if not config.contact:
            touch[:] = np.inf
        stays |= not config.road or ~stays.any(axis=1, keepdims=True)
        chosen = commands.copy()
        chosen[at] = choices[np.arange(len(at)), _best(choices, touch, stays)]
        stands = stopping(agents.speed)
        moved = np.maximum(chosen[:, 0], stands) != np.maximum(commands[:, 0], stands)
        moved |= (chosen[:, 1] != commands[:, 1]) & (agents.speed > 0.0)
        return chosen, moved & touches, moved & leaves

    def _look_ahead(self, table: AgentTable, rows: IntArray, commands: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Outcome of commands (m, c, 2) of the agents in `rows` (m,).

        Returns:
            time of the first touch (m, c) [s], infinite where there is none, and whether the agent stays on the road
            (m, c).
        """
        config = self.config
        instants, road = steps_of(config.horizon), steps_of(config.road_horizon)
        poses = rolled_out(table, rows, commands, config.settle, max(instants, road))
        touch = first_touch(table, rows, poses, instants, config.margin)
        return touch, stay_on_road(self.lane_map, table, rows, poses, road - 1)


def stopping(speed: FloatArray) -> FloatArray:
    """Accelerations (m,) [m/s2] with which agents at `speed` (m,) [m/s] stop within a step; harder has no effect."""
    return -speed / STEP_S


def following_cap(config: SafetyConfig, agents: PathFollowers) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop behind the agent ahead on the path.

    The safe speed is that of Krauss (1997), at which `own_braking` suffices if the leader brakes by `leader_braking`.
    It is approached with `relax`, by no more than `widening`. If the approach to the leader, which is assumed to
    continue as now, needs more than `imminent`, the agent brakes accordingly at once.
    """
    view = agents.view
    leads = view.ahead & view.in_path
    return _cap_behind(config, agents, view.gap, view.speed, leads, view.first, agents.table.acceleration)


def stopping_cap(config: SafetyConfig, agents: PathFollowers, gap: FloatArray) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop at lines `gap` (m,) [m] ahead."""
    line = gap[:, None]
    nobody = np.zeros(len(gap), np.int64)
    return _cap_behind(config, agents, line, np.zeros(line.shape), np.isfinite(line), nobody, np.zeros(1))


def _cap_behind(
    config: SafetyConfig,
    agents: PathFollowers,
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray,
    first: IntArray,
    acceleration: FloatArray,
) -> FloatArray:
    """See :func:`following_cap`, behind the given leaders; for the arrays see :func:`_following_cap`."""
    return _following_cap(
        gap,
        leader_speed,
        leads,
        agents.speed,
        agents.table.length[agents.rows],
        first,
        acceleration,
        config.standstill_gap,
        config.own_braking,
        config.leader_braking,
        config.relax,
        config.widening,
        config.imminent,
        config.leader_brakes,
        config.braking_max,
        config.acceleration_max,
    )


@kernel(Tuple((OUT_FLOATS2, OUT_BOOLS))(*[FLOATS] * 5, *[float64] * 7))
def _limited(  # noqa: PLR0917 - a kernel takes arrays and numbers
    asked_acceleration: FloatArray,
    asked_yaw_rate: FloatArray,
    acceleration: FloatArray,
    yaw_rate: FloatArray,
    speed: FloatArray,
    deceleration_max: float,
    acceleration_max: float,
    jerk_max: float,
    braking_jerk_max: float,
    yaw_rate_max: float,
    lateral_acceleration_max: float,
    yaw_acceleration_max: float,
) -> tuple[FloatArray, BoolArray]:
    """Commands within the comfort bounds, those on the rates of change included.

    If the motion in the last step was out of bounds, it returns at the largest rate of change.

    Args:
        asked_acceleration, asked_yaw_rate: (m,) requested [m/s2], [rad/s].
        acceleration, yaw_rate, speed: (m,) of the agents in the last step and now [m/s2], [rad/s], [m/s].
        deceleration_max, acceleration_max, jerk_max, braking_jerk_max, yaw_rate_max, lateral_acceleration_max,
            yaw_acceleration_max: as in :class:`SafetyConfig`.

    Returns:
        the commands (m, 2), and which of them differ from the request (m,).
    """
    limited, changed = np.empty((len(speed), 2)), np.empty(len(speed), np.bool_)
    rise, fall, twist = jerk_max * STEP_S, braking_jerk_max * STEP_S, yaw_acceleration_max * STEP_S
    for i in range(len(speed)):
        before = within(acceleration[i], -deceleration_max, acceleration_max)
        pedal = within(asked_acceleration[i], before - fall, before + rise)
        bound = min(yaw_rate_max, lateral_acceleration_max / max(speed[i], SPEED_MIN))
        turn = within(asked_yaw_rate[i], yaw_rate[i] - twist, yaw_rate[i] + twist)
        limited[i, 0] = within(pedal, -deceleration_max, acceleration_max)
        limited[i, 1] = within(turn, -bound, bound)
        pedal_moved, turn_moved = limited[i, 0] - asked_acceleration[i], limited[i, 1] - asked_yaw_rate[i]
        changed[i] = abs(pedal_moved) > SAME or abs(turn_moved) > SAME
    return limited, changed


@kernel(OUT_FLOATS(FLOATS2, FLOATS2, BOOLS2, FLOATS, FLOATS, INTS, FLOATS, *[float64] * 9))
def _following_cap(  # noqa: PLR0917 - a kernel takes arrays and numbers
    gap: FloatArray,
    leader_speed: FloatArray,
    leads: BoolArray,
    speed: FloatArray,
    length: FloatArray,
    first: IntArray,
    acceleration: FloatArray,
    standstill_gap: float,
    own_braking: float,
    leader_braking: float,
    relax: float,
    widening: float,
    imminent: float,
    leader_brakes: float,
    braking_max: float,
    acceleration_max: float,
) -> FloatArray:
    """See :func:`following_cap`.

    Args:
        gap, leader_speed: (m, w) to others and of others along the path [m], [m/s].
        leads: (m, w) whether one of them is ahead on the path.
        speed, length: (m,) of the agents [m/s], [m].
        first: (m,) position in `acceleration` of the first of the others.
        acceleration: (n,) of all agents [m/s2].
        standstill_gap, own_braking, leader_braking, relax, widening, imminent, leader_brakes, braking_max,
            acceleration_max: as in :class:`SafetyConfig`.
    """
    caps = np.empty(len(speed))
    for i in range(len(speed)):
        least = np.inf
        for j in np.flatnonzero(leads[i]):
            if not gap[i, j] > -0.5 * length[i]:
                continue
            room, lead = gap[i, j] - standstill_gap, max(leader_speed[i, j], 0.0)
            cap = max((safe_speed(room, lead, own_braking, leader_braking) - speed[i]) / relax, -widening)
            needed = braking_behind(speed[i], lead, acceleration[first[i] + j], room, leader_brakes)
            least = min(least, min(cap, -needed) if needed > imminent else cap)
        caps[i] = within(least, -braking_max, acceleration_max)
    return caps


@kernel(OUT_FLOATS3(FLOATS2, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, *[float64] * 4))
def _choices(  # noqa: PLR0917 - a kernel takes arrays and numbers
    commands: FloatArray,
    cap: FloatArray,
    speed: FloatArray,
    yaw_rate: FloatArray,
    path_yaw_rate: FloatArray,
    lane_yaw_rate: FloatArray,
    twist: float,
    lateral_acceleration_max: float,
    acceleration_max: float,
    braking_max: float,
) -> FloatArray:
    """Alternatives to the commands, nearest to the commanded acceleration first.

    Acceleration is among them, since it may be best for an agent that another cuts in on from behind.

    Args:
        commands: (k, 2) accelerations [m/s2] and yaw rates [rad/s].
        cap: (k,) accelerations that the agents ahead allow [m/s2].
        speed, yaw_rate: (k,) now [m/s], [rad/s].
        path_yaw_rate, lane_yaw_rate: (k,) yaw rates along the path and along the lane [rad/s].
        twist: most by which a yaw rate changes in a step [rad/s].
        lateral_acceleration_max, acceleration_max, braking_max: as in :class:`SafetyConfig`.

    Returns:
        (k, 21, 2) accelerations and yaw rates: as commanded, along the path, along the lane; then at other speeds.
    """
    choices = np.empty((len(commands), 3 * (len(BRAKING) + 3), 2))
    for i in range(len(commands)):
        wanted = commands[i, 0]
        bound = lateral_acceleration_max / max(speed[i], SPEED_MIN)
        low, high = yaw_rate[i] - twist, yaw_rate[i] + twist
        along_path = within(within(path_yaw_rate[i], low, high), -bound, bound)
        along_lane = within(within(lane_yaw_rate[i], low, high), -bound, bound)
        steering = (commands[i, 1], along_path, along_lane)
        driving_on = max(min(acceleration_max, cap[i]), wanted)
        hardest = min(wanted, -braking_max)
        pedals = np.full(len(BRAKING) + 3, hardest)
        pedals[0], pedals[-1] = wanted, driving_on
        for k in range(len(BRAKING)):
            pedals[k + 1] = min(wanted, max(-BRAKING[k], -braking_max))
        for place, k in enumerate(np.argsort(np.abs(pedals - wanted), kind="mergesort")):
            for s in range(3):
                choices[i, 3 * place + s, 0], choices[i, 3 * place + s, 1] = pedals[k], steering[s]
    return choices


@kernel(OUT_INTS(FLOATS3, FLOATS2, BOOLS2))
def _best(choices: FloatArray, touch: FloatArray, stays: BoolArray) -> IntArray:
    """Positions (k,) of the choices to take.

    The first that touches no agent and stays on the road; if there is none, of those that stay on the road and touch
    latest, the one that brakes hardest.

    Args:
        choices: (k, c, 2) accelerations [m/s2] and yaw rates [rad/s].
        touch: (k, c) times of the first contact [s], infinite for none.
        stays: (k, c) whether they stay on the road, as at least one per agent does.
    """
    best = np.zeros(len(choices), np.int64)
    for i in range(len(choices)):
        latest, least = -1.0, np.inf
        for c in range(choices.shape[1]):
            if not stays[i, c]:
                continue
            later = touch[i, c] > latest
            if later or (touch[i, c] == latest and touch[i, c] < np.inf and choices[i, c, 0] < least):
                best[i], latest, least = c, touch[i, c], choices[i, c, 0]
    return best
