"""Checks that egos, recording and net of a scenario file fit together."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

import numpy as np

from litsim_sim.core.errors import InputError
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, Kind
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.lane_routes import shortest_way
from litsim_sim.scenario.changes import Cross, Enter, Inattentive, OfAll, Start
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario_file import ScenarioFile

STANDING_M = 1.0  # [m] extent of the track of a vehicle below which it is parked
DRIVING = 1.0  # [m/s] speed above which a heading is reliable
ON_LANE = 3.0  # [m] beside the nearest lane, up to which a goal is on the road
AGAINST_MAX = 0.5  # largest share of the positions of moving vehicles on lanes that lead the other way


class Demand(StrEnum):
    """Demands on the content of a scenario: on its length, its egos, and the coverage of the recording by the net."""

    LENGTH = "length"
    EGO = "ego"
    COVERAGE = "coverage"


class UnmetDemandError(InputError):
    """A demand on the content of a scenario, with readable files, is not met."""

    def __init__(self, demand: Demand, message: str) -> None:
        """`message` is the text for the user."""
        super().__init__(message)
        self.demand = demand


def check_agents(file: ScenarioFile, log: Log, history_steps: int, where: str) -> None:
    """Raise UnmetDemandError if an ego is not there up to the first simulated step, or in both `tuning` and `egos`."""
    both = sorted(set(file.egos) & set(file.tuning))
    if both:
        raise UnmetDemandError(
            Demand.EGO, f"{where}: field tuning repeats {both} of field egos, expected disjoint lists"
        )
    needed = history_steps + 1
    for field, agents in (("ego", [file.ego]), ("egos", file.egos), ("tuning", file.tuning)):
        for agent in agents:
            row = log.row(agent)
            if row < 0:
                start = ", ".join(str(i) for i in log.ids[log.valid[:, 0]])
                raise UnmetDemandError(
                    Demand.EGO, f"{where}: field {field}: no vehicle {agent}; present at the start: {start}"
                )
            if log.obstacle[row]:
                kind = Kind(int(log.kind[row])).name.lower()
                raise UnmetDemandError(Demand.EGO, f"{where}: field {field}: {agent} is a {kind}, expected a vehicle")
            first, last = int(log.first_step[row]), int(log.last_step[row])
            if first > 0 or last < needed:
                raise UnmetDemandError(
                    Demand.EGO,
                    f"{where}: field {field}: vehicle {agent} is present in steps {first} to {last}, expected at "
                    f"least steps 0 to {needed} (the history and the first simulated step)",
                )


def check_changes(file: ScenarioFile, log: Log, history_steps: int, where: str) -> None:
    """Raise UnmetDemandError if an agent of the changes is not there, may not change, or would in the history."""
    for number, change in enumerate(file.changes):
        if isinstance(change, OfAll):
            continue
        row, fault = log.row(change.agent), ""
        if row < 0:
            fault = f"agent: no agent {change.agent} in these steps"
        elif log.obstacle[row] != isinstance(change, Cross):
            expected = "a pedestrian or cyclist" if isinstance(change, Cross) else "a vehicle"
            fault = f"agent: {change.agent} is a {Kind(int(log.kind[row])).name.lower()}, expected {expected}"
        elif (change.agent == file.ego) != isinstance(change, Start):
            expected = "the ego" if isinstance(change, Start) else "another agent than the ego"
            fault = f"agent: {change.agent}, expected {expected}"
        elif isinstance(change, Enter):
            if log.first_step[row] <= history_steps:
                fault = f"agent: {change.agent} is there in the history, expected one that enters later"
        elif not isinstance(change, Start | Inattentive) and round(change.begin_s / STEP_S) < history_steps:
            fault = f"begin_s: {change.begin_s:g} s, expected at least the history of {file.history_s:g} s"
        if fault:
            raise UnmetDemandError(Demand.EGO, f"{where}: field changes.{number}.{fault}")


def check_goal(file: ScenarioFile, log: Log, lane_map: LaneMap, history_steps: int, where: str) -> None:
    """Raise InputError if the goal, if any, is on no lane, or no way leads there from where the ego begins to drive."""
    if file.goal is not None:
        row = log.row(file.ego)
        pose = np.array([values[row, history_steps] for values in (log.x, log.y, log.yaw)])
        way_to_goal(np.array(file.goal), pose, lane_map, where)


def way_to_goal(goal: FloatArray, pose: FloatArray, lane_map: LaneMap, where: str) -> tuple[list[int], float]:
    """Returns the lanes of the shortest way to a goal, by position, and where on the first it begins [m].

    Args:
        goal: (3,) x, y [m], yaw [rad] of the box centre.
        pose: (3,) the same where the ego begins to drive.
        lane_map: lanes.
        where: names the scenario in errors.

    Raises:
        InputError: the goal is on no lane, or no way leads there.
    """
    told = f"{where}: field goal: {', '.join(f'{value:g}' for value in goal)}"
    place, begin = (lane_map.nearest(there[:1], there[1:2], there[2:]) for there in (goal, pose))
    end, start = int(place.lane[0]), int(begin.lane[0])
    if abs(float(place.d[0])) > ON_LANE or bool(place.against(goal[2:])[0]):
        raise InputError(f"{told} is on no lane in its direction, expected a pose on a lane [m, m, rad]")
    s = float(begin.s[0])
    behind = lane_map.lanes[end].edge_id == lane_map.lanes[start].edge_id and float(place.s[0]) < s
    way = [] if behind else shortest_way(lane_map, start, {end})
    if not way:
        raise InputError(
            f"{told}: no way leads there from the ego at {pose[0]:.1f}, {pose[1]:.1f}, expected a pose ahead of it"
        )
    return way, s


def check_coverage(lane_map: LaneMap, net: Path, log: Log, demanded: float, where: str) -> float:
    """Check that the net covers the recording.

    Pedestrians, cyclists and vehicles parked beside the lanes do not count: they do not keep to lanes.

    Returns:
        share of the recorded box centres that lie within half a lane width of some lane's centre line; NaN for none.

    Raises:
        UnmetDemandError: the share is below `demanded`, or the lanes lead the other way; `where` names the scenario.
    """
    counts = log.valid & ~log.obstacle[:, None]
    inside = np.zeros_like(counts)
    inside[counts] = lane_map.inside_road(log.x[counts], log.y[counts])
    counts &= inside | ~_parked(log)[:, None]
    share = float(inside[counts].mean()) if counts.any() else float("nan")
    if share < demanded:
        x, y = log.x[log.valid], log.y[log.valid]
        x0, y0, x1, y1 = lane_map.bounds
        raise UnmetDemandError(
            Demand.COVERAGE,
            f"{where}: net {net.name} does not cover the recording: {share:.1%} of the box centres are on its lanes, "
            f"expected {demanded:.0%} (field coverage_min); the recording spans x {x.min():.0f} to {x.max():.0f}, "
            f"y {y.min():.0f} to {y.max():.0f} m, the net x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {y1:.0f} m",
        )
    driving = counts & (log.speed > DRIVING)
    against = lane_map.against(log.x[driving], log.y[driving], log.yaw[driving]).mean() if driving.any() else 0.0
    if against > AGAINST_MAX:
        raise UnmetDemandError(
            Demand.COVERAGE,
            f"{where}: net {net.name} leads the other way than the recording: {against:.1%} of the poses of moving "
            f"vehicles head against its lanes, expected at most {AGAINST_MAX:.0%}",
        )
    return share


def _parked(log: Log) -> BoolArray:
    """Returns the mask (n,) of the agents that stay within STANDING_M for as long as they are there."""
    spans = (np.ma.masked_array(values, ~log.valid) for values in (log.x, log.y))
    extent = np.hypot(*(span.max(axis=1) - span.min(axis=1) for span in spans))
    return np.asarray(extent.filled(0.0) < STANDING_M, np.bool_)
