"""Collisions of a run: contacts between agents, which of them the log contains too, and fault in the ego's contacts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely

from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.geometry import box_corners, wrap_angle
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

TOLERANCE_S = 1.0
"""Time [s] between overlaps of a pair up to which they are one contact, or up to which one in the log excuses one."""

Pair = tuple[int, int]
"""Ids of two agents, the smaller one first."""
STOPPED_SPEED = 0.05  # [m/s] up to which a vehicle counts as stopped (nuPlan)
REAR_AXLE = VehicleLimits().rear_axle  # of an ego whose scenario says nothing else
BEHIND_ANGLE = np.deg2rad(150.0)  # bearing from the ego's heading beyond which a track is behind the ego (nuPlan)


@dataclass(frozen=True)
class Contact:
    """An overlap of two boxes; interruptions of up to TOLERANCE_S do not end it.

    Attributes:
        pair: ids of the agents.
        first, last: first and last step of the overlap.
    """

    pair: Pair
    first: int
    last: int


def contacts(tables: Iterable[AgentTable], dt: float) -> list[Contact]:
    """Returns the contacts in `tables`, ascending steps of `dt` [s], sorted by first step.

    Touching edges do not count, nor do contacts among pedestrians and cyclists, who do not react to each other.
    """
    return list(Steps.of(tables).once(_contacts_in, dt))


class LogContacts:
    """The contacts in the log of a run, history included; they excuse contacts of the run.

    Attributes:
        first: first step after the history at which the boxes of each pair of logged agents overlap, the ego's logged
            trajectory included.
    """

    def __init__(self, run: Run) -> None:
        self._tolerance = round(TOLERANCE_S / run.info.dt)
        self.first: dict[Pair, int] = {}
        for step, pair in run.logged.once(_overlaps):
            if step > run.info.history_steps:
                self.first.setdefault(pair, step)
        self._by_pair: dict[Pair, list[Contact]] = {}
        for contact in contacts(run.logged, run.info.dt):
            self._by_pair.setdefault(contact.pair, []).append(contact)
        self._lags: dict[int, list[tuple[int, int]]] = {}  # by agent: (step, lag from then on)
        for step in sorted(run.takeovers):
            for takeover in run.takeovers[step]:
                lags, lag = self._lags.setdefault(takeover.agent, []), round(takeover.time_shift / run.info.dt)
                if not lags or lags[-1][1] != lag:
                    lags.append((step, lag))

    def excuse(self, contact: Contact) -> bool:
        """Returns whether the log has a contact of the pair at about that time, with or without a lag of either log."""
        shifts = {0, *(self._lag(agent, contact.first) for agent in contact.pair)}
        logged: Sequence[Contact] = self._by_pair.get(contact.pair, ())
        first, last = contact.first - self._tolerance, contact.last + self._tolerance
        return any(
            recorded.first <= last - shift and first - shift <= recorded.last for shift in shifts for recorded in logged
        )

    def _lag(self, agent: int, step: int) -> int:
        """Returns the lag [steps] of the log of `agent` at `step`, as left by its last takeover until then."""
        return next((lag for begin, lag in reversed(self._lags.get(agent, [])) if begin <= step), 0)


def _overlaps(steps: Steps) -> list[tuple[int, Pair]]:
    """Returns step and ids of each pair of overlapping boxes, except where both are pedestrians or cyclists."""
    overlaps = []
    for part in steps.parts():
        table, pairs = part.stacked, part.overlaps
        pairs = pairs[~table.obstacle[pairs].all(axis=1)]
        moments = part.step[table.number[pairs[:, 0]]].tolist()
        overlaps += [(step, (i, j)) for step, (i, j) in zip(moments, table.id[pairs].tolist(), strict=True)]
    return overlaps


def _contacts_in(steps: Steps, dt: float) -> tuple[Contact, ...]:
    """See :func:`contacts`."""
    merge = round(TOLERANCE_S / dt)
    by_pair: dict[Pair, list[list[int]]] = {}
    for step, pair in steps.once(_overlaps):
        stretches = by_pair.setdefault(pair, [])
        if stretches and step - stretches[-1][1] <= merge:
            stretches[-1][1] = step
        else:
            stretches.append([step, step])
    merged = (Contact(pair, first, last) for pair, stretches in by_pair.items() for first, last in stretches)
    return tuple(sorted(merged, key=lambda contact: contact.first))


class Impact(StrEnum):
    """nuPlan's kinds of ego contact, in the order in which they are tested."""

    STOPPED_EGO = "stopped_ego"
    STOPPED_TRACK = "stopped_track"
    REAR = "rear"
    FRONT = "front"
    LATERAL = "lateral"


@dataclass(frozen=True)
class EgoContact:
    """First contact of the ego with one agent; contacts that are not in the log take precedence.

    Attributes:
        agent: id of the other agent.
        step: first step of the contact.
        verdict: kind of contact.
        ego_at_fault: whether nuPlan's metric attributes the contact to the ego.
        delta_v: change of the ego's velocity in a perfectly inelastic impact of equal masses, half the relative
            velocity [m/s].
    """

    agent: int
    step: int
    verdict: Impact
    ego_at_fault: bool
    delta_v: float


@dataclass(frozen=True)
class Collisions:
    """Collisions over the steps after the history.

    Attributes:
        contacts: all contacts, by first step.
        in_log: for each contact, whether the log contains it too.
        log: step of the first contact of each pair of logged agents, the ego's logged trajectory included.
        agents: ids of all agents on the road in the run or in the log; includes agents that are held back at their
            entry or never enter.
        controlled: ids of the agents that were ever under POLICY control.
        ego: contacts of the ego, by step.
    """

    contacts: tuple[Contact, ...]
    in_log: tuple[bool, ...]
    log: dict[Pair, int]
    agents: frozenset[int]
    controlled: frozenset[int]
    ego: tuple[EgoContact, ...]

    @property
    def first(self) -> dict[Pair, int]:
        """Step of the first contact of each pair, in ascending order."""
        return _first(self.contacts)

    @property
    def excess(self) -> dict[Pair, int]:
        """Step of the first contact that is not in the log, of each pair that has one."""
        return _first(contact for contact, logged in zip(self.contacts, self.in_log, strict=True) if not logged)

    @property
    def colliding(self) -> frozenset[int]:
        """Ids of all agents with a contact."""
        return frozenset(agent for pair in self.first for agent in pair)

    @property
    def colliding_beyond_log(self) -> frozenset[int]:
        """Ids of all agents with a contact that is not in the log."""
        return frozenset(agent for pair in self.excess for agent in pair)


def collisions(run: Run) -> Collisions:
    """Returns the collisions of a run; without lanes the ego counts as outside its lane in lateral contacts."""
    tables, ego = run.simulated, run.info.ego_id
    touching, logged = tuple(contacts(tables, run.info.dt)), LogContacts(run)
    in_log = tuple(map(logged.excuse, touching))
    vehicle = run.scenario.get("vehicle")
    axle = float(vehicle.get("rear_axle", REAR_AXLE)) if isinstance(vehicle, dict) else REAR_AXLE
    telling = _first(contact for _, contact in sorted(zip(in_log, touching, strict=True), key=lambda pair: pair[0]))
    of_ego = sorted((step, sum(pair) - ego) for pair, step in telling.items() if ego in pair)
    lane_map = lane_map_of(run) if of_ego else None
    return Collisions(
        contacts=touching,
        in_log=in_log,
        log=logged.first,
        agents=frozenset(tables.ids.tolist()) | frozenset(run.simulated_log.ids.tolist()),
        controlled=frozenset(i for part in tables.parts() for i in part.stacked.id[part.stacked.of_policy].tolist()),
        ego=tuple(
            judge(tables[int(tables.step.searchsorted(step))], ego, agent, lane_map, axle) for step, agent in of_ego
        ),
    )


def _first(made: Iterable[Contact]) -> dict[Pair, int]:
    """Returns the first step of the first contact of each pair."""
    first: dict[Pair, int] = {}
    for contact in made:
        first.setdefault(contact.pair, contact.first)
    return first


def judge(
    table: AgentTable, ego: int, agent: int, lane_map: LaneMap | None = None, rear_axle: float = REAR_AXLE
) -> EgoContact:
    """Returns kind and attribution of the contact between `ego` and `agent` in `table`.

    Order of tests, thresholds and attribution are those of nuPlan's no-at-fault-collision metric (Caesar et al. 2021,
    nuplan-devkit): the ego is at fault in contacts with a stopped track, in contacts of its front bumper, and in
    lateral contacts while its box is not inside one lane.

    Args:
        table: the agents at the first step of the contact.
        ego, agent: ids.
        lane_map: lanes; without them the ego counts as outside its lane.
        rear_axle: distance of the ego's rear axle, from which a track is seen, behind its box centre [lengths].
    """
    e, a = table.row(ego), table.row(agent)
    impact = _impact(table, e, a, rear_axle)
    at_fault = impact in (Impact.STOPPED_TRACK, Impact.FRONT)
    if impact == Impact.LATERAL:
        box = (values[e : e + 1] for values in (table.x, table.y, table.yaw, table.length, table.width))
        at_fault = lane_map is None or not lane_map.inside_lane(*box)[0]
    yaw, speed = table.yaw[[e, a]], table.speed[[e, a]]
    relative = np.diff(np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1), axis=0)
    return EgoContact(agent, table.step, impact, bool(at_fault), 0.5 * float(np.hypot(*relative[0])))


def _impact(table: AgentTable, e: int, a: int, rear_axle: float) -> Impact:
    if table.speed[e] <= STOPPED_SPEED:
        return Impact.STOPPED_EGO
    if table.speed[a] <= STOPPED_SPEED:
        return Impact.STOPPED_TRACK
    lever = rear_axle * table.length[e]
    dx = table.x[a] - (table.x[e] - lever * np.cos(table.yaw[e]))
    dy = table.y[a] - (table.y[e] - lever * np.sin(table.yaw[e]))
    if abs(wrap_angle(np.arctan2(dy, dx) - table.yaw[e])) > BEHIND_ANGLE:
        return Impact.REAR
    corners = box_corners(table.x, table.y, table.yaw, table.length, table.width)
    bumper = shapely.LineString(corners[e][[0, 3]])  # front left, front right
    return Impact.FRONT if bumper.intersects(shapely.Polygon(corners[a])) else Impact.LATERAL
