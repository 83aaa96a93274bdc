"""Realism of the agents under control: the likelihood of their motion under the histograms of the log.

Follows the Waymo Open Sim Agents Challenge (Montali et al. 2023) with the roles swapped: the challenge judges the log
under many rollouts; here one deterministic run is judged under the log. The weights are the challenge's, renormalised
over the features that can be judged: that of traffic lights needs signals and a judged agent that passed a stop line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np

from litsim_data.surrogates.safety import TTC_HORIZON_S, times_to_collision
from litsim_eval.analysis.signals import Passage
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.nearby import Sorted, sorted_by_place, within_reach
from litsim_sim.core.scene import AgentTable, ByteArray, FloatArray, IntArray
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
SMOOTHING = 0.1  # pseudo-count of a bin, so that no likelihood is 0
FIRST_REACH = 5.0  # [m] from which the search for the nearest agent begins, twice as far each time
SAMPLE = 5  # every fifth step is judged


@dataclass(frozen=True)
class Realism:
    """Likelihoods relative to those of the log under its own histograms, each in (0, 1].

    Attributes:
        score: weighted mean.
        features: likelihood by feature.
        steps: number of judged agent-steps.
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
        """Prepares to judge `agents` or subsets of them.

        Args:
            tables, log: the same steps of the run and of the log.
            agents: ids.
            lane_map: lanes; without them the two features of the road edge are left out.
            dt: duration of a step [s].
            passed, passed_in_log: passages of stop lines by all agents, in the run and in the log.
        """
        self._ids, self._judged = _sampled(Steps.of(tables), frozenset(agents), lane_map, dt)
        self._logged = dict(Steps.of(log).once(_histograms, lane_map, dt))
        self._logged["traffic_light_violation"] = _Histogram.of("traffic_light_violation", _at_red(passed_in_log))
        self._passed = passed

    def of(self, agents: Set[int]) -> Realism | None:
        """Returns the realism of `agents`, a subset of the agents prepared; None if nothing can be judged."""
        whose = np.isin(self._ids, sorted(agents))
        judged = {name: bins[whose] if len(bins) else bins for name, bins in self._judged.items()}
        judged["traffic_light_violation"] = _at_red(each for each in self._passed if each.agent in agents)
        logged, count = self._logged, len(judged["linear_speed"])
        if not count or not logged["linear_speed"].count:
            return None
        names = [n for n in FEATURES if len(judged[n]) and logged[n].count]
        likelihoods = {name: logged[name].relative_likelihood(judged[name]) for name in names}
        total = sum(FEATURES[name].weight for name in names)
        return Realism(sum(FEATURES[n].weight * likelihoods[n] for n in names) / total, likelihoods, count)


def _at_red(passed: Iterable[Passage]) -> ByteArray:
    """Returns the bins (m,) of passages: 1 for each at red, 0 for each other."""
    return np.array([each.at_red for each in passed], np.uint8)


def _bins(name: str, values: FloatArray) -> ByteArray:
    """Returns the bins (m,) of `values` (m,) of the feature `name`."""
    feature = FEATURES[name]
    edges = np.linspace(feature.low, feature.high, feature.bins + 1)[1:-1]
    return np.digitize(values, edges).astype(np.uint8)


@dataclass(frozen=True)
class _Histogram:
    """Distribution of a feature in the log.

    Attributes:
        log_likelihood: (bins,) log-likelihood of a value in each bin.
        mean: mean log-likelihood of the logged values.
        count: number of logged values.
    """

    log_likelihood: FloatArray
    mean: float
    count: int

    @classmethod
    def of(cls, name: str, logged: ByteArray) -> _Histogram:
        """Returns the histogram of the bins `logged` (m,) of values of the feature `name`."""
        counts = np.bincount(logged, minlength=FEATURES[name].bins) + SMOOTHING
        log_likelihood = np.log(counts / counts.sum())
        return cls(log_likelihood, log_likelihood[logged].mean() if len(logged) else 0.0, len(logged))

    def relative_likelihood(self, judged: ByteArray) -> float:
        """Returns the geometric mean likelihood of values in the bins `judged` (m,) over the logged, at most 1."""
        excess = self.log_likelihood[judged].mean() - self.mean
        return float(min(1.0, np.exp(excess)))


def _histograms(log: Steps, lane_map: LaneMap | None, dt: float) -> dict[str, _Histogram]:
    """Returns the histogram of every feature over all agents of the log."""
    _, logged = _sampled(log, None, lane_map, dt)
    return {name: _Histogram.of(name, bins) for name, bins in logged.items()}


def _sampled(
    steps: Steps, agents: frozenset[int] | None, lane_map: LaneMap | None, dt: float
) -> tuple[IntArray, dict[str, ByteArray]]:
    """Returns ids (m,), and bins (m,) of the features by name, of `agents` (None: all) at every fifth of `steps`."""
    ids, bins = np.empty(0, np.int64), dict.fromkeys(FEATURES, np.empty(0, np.uint8))
    for begin, end in steps.blocks():
        lead = max(0, begin - 2)  # of the steps before, which rates are of
        new, features = _values(steps.part(lead, end), lead, begin, agents, lane_map, dt)
        ids, bins = np.append(ids, new), {n: np.append(bins[n], _bins(n, values)) for n, values in features.items()}
    return ids, bins


def _values(
    steps: Steps, lead: int, begin: int, agents: frozenset[int] | None, lane_map: LaneMap | None, dt: float
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Returns the ids (m,) and features (m,) by name of :func:`_sampled` from index `begin` on; `steps` from `lead`."""
    table, number = steps.stacked, steps.stacked.number
    looked_at = (number >= begin - lead) & ((lead + number) % SAMPLE == 0) & steps.follows[number]
    if agents is not None:
        looked_at &= np.isin(steps.ids, sorted(agents))[steps.agent]
    rows = np.flatnonzero(looked_at)
    before = steps.rows_at(number[rows] - 1, table.id[rows])
    rows, before = rows[before >= 0], before[before >= 0]
    features = dict.fromkeys(FEATURES, np.empty(0))
    if not len(rows):
        return np.empty(0, np.int64), features
    turn = _turn(table, rows, before, dt)
    first = steps.rows_at(number[before] - 1, table.id[before])
    features["linear_speed"] = table.speed[rows]
    features["linear_acceleration"] = (table.speed[rows] - table.speed[before]) / dt
    features["angular_speed"] = turn
    known = (first >= 0) & steps.follows[number[before]]
    features["angular_acceleration"] = np.where(known, (turn - _turn(table, before, first, dt)) / dt, 0.0)
    features["distance_to_nearest"] = _distance_to_nearest(table, rows)
    features["collision"] = np.isin(rows, steps.overlaps).astype(np.float64)
    features["time_to_collision"] = np.minimum(times_to_collision(table, rows), TTC_HORIZON_S)
    if lane_map is not None:
        edge = _distance_to_edge(table, rows, lane_map)
        features["distance_to_road_edge"], features["off_road"] = edge, (edge < 0.0).astype(np.float64)
    return table.id[rows], features


def _turn(table: AgentTable, rows: IntArray, before: IntArray, dt: float) -> FloatArray:
    """Returns the angular speed (m,) [rad/s] of agents from rows `before` (m,) to `rows` (m,), a step later."""
    return np.angle(np.exp(1j * (table.yaw[rows] - table.yaw[before]))) / dt


def _distance_to_nearest(table: AgentTable, rows: IntArray) -> FloatArray:
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


def _distance_to_edge(table: AgentTable, rows: np.ndarray, lane_map: LaneMap) -> FloatArray:
    """Returns distances (m,) [m] of the outermost corner of each box from the edge of the road; negative off the road.

    A border of the lane nearest to the corner is an edge if no lane adjoins it; else it counts as 20 m away.
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
