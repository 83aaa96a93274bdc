"""Features of the motion of agents at every fifth step, as bins of the histograms by which they are compared.

They are those of the Waymo Open Sim Agents Challenge (Montali et al. 2023, and its edition of 2025): how agents move,
how near they are to others, and where on the road they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from litsim_data.surrogates.safety import TTC_HORIZON_S, following, times_to_collision
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.nearby import Sorted, sorted_by_place, within_reach
from litsim_sim.core.scene import AgentRows, ByteArray, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.kernels.compiled import Floats, Ints, kernel
from litsim_sim.lane_map.lane_map import LaneMap


@dataclass(frozen=True)
class Feature:
    """A quantity with the histogram that it is compared by.

    Attributes:
        weight: share of the score, before renormalisation.
        low, high: range of the histogram; values outside count in the outermost bins.
        bins: number of bins.
    """

    weight: float
    low: float
    high: float
    bins: int


FEATURES: dict[str, Feature] = {
    "linear_speed": Feature(0.05, 0.0, 40.0, 20),  # [m/s]
    "linear_acceleration": Feature(0.05, -10.0, 10.0, 21),  # [m/s2]
    "angular_speed": Feature(0.05, -0.6, 0.6, 21),  # [rad/s]
    "angular_acceleration": Feature(0.05, -3.0, 3.0, 21),  # [rad/s2]
    "distance_to_nearest": Feature(0.10, -5.0, 40.0, 18),  # [m]
    "collision": Feature(0.25, 0.0, 1.0, 2),
    "distance_to_road_edge": Feature(0.05, -5.0, 20.0, 20),  # [m], positive on the road
    "off_road": Feature(0.25, 0.0, 1.0, 2),
    "time_to_collision": Feature(0.10, 0.0, TTC_HORIZON_S, 10),  # [s]
    "traffic_light_violation": Feature(0.05, 0.0, 1.0, 2),  # of each stop line passed, whether it was at red
}

SIM_AGENTS: dict[str, Feature] = {
    "linear_speed": Feature(0.05, 0.0, 25.0, 10),  # [m/s]
    "linear_acceleration": Feature(0.05, -12.0, 12.0, 11),  # [m/s2]
    "angular_speed": Feature(0.05, -0.628, 0.628, 11),  # [rad/s]
    "angular_acceleration": Feature(0.05, -3.14, 3.14, 11),  # [rad/s2]
    "distance_to_nearest": Feature(0.10, -5.0, 40.0, 10),  # [m]
    "collision": Feature(0.25, 0.0, 1.0, 2),
    "time_to_leader": Feature(0.10, 0.0, 5.0, 10),  # [s]
    "distance_to_road_edge": Feature(0.05, -40.0, 20.0, 10),  # [m], positive on the road
    "off_road": Feature(0.25, 0.0, 1.0, 2),
    "traffic_light_violation": Feature(0.05, 0.0, 1.0, 2),
}
"""Features of the challenge of 2025 with its weights and bins; those of two bins are of agents, not of steps."""

AHEAD = math.cos(math.radians(75.0))  # least cosine between the headings of an agent and its leader in the challenge
FIRST_REACH = 5.0  # [m] from which the search for the nearest agent begins, twice as far each time
SAMPLE = 5  # every fifth step is judged


@dataclass(frozen=True)
class Sampled:
    """Features of agents at every fifth step; empty arrays for those that cannot be told.

    Attributes:
        ids: (m,) agents.
        realism: (m,) bins by name of :data:`FEATURES`.
        sim_agents: (m,) bins by name of :data:`SIM_AGENTS`.
    """

    ids: IntArray
    realism: Mapping[str, ByteArray]
    sim_agents: Mapping[str, ByteArray]


def sampled(steps: Steps, agents: frozenset[int] | None, lane_map: LaneMap | None, dt: float) -> Sampled:
    """Returns features of `agents` (None: all) at every fifth of `steps`, which are `dt` [s] apart.

    Without `lane_map` there are none of the road; passages of stop lines are told elsewhere.
    """
    ids = [np.empty(0, np.int64)]
    sets: tuple[Mapping[str, Feature], ...] = FEATURES, SIM_AGENTS
    bins = tuple({name: [np.empty(0, np.uint8)] for name in features} for features in sets)
    for begin, end in steps.blocks():
        lead = max(0, begin - 2)  # of the steps before, which rates are of
        new, values = _values(steps.part(lead, end), lead, begin, agents, lane_map, dt)
        ids.append(new)
        for features, of_set in zip(sets, bins, strict=True):
            for name, parts in of_set.items():
                parts.append(_bins(features[name], values[name]))
    realism, sim_agents = ({name: np.concatenate(parts) for name, parts in of_set.items()} for of_set in bins)
    return Sampled(np.concatenate(ids), realism, sim_agents)


def _bins(feature: Feature, values: FloatArray) -> ByteArray:
    """Returns the bins (m,) of `values` (m,) of a feature."""
    edges = np.linspace(feature.low, feature.high, feature.bins + 1)[1:-1]
    return np.digitize(values, edges).astype(np.uint8)


def _values(
    steps: Steps, lead: int, begin: int, agents: frozenset[int] | None, lane_map: LaneMap | None, dt: float
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Returns the ids (m,) and features (m,) by name of :func:`sampled` from index `begin` on; `steps` from `lead`."""
    table, number = steps.stacked, steps.stacked.number
    looked_at = (number >= begin - lead) & ((lead + number) % SAMPLE == 0) & steps.follows[number]
    if agents is not None:
        looked_at &= np.isin(steps.ids, sorted(agents))[steps.agent]
    rows = np.flatnonzero(looked_at)
    before = steps.rows_at(number[rows] - 1, table.id[rows])
    rows, before = rows[before >= 0], before[before >= 0]
    features = dict.fromkeys((*FEATURES, *SIM_AGENTS), np.empty(0))
    if not len(rows):
        return np.empty(0, np.int64), features
    turn = _turn(table, rows, before, dt)
    first = steps.rows_at(number[before] - 1, table.id[before])
    features["linear_speed"] = table.speed[rows]
    features["linear_acceleration"] = (table.speed[rows] - table.speed[before]) / dt
    features["angular_speed"] = turn
    there = (first >= 0) & steps.follows[number[before]]
    features["angular_acceleration"] = np.where(there, (turn - _turn(table, before, first, dt)) / dt, 0.0)
    features["distance_to_nearest"] = _distance_to_nearest(table, rows)
    features["collision"] = np.isin(rows, steps.overlaps).astype(np.float64)
    features["time_to_collision"] = np.minimum(times_to_collision(table, rows), TTC_HORIZON_S)
    behind = following(table, rows)
    along = np.cos(table.yaw[behind.leader] - table.yaw[rows]) >= AHEAD
    features["time_to_leader"] = np.where(along, behind.time_to_leader, np.inf)
    if lane_map is not None:
        edge = _distance_to_edge(table, rows, lane_map)
        features["distance_to_road_edge"], features["off_road"] = edge, (edge < 0.0).astype(np.float64)
    return table.id[rows], features


def _turn(table: AgentRows, rows: IntArray, before: IntArray, dt: float) -> FloatArray:
    """Returns the angular speed (m,) [rad/s] of agents from rows `before` (m,) to `rows` (m,), a step later."""
    return np.angle(np.exp(1j * (table.yaw[rows] - table.yaw[before]))) / dt


def _distance_to_nearest(table: AgentRows, rows: IntArray) -> FloatArray:
    """Returns distances (m,) [m] to the nearest agent of the scene: of centres, minus half of both lengths.

    40 m without others.
    """
    nearest, distance = _nearest(sorted_by_place(table, rows), rows, table.x, table.y)
    return np.where(nearest < 0, 40.0, distance - 0.5 * (table.length[rows] + table.length[nearest]))


@kernel
def _nearest(agents: Sorted, rows: Ints, x: Floats, y: Floats) -> tuple[Ints, Floats]:
    """Returns the rows (m,) of the agents nearest to those in `rows` (m,), -1 for none, and the distances (m,) [m]."""
    nearest, distance = np.full(len(rows), -1, np.int64), np.full(len(rows), math.inf)
    for m in range(len(rows)):
        a, reach = rows[m], FIRST_REACH
        while nearest[m] < 0 or distance[m] > reach:
            reach *= 2.0
            begin, end = within_reach(agents, m, a, reach)
            for b in agents.order[begin:end]:
                apart = math.hypot(x[b] - x[a], y[b] - y[a])
                if b != a and (apart < distance[m] or (apart == distance[m] and b < nearest[m])):
                    nearest[m], distance[m] = b, apart
            if end - begin == agents.end[m] - agents.begin[m] or not reach < math.inf:
                break
    return nearest, distance


def _distance_to_edge(table: AgentRows, rows: np.ndarray, lane_map: LaneMap) -> FloatArray:
    """Returns distances (m,) [m] of the outermost corner of each box from the edge of the road; negative off the road.

    A border of the lane nearest to the corner is an edge if no lane adjoins it; else it counts as 20 m away.
    """
    corners = box_corners(table.x[rows], table.y[rows], table.yaw[rows], table.length[rows], table.width[rows])
    x, y = corners[..., 0].ravel(), corners[..., 1].ravel()
    place = lane_map.nearest(x, y)
    half = lane_map.widths[place.lane] / 2
    left_open = np.array([lane.left is None for lane in lane_map.lanes])[place.lane]
    right_open = np.array([lane.right is None for lane in lane_map.lanes])[place.lane]
    to_left = np.where(left_open, half - place.d, 20.0)
    to_right = np.where(right_open, half + place.d, 20.0)
    return np.minimum(to_left, to_right).reshape(len(rows), 4).min(axis=1)
