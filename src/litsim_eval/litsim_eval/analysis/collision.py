"""Collisions of a run: contacts between agents, which of them the log contains too, and fault in the ego's contacts."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import shapely

from litsim_eval.analysis.contacts import Contact, LogContacts, Pair, contacts
from litsim_sim.core.dynamics import VehicleLimits
from litsim_sim.core.geometry import box_corners, wrap_angle
from litsim_sim.core.scene import AgentTable
from litsim_sim.core.steps import Steps
from litsim_sim.record.run import Run

STOPPED_SPEED = 0.05  # [m/s] up to which a vehicle counts as stopped (nuPlan)
REAR_AXLE = VehicleLimits().rear_axle  # of an ego whose scenario says nothing else
BEHIND_ANGLE = np.deg2rad(150.0)  # bearing from the ego's heading beyond which a track is behind the ego (nuPlan)

InLane = Callable[[AgentTable, int], bool]
"""Whether the box of the agent in a row of a table lies wholly inside one lane."""


class Verdict(StrEnum):
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
        delta_v: change of the ego's velocity in a perfectly inelastic impact of equal masses [m/s].
    """

    agent: int
    step: int
    verdict: Verdict
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
        return _first(each for each, logged in zip(self.contacts, self.in_log, strict=True) if not logged)

    @property
    def colliding(self) -> frozenset[int]:
        """Ids of all agents with a contact."""
        return frozenset(agent for pair in self.first for agent in pair)

    @property
    def colliding_beyond_log(self) -> frozenset[int]:
        """Ids of all agents with a contact that is not in the log."""
        return frozenset(agent for pair in self.excess for agent in pair)


def collisions(run: Run, in_lane: InLane | None = None) -> Collisions:
    """The collisions of a run; without `in_lane` the ego counts as outside its lane in lateral contacts."""
    tables, ego = run.simulated, run.info.ego_id
    found, logged = tuple(contacts(tables, run.info.dt)), LogContacts(run)
    in_log = tuple(map(logged.excuse, found))
    by_step, axle = {table.step: table for table in tables}, _rear_axle_of(run)
    telling = _first(each for _, each in sorted(zip(in_log, found, strict=True), key=lambda pair: pair[0]))
    mine = sorted((step, pair) for pair, step in telling.items() if ego in pair)
    return Collisions(
        contacts=found,
        in_log=in_log,
        log=logged.first,
        agents=agents_of(tables) | agents_of(run.simulated_log),
        controlled=controlled_agents(tables),
        ego=tuple(
            judge(by_step[step], ego, pair[0] if pair[1] == ego else pair[1], in_lane, axle) for step, pair in mine
        ),
    )


def _rear_axle_of(run: Run) -> float:
    """Distance of the ego's rear axle behind its box centre, as a share of its length, by the run's scenario."""
    vehicle = run.scenario.get("vehicle")
    return float(vehicle.get("rear_axle", REAR_AXLE)) if isinstance(vehicle, dict) else REAR_AXLE


def _first(found: Iterable[Contact]) -> dict[Pair, int]:
    """First step of the first contact of each pair in `found`."""
    first: dict[Pair, int] = {}
    for each in found:
        first.setdefault(each.pair, each.first)
    return first


def agents_of(tables: Iterable[AgentTable]) -> frozenset[int]:
    """Ids of all agents that are ever on the road."""
    return Steps.of(tables).once(_agents)


def _agents(steps: Steps) -> frozenset[int]:
    return frozenset(steps.ids.tolist())


def controlled_agents(tables: Iterable[AgentTable]) -> frozenset[int]:
    """Ids of all agents that are ever under POLICY control."""
    table = Steps.of(tables).stacked
    return frozenset(np.unique(table.id[table.of_policy]).tolist())


def judge(
    table: AgentTable, ego: int, agent: int, in_lane: InLane | None = None, rear_axle: float = REAR_AXLE
) -> EgoContact:
    """Kind and attribution of the contact between `ego` and `agent` in `table`.

    Order of tests, thresholds and attribution are those of nuPlan's no-at-fault-collision metric (Caesar et al. 2021,
    nuplan-devkit): the ego is at fault in contacts with a stopped track, in contacts of its front bumper, and in
    lateral contacts while its box is not inside one lane.

    Args:
        table: the agents at the first step of the contact.
        ego, agent: ids.
        in_lane: see :func:`collisions`.
        rear_axle: distance of the ego's rear axle, from which a track is seen, behind its box centre [lengths].
    """
    e, a = table.row(ego), table.row(agent)
    verdict = _verdict(table, e, a, rear_axle)
    inside = verdict == Verdict.LATERAL and in_lane is not None and in_lane(table, e)
    at_fault = verdict in (Verdict.STOPPED_TRACK, Verdict.FRONT) or (verdict == Verdict.LATERAL and not inside)
    return EgoContact(agent, table.step, verdict, at_fault, _delta_v(table, e, a))


def _verdict(table: AgentTable, e: int, a: int, rear_axle: float) -> Verdict:
    if table.speed[e] <= STOPPED_SPEED:
        return Verdict.STOPPED_EGO
    if table.speed[a] <= STOPPED_SPEED:
        return Verdict.STOPPED_TRACK
    lever = rear_axle * table.length[e]
    dx = table.x[a] - (table.x[e] - lever * np.cos(table.yaw[e]))
    dy = table.y[a] - (table.y[e] - lever * np.sin(table.yaw[e]))
    if abs(wrap_angle(np.arctan2(dy, dx) - table.yaw[e])) > BEHIND_ANGLE:
        return Verdict.REAR
    corners = box_corners(table.x, table.y, table.yaw, table.length, table.width)
    bumper = shapely.LineString(corners[e][[0, 3]])  # front left, front right
    return Verdict.FRONT if bumper.intersects(shapely.Polygon(corners[a])) else Verdict.LATERAL


def _delta_v(table: AgentTable, e: int, a: int) -> float:
    """Half the relative velocity [m/s]: a perfectly inelastic impact of equal masses."""
    yaw, speed = table.yaw[[e, a]], table.speed[[e, a]]
    difference = np.diff(np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1), axis=0)
    return 0.5 * float(np.hypot(*difference[0]))
