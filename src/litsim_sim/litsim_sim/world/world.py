"""The world that the bridge steps: logged agents, controlled agents, entries and exits, contacts."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np

from litsim_sim.core.dynamics import Motion, VehicleLimits, bicycle_step
from litsim_sim.core.geometry import boxes_overlap, overlapping_pairs, to_body
from litsim_sim.core.scene import (
    ARRAY_FIELDS,
    STEP_S,
    AgentTable,
    Controller,
    ControlSource,
    ControlTable,
    EgoCommand,
    EgoMode,
    FloatArray,
    IntArray,
)
from litsim_sim.core.vehicle import Actuators
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.log_policy import LogPolicy


@dataclass(frozen=True)
class WorldConfig:
    """How the world treats agents that cannot follow their log.

    Attributes:
        guard_entries: hold back an agent whose log begins where it would collide with an agent that is off its log;
            False is pure replay, where it appears regardless.
        entry_gap: free road [m] that a guarded entry needs ahead and behind.
        entry_horizon: time [s] over which a guarded entry is checked at constant velocity.
        entry_deceleration: braking [m/s2] that a guarded entry may need behind a slower agent.
        limits: of controlled vehicles but the ego, whose model is the scenario's.
    """

    guard_entries: bool = True
    entry_gap: float = 1.0
    entry_horizon: float = 2.0
    entry_deceleration: float = 2.0
    limits: VehicleLimits = VehicleLimits()


class Mirror(Protocol):
    """Where the agents are shown: SUMO, or nothing."""

    def show(self, table: AgentTable) -> None:
        """Place the agents of `table` and advance by one step."""

    def deviation(self, table: AgentTable) -> FloatArray:
        """(n,) distance [m] between where the agents are shown and where `table` has them."""

    def close(self) -> None:
        """End the simulation."""


class World:
    """Steps the scenario at 10 Hz: :meth:`reset` gives step 0, :meth:`step` applies the answers to a step.

    An agent follows its log unless the controls list it. One that is no longer listed rejoins its log, the residual
    fading out; one listed with source LATE does so with a lag, from the logged pose nearest to it. One whose log ends
    while it is controlled drives on until it has left the net. One whose log begins where it would collide waits
    (`waiting`), and then enters under POLICY.
    """

    def __init__(self, scenario: Scenario, config: WorldConfig | None = None, mirror: Mirror | None = None) -> None:
        self.scenario = scenario
        self.config = config or WorldConfig()
        self.contacts: dict[tuple[int, int], int] = {}
        """First step of contact of every pair of ids that has ever overlapped."""
        self.late_entries: set[int] = set()
        self.waiting: dict[int, int] = {}
        """Step at which the log of each agent that waits to enter began."""
        self.never_entered: set[int] = set()
        """Agents whose log ended while they waited."""
        self.mirror_deviation = 0.0
        """Largest distance [m] so far between an agent and its image in SUMO."""
        self._mirror = mirror
        self._log_policy = LogPolicy(scenario.log)
        self._table = AgentTable.empty(0)
        self._ego_has_driven = False  # in the last step
        self._actuators = Actuators(scenario.vehicle)
        limits = self.config.limits
        self._own_limits = any(getattr(limits, f.name) != getattr(scenario.vehicle, f.name) for f in fields(limits))

    def reset(self) -> AgentTable:
        """Step 0, of a run that knows nothing of the ones before."""
        self.contacts, self.late_entries, self.waiting, self.never_entered = {}, set(), {}, set()
        self.mirror_deviation, self._ego_has_driven = 0.0, False
        self._actuators.reset()
        self._log_policy = LogPolicy(self.scenario.log)
        self._table = self._finish(self._log_policy.table(0))
        return self._table

    def step(self, controls: ControlTable, ego: EgoCommand) -> AgentTable:
        """Apply the answers to the current step and return the next one.

        Raises:
            ValueError: `controls` or `ego` answer another step or hold non-finite values, or the ids of `controls` do
                not ascend or list the ego.
        """
        table, step = self._table, self._table.step
        self._check(controls, ego)
        driven = self._drive(table, controls, ego)
        rejoins = table.off_log & ((table.id != self.scenario.ego_id) | self._ego_has_driven)
        late = controls.id[controls.source == ControlSource.LATE]
        for agent in table.id[rejoins & (driven.rows(table.id) < 0)]:
            self._log_policy.release(table, int(agent), late=bool(np.isin(agent, late)))
        self._ego_has_driven = driven.row(self.scenario.ego_id) >= 0
        if not self._ego_has_driven:
            self._actuators.reset()
        logged = self._log_policy.table(step + 1)
        following = logged.take((driven.rows(logged.id) < 0) & self._may_follow(logged, table, driven))
        self._table = self._finish(self._admit(_merge(step + 1, [driven, following]), logged))
        return self._table

    def summary(self) -> dict[str, Any]:
        """What only the world knows, for the record."""
        return {
            "contacts": len(self.contacts),
            "late_entries": sorted(self.late_entries),
            "never_entered": sorted(self.never_entered | self.waiting.keys()),
            "sumo_deviation_m": self.mirror_deviation,
        }

    def close(self) -> None:
        """End the mirror's simulation."""
        if self._mirror is not None:
            self._mirror.close()

    @property
    def ego_is_driven(self) -> bool:
        """Whether the ego's answer to the current step counts: the history is over and the ego is on the road."""
        return self._table.step >= self.scenario.history_steps and self._table.row(self.scenario.ego_id) >= 0

    def _check(self, controls: ControlTable, ego: EgoCommand) -> None:
        """Raise ValueError where the answers to the current step cannot be applied."""
        step, ego_id = self._table.step, self.scenario.ego_id
        if controls.step != step or ego.step != step:
            raise ValueError(f"answers to steps {controls.step} (controls) and {ego.step} (ego), expected {step}")
        if not np.isfinite([ego.acceleration, ego.yaw_rate]).all():
            raise ValueError(f"ego control at step {step} is not finite: {ego.acceleration}, {ego.yaw_rate}")
        values = (controls.acceleration, controls.lateral_acceleration, controls.yaw_rate)
        if not all(np.isfinite(each).all() for each in values):
            raise ValueError(f"controls at step {step} are not finite")
        if (np.diff(controls.id) <= 0).any():
            raise ValueError(f"ids of the controls at step {step} do not ascend: {controls.id.tolist()}")
        if ego_id in controls.id:
            raise ValueError(f"controls at step {step} list the ego, {ego_id}, which has a port of its own")

    def _drive(self, table: AgentTable, controls: ControlTable, ego: EgoCommand) -> AgentTable:
        """Agents under control, one step on; those that have left the net are gone."""
        stay = controls.source != ControlSource.LATE
        ids, acceleration, yaw_rate = controls.id[stay], controls.acceleration[stay], controls.yaw_rate[stay]
        controller = np.where(controls.source[stay] == ControlSource.BASELINE, Controller.BASELINE, Controller.POLICY)
        if self.ego_is_driven and ego.mode == EgoMode.CONTROL:
            ids = np.append(ids, self.scenario.ego_id)
            takes_effect = self._actuate(table, ego)
            acceleration = np.append(acceleration, takes_effect[0])
            yaw_rate = np.append(yaw_rate, takes_effect[1])
            controller = np.append(controller, Controller.EGO)
        rows = table.rows(ids)
        listed = rows >= 0
        rows, order = rows[listed], np.argsort(rows[listed], kind="stable")
        now = table.take(rows[order])
        moved = self._move(now, acceleration[listed][order], yaw_rate[listed][order])
        driven = AgentTable(
            table.step + 1,
            now.id,
            now.kind,
            controller[listed][order].astype(np.uint8),
            moved.x,
            moved.y,
            moved.yaw,
            moved.speed,
            moved.acceleration,
            moved.yaw_rate,
            now.length,
            now.width,
        )
        log_over = self.scenario.log.last_step[self._log_rows(driven.id)] <= table.step
        return driven.take(~log_over | self.scenario.lane_map.inside_road(driven.x, driven.y))

    def _actuate(self, table: AgentTable, ego: EgoCommand) -> tuple[float, float]:
        """What the ego's actuators make of its command."""
        row = table.row(self.scenario.ego_id)
        moving = float(table.acceleration[row]), float(table.yaw_rate[row])
        return self._actuators.apply(ego.acceleration, ego.yaw_rate, moving, float(table.speed[row]))

    def _move(self, now: AgentTable, acceleration: FloatArray, yaw_rate: FloatArray) -> Motion:
        """Agents one step on, each within the limits of its vehicle."""
        motion = Motion(now.x, now.y, now.yaw, now.speed, now.acceleration, now.yaw_rate)
        moved = bicycle_step(motion, now.length, acceleration, yaw_rate, self.config.limits)
        row = now.row(self.scenario.ego_id)
        if row >= 0 and self._own_limits:
            one = slice(row, row + 1)
            alone = Motion(*(getattr(motion, f.name)[one] for f in fields(Motion)))
            ego = bicycle_step(alone, now.length[one], acceleration[one], yaw_rate[one], self.scenario.vehicle)
            for field in fields(Motion):
                getattr(moved, field.name)[one] = getattr(ego, field.name)
        return moved

    def _may_follow(self, logged: AgentTable, table: AgentTable, driven: AgentTable) -> np.ndarray:
        """(n,) which agents of `logged` were on the road, or enter now and are not held back."""
        here = table.rows(logged.id) >= 0
        begins = self.scenario.log.first_step[self._log_rows(logged.id)] == logged.step
        for row in np.flatnonzero(begins & ~here):
            agent = int(logged.id[row])
            wanted = float(logged.speed[row])
            speed = self._entry_speed(logged, int(row), driven) if self.config.guard_entries else wanted
            if speed is None or speed < wanted:
                self.waiting[agent] = logged.step
            else:
                here[row] = True
        return here

    def _admit(self, table: AgentTable, logged: AgentTable) -> AgentTable:
        """Let agents that wait enter where their log begins, under POLICY, as soon as the road is free."""
        for agent, began in sorted(self.waiting.items()):
            if logged.row(agent) < 0:
                del self.waiting[agent]
                self.never_entered.add(agent)
                continue
            entry = self.scenario.log.table(began)
            row = entry.row(agent)
            speed = self._entry_speed(entry, row, table)
            if began == table.step or speed is None:
                continue
            entering = entry.take(np.array([row]))
            entering.speed[0] = min(speed, entering.speed[0])
            entering.acceleration[0] = entering.yaw_rate[0] = 0.0
            entering.controller[0] = Controller.POLICY
            del self.waiting[agent]
            self.late_entries.add(agent)
            table = _merge(table.step, [table, entering])
        return table

    def _entry_speed(self, entry: AgentTable, row: int, others: AgentTable) -> float | None:
        """Speed [m/s], at most the logged one, at which an agent can enter among `others`; None where it cannot."""
        config, log_speed = self.config, float(entry.speed[row])
        if not len(others):
            return log_speed
        dx, dy = others.x - entry.x[row], others.y - entry.y[row]
        ahead, left = to_body(dx, dy, entry.yaw[row])
        in_path = np.abs(left) < 0.5 * (others.width + entry.width[row]) + 0.3
        gap = ahead - 0.5 * (others.length + entry.length[row]) - config.entry_gap
        leads = in_path & (ahead > 0)
        speed = log_speed
        if leads.any():
            room = np.maximum(gap[leads], 0.0) * 2.0 * config.entry_deceleration
            speed = min(speed, float(np.sqrt(others.speed[leads] ** 2 + room).min()))
            if (gap[leads] < 0).any():
                return None
        times = np.arange(0.0, config.entry_horizon, 2 * STEP_S)[:, None]
        relative_x = dx + times * (others.speed * np.cos(others.yaw) - speed * np.cos(entry.yaw[row]))
        relative_y = dy + times * (others.speed * np.sin(others.yaw) - speed * np.sin(entry.yaw[row]))
        size = (entry.length[row] + config.entry_gap, entry.width[row])
        follows = in_path & (ahead <= 0)
        hit = boxes_overlap(relative_x, relative_y, entry.yaw[row], others.yaw, size, (others.length, others.width))
        return None if (hit & ((times == 0.0) | follows)).any() else speed

    def _finish(self, table: AgentTable) -> AgentTable:
        """Mark the ego, note contacts, show the step in SUMO."""
        ego = table.row(self.scenario.ego_id)
        if ego >= 0 and table.step >= self.scenario.history_steps:
            table.controller[ego] = Controller.EGO
        for i, j in overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width):
            self.contacts.setdefault((int(table.id[i]), int(table.id[j])), table.step)
        if self._mirror is not None:
            self._mirror.show(table)
            self.mirror_deviation = max(self.mirror_deviation, float(self._mirror.deviation(table).max(initial=0.0)))
        return table

    def _log_rows(self, ids: IntArray) -> IntArray:
        """Rows of agents in the log; every agent has one."""
        return np.searchsorted(self.scenario.log.ids, ids)


def _merge(step: int, tables: list[AgentTable]) -> AgentTable:
    """One table of the agents of several, ids ascending."""
    columns = {f: np.concatenate([getattr(t, f) for t in tables]) for f in ARRAY_FIELDS}
    order = np.argsort(columns["id"], kind="stable")
    return AgentTable(step, **{f: values[order] for f, values in columns.items()})
