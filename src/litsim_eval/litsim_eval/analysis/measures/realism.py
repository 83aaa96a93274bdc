"""Realism of the agents under control: the likelihood of their motion under the histograms of the log.

Follows the Waymo Open Sim Agents Challenge (Montali et al. 2023) with the roles swapped: the challenge judges the log
under many rollouts; here one deterministic run is judged under the log. The weights are the challenge's, renormalised
over the features that can be judged: that of traffic lights needs signals and a judged agent that passed a stop line.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import HIGHER, Branch, Count, Measure, Text, family
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.motion_features import FEATURES, Sampled, sampled
from litsim_eval.analysis.measures.signals import Passage, log_passages, run_passages
from litsim_sim.core.scene import AgentTable, ByteArray, FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

ROI_M = 30.0  # [m] default of a scenario without `roi_m`
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
        judged["traffic_light_violation"] = _at_red(passage for passage in self._passed if passage.agent in agents)
        logged, count = self._logged, len(judged["linear_speed"])
        if not count or not logged["linear_speed"].count:
            return None
        names = [n for n in FEATURES if len(judged[n]) and logged[n].count]
        likelihoods = {name: logged[name].relative_likelihood(judged[name]) for name in names}
        total = sum(FEATURES[name].weight for name in names)
        return Realism(sum(FEATURES[n].weight * likelihoods[n] for n in names) / total, likelihoods, count)


def _at_red(passed: Iterable[Passage]) -> ByteArray:
    """Returns the bins (m,) of passages: 1 for each at red, 0 for each other."""
    return np.array([passage.at_red for passage in passed], np.uint8)


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


def roi_of(run: Run) -> float:
    """Returns the radius [m] of the region of interest of the run's scenario."""
    return float(run.scenario.get("roi_m", ROI_M))


def near_ego_in_log(run: Run) -> set[int]:
    """Returns agents whose logs enter the region of interest around the ego's log; the same for every policy."""
    near: set[int] = set()
    for logged in run.simulated_log.parts():
        table = logged.stacked
        ego = logged.rows_of(np.array([run.info.ego_id]))[table.number, 0]
        apart = np.hypot(table.x - table.x[ego], table.y - table.y[ego])
        near |= set(table.id[(ego >= 0) & (apart <= roi_of(run))].tolist())
    return near - {run.info.ego_id}


def naturalness(run: Run) -> Naturalness:
    """Returns what judges the agents of a run that were ever under control, or come near the ego in the log."""
    agents = run.once(collisions).controlled | run.once(near_ego_in_log)
    passed = run.once(run_passages) or (), run.once(log_passages)
    return Naturalness(run.simulated, run.simulated_log, agents, lane_map_of(run), run.info.dt, *passed)


@Branch
def realism(run: Run) -> dict[str, Any] | None:
    """Returns the likelihood of the agents ever under control, under the histograms of the log."""
    likelihood = run.once(naturalness).of(run.once(collisions).controlled)
    if likelihood is None:
        return None
    lights = "judged" if "traffic_light_violation" in likelihood.features else "no stop line passed"
    return {
        "score": likelihood.score,
        "features": likelihood.features,
        "traffic_lights": "no signals" if run.signals is None else lights,
        "agent_steps": likelihood.steps,
    }


def _near_ego(run: Run) -> float | None:
    judged = run.once(naturalness).of(run.once(near_ego_in_log))
    return None if judged is None else judged.score


MEASURES = family(
    "of the agents ever under control: likelihood of their motion under the histograms of the log, relative to the "
    "log's own, with the weights of the Waymo sim agents challenge, over the features that can be judged, at every "
    "fifth step",
    Measure("realism.score", realism, "realism", "", HIGHER),
    Measure("realism.features", realism, better=HIGHER, keys=tuple(FEATURES)),
    "`judged`: the score has a term for the stop lines that these agents passed, green or red, against those passed in "
    "the log (weight 0.05); else why it has none",
    Text("realism.traffic_lights", realism),
    "number of judged agent-steps",
    Count("realism.agent_steps", realism),
    "the score of the agents whose logs come within `roi_m` of the ego's log, the same under every policy",
    Measure("realism_near", _near_ego, better=HIGHER),
)
