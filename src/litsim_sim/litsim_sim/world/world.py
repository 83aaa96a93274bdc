"""The world that the bridge steps: logged agents, controlled agents, entries and exits, contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import (
    AgentTable,
    BoolArray,
    Controller,
    ControlSource,
    ControlTable,
    EgoCommand,
    EgoMode,
)
from litsim_sim.core.stages import EndReason, RunEnd
from litsim_sim.scenario.setting import Setting
from litsim_sim.world.actors import Actors
from litsim_sim.world.driven import DrivenVehicles, check_answers
from litsim_sim.world.entries import Entries
from litsim_sim.world.log_policy import LogPolicy

if TYPE_CHECKING:
    from litsim_sim.world.sumo import SumoMirror  # most runs in process have none, and libsumo takes a moment to load

EGO, LATE = int(Controller.EGO), int(ControlSource.LATE)  # plain numbers: numpy compares them much faster
DEVIATION_STEPS = 10  # [steps] period of checks of the mirror's positions


class World:
    """Steps the scenario at 10 Hz: :meth:`reset` gives step 0, :meth:`step` applies the answers to a step.

    An agent follows its log unless the controls list it. One that is no longer listed rejoins its log, the residual
    fading out; one listed with source LATE does so with a lag, from the logged pose nearest to it. One whose log ends
    while it is controlled drives on until it has left the net. One whose log begins where it would collide waits
    (`entries`), and then enters under POLICY. An actor of the scenario (`changes`) follows its act while that
    lasts; controls for it are ignored.

    The run is over once the ego has left: past an end of the net, or at the end of its log while it follows that.
    Leaving the road to the side is not leaving the net. If the scenario says so, the run is also over some time after
    the ego has touched an agent that it does not touch in the log.

    Batched scenarios are stepped together, each scene as if it were alone: see :meth:`step_batch`.
    """

    def __init__(self, scenario: Setting, mirror: SumoMirror | None = None, *, guard_entries: bool = True) -> None:
        """The world of `scenario`, at step 0, with a display of its agents.

        Unless entries are guarded, agents appear where and when their logs begin, also where they collide: pure replay.
        """
        self.scenario, self._mirror, self._guard_entries = scenario, mirror, guard_entries
        self._ego_ids, self._caught_up = scenario.ego_ids, True
        after = scenario.steps_after_contact
        self._steps_after_contact = {scene: steps for scene, steps in enumerate(after) if steps is not None}
        self.reset()

    def reset(self) -> AgentTable:
        """Begin a run, independent of earlier ones, and return its step 0."""
        scenes, log = len(self._ego_ids), self.scenario.log
        self.entries = Entries(log, self._guard_entries)
        """The agents that wait to enter, or have waited."""
        self.ends: list[RunEnd | None] = [None] * scenes
        """Why each scene ends at the current step; None while it goes on."""
        self._contacts: dict[tuple[int, int], int] = {}
        self._gone, self._mirror_deviation = np.zeros(scenes, np.bool_), 0.0
        self._have_driven = np.zeros(scenes, np.bool_)  # the ego of each scene, in the last step
        self._vehicles, self._log_policy = DrivenVehicles(self.scenario), LogPolicy(log)
        self._actors = Actors(self.scenario)
        self._table = self._finish(self._log_policy.table(0))
        return self._table

    def step(self, controls: ControlTable, ego: EgoCommand) -> AgentTable:
        """Apply the answers to the current step and return the next one; raises as :func:`.check_answers`."""
        return self.step_batch(controls, (ego,))

    def step_batch(self, controls: ControlTable, egos: Sequence[EgoCommand]) -> AgentTable:
        """Like :meth:`step`, with one answer for the ego of each scene, in the order of the scenes."""
        self.catch_up()
        table, step = self._table, self._table.step
        check_answers(step, self._ego_ids, controls, egos)
        controls = self._actors.overrule(table, controls)
        driving = [
            ego if driven and ego.mode == EgoMode.CONTROL else None
            for ego, driven in zip(egos, self.egos_are_driven.tolist(), strict=True)
        ]
        driven = self._vehicles.step(table, controls, driving)
        rejoins = table.off_log & ~table.mask(self._ego_ids[~self._have_driven])
        lagged = controls.id[controls.source == LATE]
        for agent in table.id[rejoins & (driven.rows(table.id) < 0)]:
            self._log_policy.release(table, int(agent), with_lag=bool(np.isin(agent, lagged)))
        self._have_driven = driven.rows(self._ego_ids) >= 0
        for scene in (~self._have_driven).nonzero()[0].tolist():
            self._vehicles.reset(scene)
        logged = self._log_policy.table(step + 1)
        if self._gone.any():
            logged = logged.take(~self._gone[logged.scene])
        following = self.entries.may_follow(logged, table, driven, self._log_policy.displaced(logged))
        following &= driven.rows(logged.id) < 0
        moved = self._without_leavers(AgentTable.merged(step + 1, (driven, logged.take(following))))
        self._table = self._finish(self.entries.admit(moved, logged))
        self._end_after_contacts(self._table)
        return self._table

    def drop(self, scene: int) -> AgentTable:
        """Take a scene that is over off the road, which no agent enters any more; return the agents of the others."""
        self.catch_up()
        self._gone[scene] = True
        self._table = self._table.take(~self._gone[self._table.scene])
        return self._table

    def catch_up(self) -> None:
        """Do the work of the current step that needs no answers: note contacts, update the mirror, look ahead.

        It happens by itself before the next step, and when its results are read; a caller with time to spare may call
        it sooner. A second call for a step does nothing.
        """
        if self._caught_up:
            return
        self._caught_up, table = True, self._table
        self._note_contacts(table)
        if self._mirror is not None:
            self._mirror.show(table)
            if table.step % DEVIATION_STEPS == 0:
                off = float(self._mirror.deviation(table).max(initial=0.0))
                self._mirror_deviation = max(self._mirror_deviation, off)
        self._log_policy.prepare(table.step + 1)

    @property
    def contacts(self) -> dict[tuple[int, int], int]:
        """First step of contact of every pair of ids that has ever overlapped."""
        self.catch_up()
        return self._contacts

    def summary(self, scene: int = 0, recorded_id: Callable[[int], int | None] = lambda agent: agent) -> dict[str, Any]:
        """Returns a summary of the run for the recording: reason of the end, contacts, entries, deviation of SUMO.

        The deviation is the largest at the steps at which it is checked: one in DEVIATION_STEPS, from step 0 on.
        `recorded_id` returns the id to report an agent by; None for an agent of another scene than `scene`.
        """
        self.catch_up()
        missing = self.entries.never_entered | self.entries.waiting.keys()
        return {
            "ended": (self.ends[scene] or RunEnd(EndReason.TIME, self._table.step)).plain(),
            "contacts": sum(recorded_id(agent) is not None for agent, _ in self.contacts),
            "late_entries": sorted(own for own in map(recorded_id, self.entries.late) if own is not None),
            "never_entered": sorted(own for own in map(recorded_id, missing) if own is not None),
            "sumo_deviation_m": self._mirror_deviation if self._mirror is not None else None,
        }

    def close(self) -> None:
        """End the mirror's simulation."""
        if self._mirror is not None:
            self._mirror.close()

    @property
    def ego_is_driven(self) -> bool:
        """Whether the ego's answer to the current step counts: the history is over and the ego is on the road."""
        return bool(self.egos_are_driven[0])

    @property
    def ended(self) -> RunEnd | None:
        """Why the run ends at the current step; None while it goes on."""
        return self.ends[0]

    @property
    def egos_are_driven(self) -> BoolArray:
        """(scenes,) :attr:`ego_is_driven` for the ego of each scene."""
        return (self._table.step >= self.scenario.history_steps) & (self._table.rows(self._ego_ids) >= 0)

    def _without_leavers(self, table: AgentTable) -> AgentTable:
        """Returns `table` without the egos that have just passed an end of the net; notes those that are gone."""
        lane_map = self.scenario.lane_map
        if table.step <= self.scenario.history_steps:
            return table
        rows, leavers = table.rows(self._ego_ids), []
        inside = np.zeros(len(rows), np.bool_)
        here = rows[rows >= 0]
        inside[rows >= 0] = lane_map.inside_road(table.x[here], table.y[here])
        for scene in (~inside).nonzero()[0].tolist():
            row = int(rows[scene])
            if self.ends[scene] is not None:
                continue
            if row < 0:
                self.ends[scene] = RunEnd(EndReason.LOG_OVER, table.step)
            else:
                lane = lane_map.ends.passed(float(table.x[row]), float(table.y[row]))
                if lane is not None:
                    self.ends[scene] = RunEnd(EndReason.NET_END, table.step, lane)
                    leavers.append(row)
        return table.take(np.delete(np.arange(len(table)), leavers)) if leavers else table

    def _note_contacts(self, table: AgentTable) -> None:
        """Note which agents touch at `table`; a second call for a step changes nothing."""
        for i, j in overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width, table.scene):
            self._contacts.setdefault((int(table.id[i]), int(table.id[j])), table.step)

    def _end_after_contacts(self, table: AgentTable) -> None:
        """Note which scenes are over at `table` because their egos have touched an agent."""
        if not self._steps_after_contact:
            return
        self._note_contacts(table)
        log, in_log = self.scenario.log, self.scenario.log_overlaps
        for scene, steps in self._steps_after_contact.items():
            with_ego = {pair: step for pair, step in self._contacts.items() if self._ego_ids[scene] in pair}
            touched = [step for (a, b), step in with_ego.items() if not len(in_log.steps(log.row(a), log.row(b)))]
            if self.ends[scene] is None and touched and table.step == min(touched) + steps:
                self.ends[scene] = RunEnd(EndReason.CONTACT, table.step)

    def _finish(self, table: AgentTable) -> AgentTable:
        """Mark the egos; the rest of what is due for the step has time until :meth:`catch_up`."""
        if table.step >= self.scenario.history_steps:
            table.controller[table.mask(self._ego_ids)] = EGO
        self._caught_up = False
        return table
