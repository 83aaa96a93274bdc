"""The world that the bridge steps: logged agents, controlled agents, entries and exits, contacts."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.quantities import Flag, configuration
from litsim_sim.core.run_end import EndReason, RunEnd
from litsim_sim.core.scene import AgentTable, Controller, ControlSource, ControlTable, EgoCommand, EgoMode, FloatArray
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.driven import DrivenVehicles, check_answers
from litsim_sim.world.entries import Entries, EntryConfig
from litsim_sim.world.log_policy import LogPolicy

DEVIATION_STEPS = 10  # steps from one check of where the mirror has the agents to the next


@configuration
class WorldConfig:
    """How the world treats agents that cannot follow their log.

    Attributes:
        guard_entries: hold back an agent whose log begins where it would collide with an agent that is off its log;
            False is pure replay, where it appears regardless.
        entry: when the road is free for a guarded entry.
        limits: of controlled vehicles but the ego, whose model is the scenario's.
    """

    guard_entries: Flag = True
    entry: EntryConfig = EntryConfig()
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
    (`entries`), and then enters under POLICY.

    The run is over once the ego has left: past an end of the net, or with its log where it followed that. Whoever
    leaves the road to the side has not left the net.
    """

    def __init__(self, scenario: Scenario, config: WorldConfig | None = None, mirror: Mirror | None = None) -> None:
        self.scenario = scenario
        self.config = config or WorldConfig()
        self.entries = Entries(scenario.log, self._entry)
        """Who waits to enter, and who has waited."""
        self.ended: RunEnd | None = None
        """Why no step needs to follow the current one; None while the ego is there."""
        self._contacts: dict[tuple[int, int], int] = {}
        self._mirror_deviation = 0.0
        self._mirror = mirror
        self._caught_up = True
        self._log_policy = LogPolicy(scenario.log)
        self._table = AgentTable.empty(0)
        self._ego_has_driven = False  # in the last step
        self._vehicles = DrivenVehicles(scenario, self.config.limits)

    def reset(self) -> AgentTable:
        """Begin a run that knows nothing of the ones before, and return its step 0."""
        self._contacts, self.entries = {}, Entries(self.scenario.log, self._entry)
        self._mirror_deviation, self._ego_has_driven, self.ended = 0.0, False, None
        self._vehicles.reset()
        self._log_policy = LogPolicy(self.scenario.log)
        self._table = self._finish(self._log_policy.table(0))
        return self._table

    def step(self, controls: ControlTable, ego: EgoCommand) -> AgentTable:
        """Apply the answers to the current step and return the next one.

        Raises:
            ValueError: `controls` or `ego` answer another step or hold non-finite values, or the ids of `controls` do
                not ascend or list the ego.
        """
        self.catch_up()
        table, step = self._table, self._table.step
        check_answers(step, self.scenario.ego_id, controls, ego)
        driven = self._vehicles.step(
            table, controls, ego if self.ego_is_driven and ego.mode == EgoMode.CONTROL else None
        )
        rejoins = table.off_log & ((table.id != self.scenario.ego_id) | self._ego_has_driven)
        lagged = controls.id[controls.source == ControlSource.LATE]
        for agent in table.id[rejoins & (driven.rows(table.id) < 0)]:
            self._log_policy.release(table, int(agent), with_lag=bool(np.isin(agent, lagged)))
        self._ego_has_driven = driven.row(self.scenario.ego_id) >= 0
        if not self._ego_has_driven:
            self._vehicles.reset()
        logged = self._log_policy.table(step + 1)
        following = logged.take((driven.rows(logged.id) < 0) & self.entries.may_follow(logged, table, driven))
        made = self._without_leaver(AgentTable.merged(step + 1, (driven, following)))
        self._table = self._finish(self.entries.admit(made, logged))
        return self._table

    def catch_up(self) -> None:
        """Do what is due for the current step and nobody waits for: note contacts, show it in the mirror.

        Happens by itself before the next step, and where its results are asked for; whoever has the time calls it
        sooner. A second call for a step does nothing.
        """
        if self._caught_up:
            return
        self._caught_up, table = True, self._table
        for i, j in overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width):
            self._contacts.setdefault((int(table.id[i]), int(table.id[j])), table.step)
        if self._mirror is not None:
            self._mirror.show(table)
            if table.step % DEVIATION_STEPS == 0:
                off = float(self._mirror.deviation(table).max(initial=0.0))
                self._mirror_deviation = max(self._mirror_deviation, off)

    @property
    def contacts(self) -> dict[tuple[int, int], int]:
        """First step of contact of every pair of ids that has ever overlapped."""
        self.catch_up()
        return self._contacts

    def summary(self) -> dict[str, Any]:
        """What only the world knows, for the record: why the run is over, contacts, entries, deviation of SUMO.

        The deviation is the largest at the steps at which it is checked: one in DEVIATION_STEPS, from step 0 on.
        """
        self.catch_up()
        return {
            "ended": (self.ended or RunEnd(EndReason.TIME, self._table.step)).plain(),
            "contacts": len(self.contacts),
            "late_entries": sorted(self.entries.late),
            "never_entered": sorted(self.entries.never_entered | self.entries.waiting.keys()),
            "sumo_deviation_m": self._mirror_deviation if self._mirror is not None else None,
        }

    def close(self) -> None:
        """End the mirror's simulation."""
        if self._mirror is not None:
            self._mirror.close()

    @property
    def ego_is_driven(self) -> bool:
        """Whether the ego's answer to the current step counts: the history is over and the ego is on the road."""
        return self._table.step >= self.scenario.history_steps and self._table.row(self.scenario.ego_id) >= 0

    @property
    def _entry(self) -> EntryConfig | None:
        """When the road is free for an entry; None where entries are not guarded."""
        return self.config.entry if self.config.guard_entries else None

    def _without_leaver(self, table: AgentTable) -> AgentTable:
        """`table` without the ego if it has just passed an end of the net; notes if it is gone."""
        ego, scenario = self.scenario.ego_id, self.scenario
        row = table.row(ego)
        if self.ended is not None or table.step <= scenario.history_steps:
            return table
        if row < 0:
            self.ended = RunEnd(EndReason.LOG_OVER, table.step)
        elif not scenario.lane_map.inside_road(table.x[row : row + 1], table.y[row : row + 1])[0]:
            lane = scenario.lane_map.ends.passed(float(table.x[row]), float(table.y[row]))
            if lane is not None:
                self.ended = RunEnd(EndReason.NET_END, table.step, lane)
                return table.take(table.id != ego)
        return table

    def _finish(self, table: AgentTable) -> AgentTable:
        """Mark the ego; the rest of what is due for the step has time until :meth:`catch_up`."""
        ego = table.row(self.scenario.ego_id)
        if ego >= 0 and table.step >= self.scenario.history_steps:
            table.controller[ego] = Controller.EGO
        self._caught_up = False
        return table
