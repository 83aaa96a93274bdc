"""Realism of the agents that were under control: how likely their motion is under the histograms of the log.

After the Waymo Open Sim Agents Challenge (Montali et al. 2023), the other way round: there the log is judged under many
rollouts, here one run is judged under the log, which is what a single deterministic run allows. Weights are the
challenge's, renormalised over the features that can be judged: what signals show is one where the scenario knows of
signals and an agent that is judged has passed a stop line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np

from litsim_sim.analysis.safety import TTC_HORIZON_S, times_to_collision
from litsim_sim.analysis.signals import Passage
from litsim_sim.core.geometry import box_corners, overlapping_pairs
from litsim_sim.core.scene import AgentTable, FloatArray, IntArray
from litsim_sim.maps.lane_map import LaneMap


@dataclass(frozen=True)
class Feature:
    """A quantity whose distribution is compared.

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
SMOOTHING = 0.1  # pseudo-count of a bin, so that nothing is impossible
SAMPLE = 5  # steps between those that are looked at


@dataclass(frozen=True)
class Realism:
    """Likelihoods relative to what the log reaches under its own histograms, each in (0, 1].

    Attributes:
        score: weighted mean.
        features: by name.
        steps: agent steps that were judged.
    """

    score: float
    features: dict[str, float]
    steps: int


class Naturalness:
    """Judges agents of a run under the histograms of all agents in its log."""

    def __init__(
        self,
        tables: Sequence[AgentTable],
        log: Sequence[AgentTable],
        agents: Iterable[int],
        lane_map: LaneMap | None,
        dt: float,
        passed: Sequence[Passage] = (),
        passed_in_log: Sequence[Passage] = (),
    ) -> None:
        """Get ready to judge `agents` or some of them.

        Args:
            tables, log: the same steps of the run and of the log.
            agents: ids.
            lane_map: for the road edge; without it the two features of the road are left out.
            dt: of a step [s].
            passed, passed_in_log: stop lines that were passed in the run and in the log, by anybody.
        """
        self._ids, self._judged = _values(tables, frozenset(agents), lane_map, dt)
        _, self._logged = _values(log, None, lane_map, dt)
        self._logged["traffic_light_violation"] = _at_red(passed_in_log)
        self._passed = passed

    def of(self, agents: Set[int]) -> Realism | None:
        """Realism of `agents`, of those that are judged; None where nothing can be."""
        whose = np.isin(self._ids, sorted(agents))
        judged = {name: values[whose] if len(values) else values for name, values in self._judged.items()}
        judged["traffic_light_violation"] = _at_red(each for each in self._passed if each.agent in agents)
        logged, count = self._logged, len(judged["linear_speed"])
        if not count or not len(logged["linear_speed"]):
            return None
        names = [n for n in FEATURES if len(judged[n]) and len(logged[n])]
        found = {name: _relative_likelihood(FEATURES[name], judged[name], logged[name]) for name in names}
        total = sum(FEATURES[name].weight for name in names)
        return Realism(sum(FEATURES[n].weight * found[n] for n in names) / total, found, count)


def _at_red(passed: Iterable[Passage]) -> FloatArray:
    """(m,) 1 for each stop line that was passed at red, 0 for each other."""
    return np.array([each.at_red for each in passed], np.float64)


def _relative_likelihood(feature: Feature, judged: FloatArray, logged: FloatArray) -> float:
    """Geometric mean of the likelihood of `judged`, over that of `logged`, at most 1."""
    edges = np.linspace(feature.low, feature.high, feature.bins + 1)[1:-1]
    own = np.digitize(logged, edges)
    counts = np.bincount(own, minlength=feature.bins) + SMOOTHING
    log_likelihood = np.log(counts / counts.sum())
    excess = log_likelihood[np.digitize(judged, edges)].mean() - log_likelihood[own].mean()
    return float(min(1.0, np.exp(excess)))


def _values(
    tables: Sequence[AgentTable], agents: frozenset[int] | None, lane_map: LaneMap | None, dt: float
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Every feature of `agents` (None: all) at every fifth of `tables`, concatenated; before them, whose they are."""
    parts: dict[str, list[FloatArray]] = {name: [] for name in FEATURES}
    ids = [np.empty(0, np.int64)]
    for k in range(SAMPLE, len(tables), SAMPLE):
        table, before = tables[k], tables[k - 1]
        which = np.ones(len(table), np.bool_) if agents is None else np.isin(table.id, sorted(agents))
        earlier = before.rows(table.id)
        rows = np.flatnonzero(which & (earlier >= 0))
        if not len(rows):
            continue
        turn = np.angle(np.exp(1j * (table.yaw[rows] - before.yaw[earlier[rows]]))) / dt
        ids.append(table.id[rows])
        parts["linear_speed"].append(table.speed[rows])
        parts["linear_acceleration"].append((table.speed[rows] - before.speed[earlier[rows]]) / dt)
        parts["angular_speed"].append(turn)
        parts["angular_acceleration"].append(_turn_change(tables, k, table.id[rows], turn, dt))
        parts["distance_to_nearest"].append(_distance_to_nearest(table, rows))
        parts["collision"].append(_colliding(table)[rows].astype(np.float64))
        parts["time_to_collision"].append(np.minimum(times_to_collision(table, rows), TTC_HORIZON_S))
        if lane_map is not None:
            edge = _distance_to_edge(table, rows, lane_map)
            parts["distance_to_road_edge"].append(edge)
            parts["off_road"].append((edge < 0.0).astype(np.float64))
    found = {name: np.concatenate(values) if values else np.empty(0) for name, values in parts.items()}
    return np.concatenate(ids), found


def _turn_change(tables: Sequence[AgentTable], k: int, ids: np.ndarray, turn: FloatArray, dt: float) -> FloatArray:
    """Angular acceleration [rad/s2] from the two steps before; zero where an agent was not there."""
    if k < 2:
        return np.zeros(len(ids))
    last, before = tables[k - 1], tables[k - 2]
    i, j = last.rows(ids), before.rows(ids)
    known = (i >= 0) & (j >= 0)
    earlier = np.angle(np.exp(1j * (last.yaw[i] - before.yaw[j]))) / dt
    return np.where(known, (turn - earlier) / dt, 0.0)


def _distance_to_nearest(table: AgentTable, rows: np.ndarray) -> FloatArray:
    """Between centres, less the mean half-length of both [m]; 40 m where an agent is alone."""
    if len(table) < 2:
        return np.full(len(rows), 40.0)
    distance = np.hypot(table.x[rows, None] - table.x, table.y[rows, None] - table.y)
    distance[np.arange(len(rows)), rows] = np.inf
    nearest = np.argmin(distance, axis=1)
    return distance[np.arange(len(rows)), nearest] - 0.5 * (table.length[rows] + table.length[nearest])


def _colliding(table: AgentTable) -> np.ndarray:
    """(n,) whose box overlaps another."""
    pairs = overlapping_pairs(table.x, table.y, table.yaw, table.length, table.width)
    return np.isin(np.arange(len(table)), pairs)


def _distance_to_edge(table: AgentTable, rows: np.ndarray, lane_map: LaneMap) -> FloatArray:
    """Of the corner that is farthest out, from the edge of the lanes there [m]; negative off the road.

    On the road it is what is left of the lane that the corner is in, so neighbouring lanes count as edges only where
    there is none.
    """
    corners = box_corners(table.x[rows], table.y[rows], table.yaw[rows], table.length[rows], table.width[rows])
    x, y = corners[..., 0].ravel(), corners[..., 1].ravel()
    at = lane_map.nearest(x, y)
    half = np.array([lane.width for lane in lane_map.lanes])[at.lane] / 2
    left_open = np.array([lane.left is None for lane in lane_map.lanes])[at.lane]
    right_open = np.array([lane.right is None for lane in lane_map.lanes])[at.lane]
    to_left = np.where(left_open, half - at.d, 20.0)
    to_right = np.where(right_open, half + at.d, 20.0)
    return np.minimum(to_left, to_right).reshape(len(rows), 4).min(axis=1)
