"""The layer between policy C's network and the vehicle: limits that always hold, and guards that can be switched.

The network may say what it likes; what is commanded keeps comfort bounds, does not run into who is ahead, does not
touch who is beside, and stays on the road, as far as a look ahead can tell. Only a guard may brake harder than is
comfortable. Every intervention is counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import model_validator

from litsim_policy.driving.task import DrivingScene, DrivingTask
from litsim_policy.motion.followers import PathFollowers
from litsim_sim.core.geometry import boxes_overlap, to_body
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
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.maps.lane_map import LaneMap

GUARDS = ("limits", "following", "contact", "road")


@configuration
class SafetyConfig:
    """Limits, which always hold, and guards. Bounds are those of nuPlan's comfort measure unless said otherwise.

    Attributes:
        following: brake for who is ahead on the path when braking can no longer wait.
        contact: brake or steer where the command leads into another box within `horizon`.
        road: do not steer off the road.
        acceleration_max, deceleration_max: of what the network commands.
        jerk_max: change of the network's acceleration.
        lateral_acceleration_max: of the network's turns.
        yaw_rate_max: of the network's turns.
        yaw_acceleration_max: change of the network's yaw rate.
        braking_max: of the guards in an emergency; what the vehicle can do.
        leader_braking: hardest braking that whoever is ahead may start at any time.
        own_braking: braking that is relied on then.
        standstill_gap: kept behind whoever is ahead.
        relax: time constant with which a gap that is too short is widened.
        imminent: braking from which on an approach counts as an emergency.
        leader_brakes: braking from which on a leader is taken to stop.
        horizon: of the look ahead for other boxes.
        settle: time constant with which a turn is expected to end.
        margin: distance kept to other boxes.
        road_horizon: of the look ahead for the road, which goes along the same prediction.
    """

    following: Flag = True
    contact: Flag = True
    road: Flag = True
    acceleration_max: Positive[Acceleration] = 2.40
    deceleration_max: Positive[Acceleration] = 4.05
    jerk_max: Positive[Jerk] = 4.13
    lateral_acceleration_max: Positive[Acceleration] = 4.89
    yaw_rate_max: Positive[AngularRate] = 0.95
    yaw_acceleration_max: Positive[AngularAcceleration] = 1.93
    braking_max: Positive[Acceleration] = 8.0
    leader_braking: Positive[Acceleration] = 8.0
    own_braking: Positive[Acceleration] = 6.0
    standstill_gap: NonNegative[Length] = 1.0
    relax: Positive[Duration] = 0.5
    imminent: NonNegative[Acceleration] = 2.0
    leader_brakes: NonNegative[Acceleration] = 1.0
    horizon: Horizon = 1.5
    settle: Positive[Duration] = 0.5
    margin: NonNegative[Length] = 0.15
    road_horizon: Horizon = 0.8

    @model_validator(mode="after")
    def _check(self) -> SafetyConfig:
        at_most(self, "road_horizon", "horizon")
        return self


LIMITS_ONLY = SafetyConfig(following=False, contact=False, road=False)
"""What training drives with: the guards only tell what they would have changed, and that costs."""


@dataclass(frozen=True)
class SafeCommands:
    """Commands after the layer; arrays (m,).

    Attributes:
        acceleration: [m/s2].
        yaw_rate: [rad/s].
        changed: (m, 4) which of :data:`GUARDS` changed the command.
    """

    acceleration: FloatArray
    yaw_rate: FloatArray
    changed: BoolArray

    @property
    def guarded(self) -> BoolArray:
        """(m,) whether a guard, not only a limit, intervened."""
        return np.asarray(self.changed[:, 1:].any(axis=1))


class SafetyLayer:
    """Applies to agents on one net; :attr:`interventions` counts agent-steps by guard since it was made."""

    def __init__(self, lane_map: LaneMap, config: SafetyConfig | None = None) -> None:
        self.config = config or SafetyConfig()
        self.interventions = dict.fromkeys(GUARDS, 0)
        self.agent_steps = 0
        self.lane_map = lane_map

    def apply(
        self, table: AgentTable, tasks: Sequence[DrivingTask], acceleration: FloatArray, yaw_rate: FloatArray
    ) -> SafeCommands:
        """What the agents with `tasks` (m) may do of what is asked for; see :meth:`guard`."""
        return self.guard(DrivingScene.of(self.lane_map, table, tasks), acceleration, yaw_rate)

    def guard(self, scene: DrivingScene, acceleration: FloatArray, yaw_rate: FloatArray) -> SafeCommands:
        """What the m agents of `scene` may do of what is asked for.

        Args:
            scene: the agents, their paths, and everybody else.
            acceleration, yaw_rate: (m,) as asked for [m/s2], [rad/s].
        """
        config, agents = self.config, scene.agents
        changed = np.zeros((len(scene), len(GUARDS)), np.bool_)
        limited = self._limited(agents.table.take(agents.rows), acceleration, yaw_rate)
        changed[:, 0] = (np.abs(limited[0] - acceleration) > 1e-9) | (np.abs(limited[1] - yaw_rate) > 1e-9)
        cap = following_cap(config, agents) if config.following else np.full(len(scene), config.acceleration_max)
        changed[:, 1] = cap < limited[0]
        safe = np.column_stack([np.minimum(limited[0], cap), limited[1]])
        if (config.contact or config.road) and len(scene):
            safe, changed[:, 2], changed[:, 3] = self._guarded(agents, safe, cap)
        self.agent_steps += len(scene)
        for name, count in zip(GUARDS, changed.sum(axis=0).tolist(), strict=True):
            self.interventions[name] += count
        return SafeCommands(safe[:, 0], safe[:, 1], changed)

    def _limited(
        self, agents: AgentTable, acceleration: FloatArray, yaw_rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Commands (m,) within the comfort bounds, those on the rates of change included.

        What the agent did in the last step may itself be out of bounds; it comes back at the bound of the rate.
        """
        config = self.config
        jerk, twist = config.jerk_max * STEP_S, config.yaw_acceleration_max * STEP_S
        before = np.clip(agents.acceleration, -config.deceleration_max, config.acceleration_max)
        acceleration = np.clip(acceleration, before - jerk, before + jerk)
        acceleration = np.clip(acceleration, -config.deceleration_max, config.acceleration_max)
        yaw_rate = np.clip(yaw_rate, agents.yaw_rate - twist, agents.yaw_rate + twist)
        bound = np.minimum(config.yaw_rate_max, config.lateral_acceleration_max / np.maximum(agents.speed, 1e-3))
        return acceleration, np.clip(yaw_rate, -bound, bound)

    def _guarded(
        self, agents: PathFollowers, commands: FloatArray, cap: FloatArray
    ) -> tuple[FloatArray, BoolArray, BoolArray]:
        """The least changes to `commands` (m, 2) with which agents touch nobody and stay on the road.

        Where there is none, the one that touches latest, and of those the one that brakes hardest.

        Args:
            agents: m agents.
            commands: accelerations [m/s2] and yaw rates [rad/s].
            cap: (m,) acceleration that whoever is ahead allows [m/s2].

        Returns:
            the commands (m, 2), and which of them (m,) were changed for contact, and for the road.
        """
        config, table = self.config, agents.table
        first_touch, on_road = self._look_ahead(table, agents.rows, commands[:, None])
        touches = config.contact & (first_touch[:, 0] < np.inf)
        leaves = config.road & ~on_road[:, 0]
        at = np.flatnonzero(touches | leaves)
        if not len(at):
            return commands, touches, leaves
        choices = self._choices(agents, at, commands, cap)
        touch, stays = self._look_ahead(table, agents.rows[at], choices)
        if not config.contact:
            touch[:] = np.inf
        stays |= not config.road or ~stays.any(axis=1, keepdims=True)
        good = (touch == np.inf) & stays
        late = np.where(stays, touch, -1.0)
        least_bad = np.where(late == late.max(axis=1, keepdims=True), choices[..., 0], np.inf)
        best = np.where(good.any(axis=1), np.argmax(good, axis=1), np.argmin(least_bad, axis=1))
        chosen = commands.copy()
        chosen[at] = choices[np.arange(len(at)), best]
        moved = (chosen != commands).any(axis=1)
        return chosen, moved & touches, moved & leaves

    def _choices(self, agents: PathFollowers, at: IntArray, commands: FloatArray, cap: FloatArray) -> FloatArray:
        """What the agents at positions `at` (k,) could do instead, nearest to the commanded acceleration first.

        Whoever is cut in on from behind is best off driving on.

        Returns:
            (k, 15, 2) accelerations and yaw rates: as commanded, along the path, along the lane; then at other speeds.
        """
        config, wanted = self.config, commands[at, 0]
        bound = (config.lateral_acceleration_max / np.maximum(agents.speed[at], 1e-3))[:, None]
        twist, now = config.yaw_acceleration_max * STEP_S, agents.table.yaw_rate[agents.rows[at], None]
        along = np.column_stack([agents.path_yaw_rate[at], agents.lane_yaw_rate[at]])
        along = np.clip(np.clip(along, now - twist, now + twist), -bound, bound)
        steering = np.column_stack([commands[at, 1], along])
        driving_on = np.maximum(np.minimum(config.acceleration_max, cap[at]), wanted)
        braking = (np.minimum(wanted, limit) for limit in (-2.0, -4.0, -config.braking_max))
        accelerations = np.column_stack([wanted, *braking, driving_on])
        order = np.argsort(np.abs(accelerations - wanted[:, None]), axis=1, kind="stable")
        accelerations = np.take_along_axis(accelerations, order, axis=1)
        shape = (len(at), accelerations.shape[1], steering.shape[1])
        pairs = [np.broadcast_to(values, shape) for values in (accelerations[:, :, None], steering[:, None, :])]
        return np.stack(pairs, axis=-1).reshape(len(at), -1, 2)

    def _look_ahead(self, table: AgentTable, rows: IntArray, commands: FloatArray) -> tuple[FloatArray, BoolArray]:
        """What commands (m, c, 2) of the agents in `rows` (m,) lead to.

        The agents keep the commanded acceleration and end their turn with `settle`; the others go straight on, and
        those that brake go on braking. Boxes that touch already and followers in the own lane do not count.

        Returns:
            time of the first touch (m, c) [s], infinite where there is none, and whether the agent stays on the road
            (m, c).
        """
        config = self.config
        instants, road = _steps(config.horizon), _steps(config.road_horizon)
        t: FloatArray = STEP_S * np.arange(1, max(instants, road) + 1, dtype=np.float64)
        now = [values[rows, None, None] for values in (table.x, table.y, table.yaw, table.speed)]
        speed = np.maximum(now[3] + commands[..., :1] * t, 0.0)
        yaw = now[2] + commands[..., 1:] * config.settle * (1.0 - np.exp(-t / config.settle))
        x = now[0] + STEP_S * np.cumsum(speed * np.cos(yaw), axis=-1)
        y = now[1] + STEP_S * np.cumsum(speed * np.sin(yaw), axis=-1)
        poses = np.stack([x, y, yaw])
        touch = first_touch(table, rows, poses[..., :instants], config.margin)
        return touch, self._stays_on_road(table, rows, poses[..., road - 1])

    def _stays_on_road(self, table: AgentTable, rows: IntArray, poses: FloatArray) -> BoolArray:
        """(m, c) whether both sides of agents at `poses` (3, m, c) are on the road; one that is off it now may be."""
        now = np.stack([table.x[rows], table.y[rows], table.yaw[rows]])
        x, y, yaw = np.concatenate([poses, now[..., None]], axis=-1)
        half = 0.5 * table.width[rows, None]
        side_x, side_y = half * np.sin(yaw), half * np.cos(yaw)
        sides = np.stack([x - side_x, x + side_x]), np.stack([y + side_y, y - side_y])
        on_road = self.lane_map.inside_road(sides[0].ravel(), sides[1].ravel())
        inside = np.asarray(on_road.reshape(2, *x.shape).all(axis=0))
        return np.asarray(inside[:, :-1] | ~inside[:, -1:])


def following_cap(config: SafetyConfig, agents: PathFollowers) -> FloatArray:
    """Accelerations (m,) [m/s2] above which agents could not stop behind whoever is ahead on their paths.

    The safe speed is that of Krauss (1997): should the leader brake as hard as it can, braking at `own_braking`
    suffices. It is approached with `relax`. What the approach needs, the leader going on as it does now, is braked
    for at once where it is more than `imminent`.
    """
    view, table, rows = agents.view, agents.table, agents.rows
    own, lead = np.nonzero(view.ahead & view.in_path & (view.gap > -0.5 * table.length[rows, None]))
    speed = agents.speed[own]
    room = view.gap[own, lead] - config.standstill_gap
    lead_speed = np.maximum(view.speed[own, lead], 0.0)
    stop = 2.0 * config.own_braking * np.maximum(room, 0.0)
    stop += lead_speed**2 * config.own_braking / config.leader_braking
    lag = config.own_braking * STEP_S
    safe_speed = -lag + np.sqrt(lag**2 + stop)
    cap = (safe_speed - speed) / config.relax
    closing = np.maximum(speed - lead_speed, 0.0)
    needed = closing**2 / (2.0 * np.maximum(room, 0.1))
    braking = np.maximum(-table.acceleration[lead], 0.1)
    stopped = np.where(braking > config.leader_brakes, lead_speed**2 / (2.0 * braking), np.inf)
    needed = np.maximum(needed, speed**2 / (2.0 * np.maximum(room + stopped, 0.1)))
    cap = np.where(needed > config.imminent, np.minimum(cap, -needed), cap)
    caps = np.full(len(agents), np.inf)
    np.minimum.at(caps, own, cap)
    return np.clip(caps, -config.braking_max, config.acceleration_max)


def first_touch(table: AgentTable, rows: IntArray, poses: FloatArray, margin: float) -> FloatArray:
    """When boxes of agents first touch somebody else's.

    Args:
        table: everybody; those not looked at go straight on, and those that brake go on braking.
        rows: (m,) of the agents.
        poses: (3, m, c, T) x, y [m] and yaw [rad] of the agents at T instants of 0.1 s, under c commands each.
        margin: [m] kept around other boxes.

    Returns:
        (m, c) time [s], infinite where nobody is touched.
    """
    commands, instants = poses.shape[2:]
    t: FloatArray = STEP_S * np.arange(1, instants + 1, dtype=np.float64)
    one, other, touching = _within_reach(table, rows, float(t[-1]) if instants else 0.0, margin)
    found = np.full((len(rows), commands), np.inf)
    one, other = one[~touching], other[~touching]
    if not len(one):
        return found
    braking = np.minimum(table.acceleration[other], 0.0)[:, None]
    speed = table.speed[other][:, None]
    going = np.where(braking < 0.0, -speed / np.minimum(braking, -1e-3), np.inf)
    time = np.minimum(t, going)
    gone = speed * time + 0.5 * braking * time**2
    yaw = table.yaw[other]
    other_x = table.x[other][:, None] + gone * np.cos(yaw)[:, None]
    other_y = table.y[other][:, None] + gone * np.sin(yaw)[:, None]
    grown = table.length[other] + 2.0 * margin, table.width[other] + 2.0 * margin
    mine = table.length[rows[one]], table.width[rows[one]]
    radius = 0.5 * (np.hypot(*grown) + np.hypot(*mine)) + 1e-9
    dx, dy = other_x[:, None] - poses[0, one], other_y[:, None] - poses[1, one]
    pair, command, instant = np.nonzero(dx * dx + dy * dy < (radius**2)[:, None, None])
    hit = boxes_overlap(
        dx[pair, command, instant],
        dy[pair, command, instant],
        poses[2, one[pair], command, instant],
        yaw[pair],
        (mine[0][pair], mine[1][pair]),
        (grown[0][pair], grown[1][pair]),
    )
    np.minimum.at(found, (one[pair[hit]], command[hit]), t[instant[hit]])
    return found


def _within_reach(
    table: AgentTable, rows: IntArray, horizon: float, margin: float
) -> tuple[IntArray, IntArray, BoolArray]:
    """Pairs of agents and others that may come near within `horizon` [s].

    Followers in the own lane are not among them.

    Returns:
        positions in `rows`, rows of the others, and whether the boxes of a pair touch already; arrays (k,).
    """
    dx, dy = table.x - table.x[rows, None], table.y - table.y[rows, None]
    reach = table.length + table.length[rows, None] + (table.speed + table.speed[rows, None]) * horizon
    near = dx * dx + dy * dy < reach * reach
    near[np.arange(len(rows)), rows] = False
    one, other = np.nonzero(near)
    own = rows[one]
    ahead, left = to_body(dx[one, other], dy[one, other], table.yaw[own])
    half_length, half_width = (
        0.5 * (table.length[other] + table.length[own]),
        0.5 * (table.width[other] + table.width[own]),
    )
    kept = ~((ahead < -half_length) & (np.abs(left) < half_width))
    one, other, own = one[kept], other[kept], own[kept]
    touching = boxes_overlap(
        dx[one, other],
        dy[one, other],
        table.yaw[own],
        table.yaw[other],
        (table.length[own], table.width[own]),
        (table.length[other] + 2.0 * margin, table.width[other] + 2.0 * margin),
    )
    return one, other, touching


def _steps(seconds: float) -> int:
    """Steps of a look ahead of `seconds`, at least one."""
    return max(1, round(seconds / STEP_S))
