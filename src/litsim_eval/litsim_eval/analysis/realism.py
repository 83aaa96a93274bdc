"""Realism of the agents under control: the likelihood of their motion under the histograms of the log.

Follows the Waymo Open Sim Agents Challenge (Montali et al. 2023) with the roles swapped: the challenge judges the log
under many rollouts; here one deterministic run is judged under the log. The weights are the challenge's, renormalised
over the features that can be judged: that of traffic lights needs signals and a judged agent that passed a stop line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass

import numpy as np

from litsim_eval.analysis.motion_features import FEATURES, Sampled, sampled
from litsim_eval.analysis.signals import Passage
from litsim_sim.core.scene import AgentTable, ByteArray, FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap

SMOOTHING = 0.1  # pseudo-count of a bin, so that no likelihood is 0


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
    """Judges agents of a run under the histograms of all agents in its log.

    Attributes:
        run, log: features of the agents prepared, in the run, and of all agents in the log.
    """

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
        self.run: Sampled = sampled(Steps.of(tables), frozenset(agents), lane_map, dt)
        self.log: Sampled = Steps.of(log).once(sampled, None, lane_map, dt)
        self._logged = {name: _Histogram.of(name, bins) for name, bins in self.log.realism.items()}
        self._logged["traffic_light_violation"] = _Histogram.of("traffic_light_violation", _at_red(passed_in_log))
        self._passed = passed

    def of(self, agents: Set[int]) -> Realism | None:
        """Returns the realism of `agents`, a subset of the agents prepared; None if nothing can be judged."""
        whose = np.isin(self.run.ids, sorted(agents))
        judged = {name: bins[whose] if len(bins) else bins for name, bins in self.run.realism.items()}
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
