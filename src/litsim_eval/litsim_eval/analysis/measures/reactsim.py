"""The seven measures of ReactSim-Bench (Zhang et al. 2026, section 3.3 and appendix C.2) of the background of a run.

They ask whether agents respond safely, and as vehicles can, to an ego that does not drive its log. Nothing is copied
from the benchmark's code.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import LOWER, Branch, Count, Share, family, mean_of
from litsim_eval.analysis.measures.collision import Impact, collisions, judge
from litsim_eval.analysis.measures.motion_features import SAMPLE
from litsim_sim.core.geometry import to_body, wrap_angle
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import StackedTable, Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

TTC_RISKY_S = 0.5  # [s]
ALIKE, ALIKE_BARELY = math.radians(75.0), math.radians(10.0)  # largest turn of the ego from those behind it [rad]
BARELY_M = 0.5  # [m] lateral overlap of boxes below which the smaller turn counts
MOVING, BACKWARDS_M, TURNED = 1.0, -2.0, math.radians(75.0)  # wrong way: [m/s], [m] in a second, [rad]
ACCELERATION_MAX, CURVATURE_MAX = 6.001, 0.301  # [m/s2], [1/m]; Waymax's bounds with the paper's tolerance
SPAN = round(1.0 / STEP_S)  # steps over which one goes backwards
STEERED_SPEED = 0.6  # [m/s] below which there is no curvature
AT_FAULT = (Impact.FRONT, Impact.STOPPED_TRACK)
EXCUSED = (Impact.REAR, Impact.STOPPED_EGO)


@Branch
def reactsim(run: Run) -> dict[str, Any]:
    """Returns the measures over the steps after the history; None for a share of nothing.

    Vehicles and other agents are all of the background, whether a policy drives them or not. The last four measures are
    of every fifth step.
    """
    ego, lane_map, steps = run.info.ego_id, lane_map_of(run), run.simulated
    first = run.once(collisions).first
    touched = {sum(pair) - ego: steps[int(steps.step.searchsorted(k))] for pair, k in first.items() if ego in pair}
    vehicles = {agent: table for agent, table in touched.items() if not table.obstacle[table.row(agent)]}
    sampled = _sampled(steps, ego, lane_map)
    return {
        "ego_contacts": sum(_at_fault(table, agent, ego, lane_map) for agent, table in vehicles.items()),
        "ego_short_ttc": len(_too_near_in_time(steps, ego) | set(vehicles)),
        "contact_share": _contact_share(steps, ego),
        "off_road": None if lane_map is None else _off_road(sampled),
        "wrong_way": None if lane_map is None else _wrong_way(sampled),
        "acceleration_infeasible": mean_of(np.abs(sampled.acceleration[sampled.follows]) > ACCELERATION_MAX),
        "curvature_infeasible": mean_of(np.abs(sampled.curvature[sampled.follows]) > CURVATURE_MAX),
    }


def _at_fault(table: AgentTable, agent: int, ego: int, lane_map: LaneMap | None) -> bool:
    """Returns whether `agent` is at fault for its first contact with the ego, in `table`: as nuPlan's ego would be.

    It is if the ego stands, if its own front hits the ego, or if it is off the road; but not if it stands itself, or if
    the ego comes from behind.
    """
    verdict, row = judge(table, agent, ego).verdict, table.row(agent)
    off_road = lane_map is not None and not lane_map.inside_road(table.x[[row]], table.y[[row]])[0]
    return verdict in AT_FAULT or (off_road and verdict not in EXCUSED)


def _too_near_in_time(steps: Steps, ego: int) -> set[int]:
    """Returns vehicles that follow the ego and would ever reach it within half a second at constant speeds."""
    near: set[int] = set()
    for part in steps.parts():
        table = part.stacked
        of_ego = part.rows_of(np.array([ego]))[table.number, 0]
        rows = np.flatnonzero((of_ego >= 0) & (table.id != ego) & ~table.obstacle)
        ahead = of_ego[rows]
        gap, overlap = _gap(table, rows, ahead)
        turn = np.abs(wrap_angle(table.yaw[ahead] - table.yaw[rows]))
        follows = (gap > 0.0) & (overlap > 0.0) & (turn <= np.where(overlap < BARELY_M, ALIKE_BARELY, ALIKE))
        closing = table.speed[rows] - table.speed[ahead]
        near |= set(table.id[rows[follows & (gap < TTC_RISKY_S * closing)]].tolist())
    return near


def _gap(table: StackedTable, rows: IntArray, ahead: IntArray) -> tuple[FloatArray, FloatArray]:
    """Returns gaps (m,) [m] from the fronts of boxes in `rows` (m,) to those `ahead` (m,), and lateral overlaps."""
    turn = table.yaw[ahead] - table.yaw[rows]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    length, width = table.length[ahead], table.width[ahead]
    along, across = to_body(table.x[ahead] - table.x[rows], table.y[ahead] - table.y[rows], table.yaw[rows])
    gap = along - 0.5 * (table.length[rows] + length * cos + width * sin)
    return gap, 0.5 * (table.width[rows] + length * sin + width * cos) - np.abs(across)


def _contact_share(steps: Steps, ego: int) -> float | None:
    """Returns the share of the agent-steps of the background in contact with another one of it."""
    touching, whole = 0, 0
    for part in steps.parts():
        table, pairs = part.stacked, part.overlaps
        among = (table.id[pairs] != ego).all(axis=1) & ~table.obstacle[pairs].all(axis=1)
        touching += len(np.unique(pairs[among]))
        whole += int(np.count_nonzero(table.id != ego))
    return touching / whole if whole else None


@dataclass(frozen=True)
class _Sampled:
    """Vehicles of the background at every fifth step; arrays (m,).

    Attributes:
        agent, number: id, and index of the step.
        on_road: whether the centre is on a lane.
        wrong_way: whether it has moved backwards along its lane for a second, headed against it.
        follows: whether it is there a step before, so that the next two are known.
        acceleration: change of speed since then [m/s2].
        curvature: change of heading since then by the way [1/m]; 0 at rest.
    """

    agent: IntArray
    number: IntArray
    on_road: BoolArray
    wrong_way: BoolArray
    follows: BoolArray
    acceleration: FloatArray
    curvature: FloatArray


def _sampled(steps: Steps, ego: int, lane_map: LaneMap | None) -> _Sampled:
    """Returns the vehicles of the background at every fifth of `steps`; without lanes all are on the road."""
    parts = [_Sampled(*np.empty((2, 0), np.int64), *np.empty((3, 0), np.bool_), *np.empty((2, 0)))]
    for begin, end in steps.blocks():
        lead = max(0, begin - SPAN)  # the second before
        part = steps.part(lead, end)
        table = part.stacked
        number = lead + table.number
        looked_at = (number >= begin) & (number % SAMPLE == 0) & (table.id != ego) & ~table.obstacle
        rows = np.flatnonzero(looked_at)
        on_road = (
            np.ones(len(rows), np.bool_) if lane_map is None else lane_map.inside_road(table.x[rows], table.y[rows])
        )
        wrong = np.zeros(len(rows), np.bool_) if lane_map is None else _backwards(part, rows, lane_map)
        parts.append(_Sampled(table.id[rows], number[rows], on_road, wrong, *_kinematics(part, rows)))
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in _Sampled.__dataclass_fields__)
    return _Sampled(*joined)


def _kinematics(steps: Steps, rows: IntArray) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Returns `follows`, `acceleration` and `curvature` of :class:`_Sampled`, each (m,), for the agents in `rows`."""
    table = steps.stacked
    before = steps.rows_at(table.number[rows] - 1, table.id[rows])
    follows = (before >= 0) & steps.follows[table.number[rows]]
    speed, speed_before = table.speed[rows], table.speed[before]
    acceleration = (speed - speed_before) / STEP_S
    way = speed_before * STEP_S + 0.5 * acceleration * STEP_S**2
    steered = np.minimum(speed, speed_before) >= STEERED_SPEED
    turn = wrap_angle(table.yaw[rows] - table.yaw[before])
    return follows, acceleration, np.divide(turn, way, out=np.zeros(len(rows)), where=steered)


def _backwards(steps: Steps, rows: IntArray, lane_map: LaneMap) -> BoolArray:
    """Returns whether agents in `rows` (m,) have moved backwards along their lanes for a second, headed against them.

    The lane is the nearest, whichever way it leads; at a junction, where lanes cross, the nearest that leads their way.
    """
    table = steps.stacked
    before = steps.rows_at(table.number[rows] - SPAN, table.id[rows])
    x, y, yaw = table.x[rows], table.y[rows], table.yaw[rows]
    place = lane_map.nearest(x, y)
    inside = lane_map.internal[place.lane]
    heading = place.heading.copy()
    heading[inside] = lane_map.nearest(x[inside], y[inside], yaw[inside]).heading
    along, _ = to_body(x - table.x[before], y - table.y[before], heading)
    turned = np.abs(wrap_angle(yaw - heading)) > TURNED
    return (before >= 0) & turned & (table.speed[rows] > MOVING) & (along < BACKWARDS_M)


def _off_road(sampled: _Sampled) -> float | None:
    """Returns the share of agent-steps off the road, of vehicles that are on it where they are first seen."""
    order = np.lexsort((sampled.number, sampled.agent))
    agent, on_road = sampled.agent[order], sampled.on_road[order]
    _, first, which = np.unique(agent, return_index=True, return_inverse=True)
    return mean_of(~on_road[on_road[first][which]])


def _wrong_way(sampled: _Sampled) -> float | None:
    """Returns the share of vehicles that go the wrong way at two samples in a row, half a second apart."""
    order = np.lexsort((sampled.number, sampled.agent))
    agent, number, wrong = sampled.agent[order], sampled.number[order], sampled.wrong_way[order]
    again = (agent[1:] == agent[:-1]) & (np.diff(number) == SAMPLE) & wrong[1:] & wrong[:-1]
    vehicles = len(np.unique(agent))
    return len(np.unique(agent[1:][again])) / vehicles if vehicles else None


MEASURES = family(
    "of [ReactSim-Bench](https://arxiv.org/abs/2606.14058): vehicles that touch the ego at their own fault; that "
    "follow it with a time to collision below 0.5 s, or touch it",
    Count("reactsim.ego_contacts", reactsim, better=LOWER),
    Count("reactsim.ego_short_ttc", reactsim, better=LOWER),
    "share of the agent-steps of the background in contact with others of it; of its vehicles' steps with the centre "
    "on no lane, for those first seen on one; of its vehicles that drive against the traffic: 75° off, faster than 1 "
    "m/s, 2 m backwards in a second, for half a second",
    Share("reactsim.contact_share", reactsim, better=LOWER),
    Share("reactsim.off_road", reactsim, better=LOWER),
    Share("reactsim.wrong_way", reactsim, better=LOWER),
    "shares of its vehicles' steps with more than 6 m/s², and with a curvature of more than 0.3 per metre",
    Share("reactsim.acceleration_infeasible", reactsim, better=LOWER),
    Share("reactsim.curvature_infeasible", reactsim, better=LOWER),
)
