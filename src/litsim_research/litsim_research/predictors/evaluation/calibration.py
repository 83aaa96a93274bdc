"""Precision and recall of conflict detection, from which its threshold was chosen (docs/conflicts.md).

An ego deviates from its log along its logged path, once at constant speed and twice braking
(:mod:`litsim_research.predictors.evaluation.drives`), while all others follow their logs. At every second step, the
detector's probability of an overlap with each agent near the ego is recorded, and whether the two overlap later. A pair
counts until its first overlap.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from litsim_policy.conflict.detector import ConflictDetector
from litsim_policy.conflict.futures import Futures
from litsim_predictor.forecast import Forecast, Predictor
from litsim_predictor.models import make_predictor
from litsim_research.predictors.evaluation.drives import Drive, drives
from litsim_sim.core.geometry import boxes_overlap
from litsim_sim.core.scene import STEP_S, AgentTable, BoolArray, Controller, FloatArray
from litsim_sim.scenario.scenario import Scenario

EVERY = 2  # steps between two evaluations, as between two points of the models' forecasts
SECONDS = (1, 2, 3)
"""Horizons for which pairs are judged [s], up to the default horizon of detection."""
LEAST = 0.01  # least probability that is computed; lower ones count as 0


@dataclass(frozen=True)
class PairScores:
    """Pairs of a step and an agent; arrays (k, H) by the horizons :data:`SECONDS`.

    Attributes:
        probability: largest probability of an overlap up to the horizon; 0 below :data:`LEAST`.
        real: whether the boxes overlap by then.
        known: whether the drive lasts until then.
    """

    probability: FloatArray
    real: BoolArray
    known: BoolArray

    @classmethod
    def joined(cls, parts: Sequence[PairScores]) -> PairScores:
        """Returns `parts` concatenated; there is at least one."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def curve(self, second: int, thresholds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns precision and recall (t,) for a horizon; NaN if there is nothing to measure.

        Args:
            second: horizon, one of :data:`SECONDS`.
            thresholds: (t,) probabilities from which on an overlap counts as predicted.
        """
        column = SECONDS.index(second)
        valid = self.known[:, column]
        probability, real = self.probability[valid, column], self.real[valid, column]
        predicted = probability[:, None] >= thresholds
        hit = (predicted & real[:, None]).sum(axis=0).astype(np.float64)
        count = predicted.sum(axis=0)
        precision = np.divide(hit, count, out=np.full(len(thresholds), np.nan), where=count > 0)
        recall = hit / real.sum() if real.any() else np.full(len(thresholds), np.nan)
        return precision, recall


NO_PAIRS = PairScores(
    np.empty((0, len(SECONDS))), np.empty((0, len(SECONDS)), np.bool_), np.empty((0, len(SECONDS)), np.bool_)
)


def score_drives(scenario: Scenario, ego: int, detector: ConflictDetector, model: str, modes: int) -> PairScores:
    """Returns predicted and actual overlaps in the drives of `ego`, which brakes at times drawn by its id.

    The predictor called `model` forecasts at most `modes` further manoeuvres.
    """
    own = scenario.around(ego, None)
    parts = [NO_PAIRS]  # a drive may end with the history
    for drive in drives(scenario, ego, np.random.default_rng([0, ego])):
        parts += _scores(scenario, drive, make_predictor(model, own, modes=modes), detector)
    return PairScores.joined(parts)


def _scores(scenario: Scenario, drive: Drive, predictor: Predictor, detector: ConflictDetector) -> Iterator[PairScores]:
    """Yields scores of the pairs of a drive, at every step number EVERY after the history."""
    tables = [_driven(scenario, drive, step) for step in range(len(drive.x))]
    meets = [_meeting(table, drive.ego) for table in tables]
    met: set[int] = set()
    for step, table in enumerate(tables):
        met |= meets[step]
        if step < scenario.history_steps:
            predictor.observe(table)
            continue
        forecast = predictor.forecast(table)
        if (step - scenario.history_steps) % EVERY == 0:
            yield _judged(table, forecast, detector, meets, met, drive.ego)


def _judged(
    table: AgentTable,
    forecast: Forecast,
    detector: ConflictDetector,
    meets: Sequence[set[int]],
    met: set[int],
    ego: int,
) -> PairScores:
    """Returns scores of the pairs of a step; `meets` are the ids that overlap the ego by step, `met` all until now."""
    off = table.id == ego
    futures = Futures(detector.log, detector.config, table, forecast)
    pairs, probability = detector.pair_probabilities(futures, ~off & ~np.isin(table.id, list(met)), off, LEAST)
    agents = futures.covered.id[pairs[:, 0]].tolist()
    last = len(meets) - 1
    steps = [round(second / STEP_S) for second in SECONDS]
    upto = [set().union(*meets[table.step + 1 : table.step + 1 + count]) for count in steps]
    return PairScores(
        np.stack([probability[:, :count].max(axis=1, initial=0.0) for count in steps], axis=1).reshape(
            -1, len(SECONDS)
        ),
        np.array([[agent in ids for ids in upto] for agent in agents], np.bool_).reshape(-1, len(SECONDS)),
        np.broadcast_to([table.step + count <= last for count in steps], (len(agents), len(SECONDS))),
    )


def _driven(scenario: Scenario, drive: Drive, step: int) -> AgentTable:
    """Returns the log at `step`, with the ego as it drives."""
    table = scenario.log.table(step)
    row = table.row(drive.ego)
    changed = {name: getattr(table, name).copy() for name in ("x", "y", "yaw", "speed", "acceleration", "controller")}
    for name in ("x", "y", "yaw", "speed"):
        changed[name][row] = getattr(drive, name)[step]
    if step >= scenario.history_steps:
        changed["acceleration"][row] = (drive.speed[step] - drive.speed[max(step - 1, 0)]) / STEP_S
        changed["controller"][row] = Controller.EGO
    return replace(table, **changed)


def _meeting(table: AgentTable, ego: int) -> set[int]:
    """Returns ids of the agents whose boxes overlap the ego's."""
    row = table.row(ego)
    hit = boxes_overlap(
        table.x - table.x[row],
        table.y - table.y[row],
        np.full(len(table), table.yaw[row]),
        table.yaw,
        (table.length[row], table.width[row]),
        (table.length, table.width),
    )
    return set(table.id[hit & (table.id != ego)].tolist())
