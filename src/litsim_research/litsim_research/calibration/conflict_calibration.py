"""Calibration of detection thresholds: precision and recall of future conflicts, and the cost to runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from litsim_eval.analysis.metrics import compute_metrics
from litsim_eval.runs.runner import Runner, record
from litsim_policy.conflict.config import ConflictConfig
from litsim_policy.conflict.detector import ConflictDetector
from litsim_predictor.models import make_predictor
from litsim_research.calibration.conflict_recall import PairScores, score_drives
from litsim_sim.core.scene import FloatArray
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.scenario.scenario import Scenario

COSTS = {
    "contacts at the background's fault": lambda m: m["collision"]["by_fault"]["background"],
    "at the ego's, avoidable": lambda m: m["collision"]["by_fault"]["ego_avoidable"],
    "takeovers": lambda m: m["takeovers"],
    "false alarms": lambda m: m["false_alarms"],
    "hard brakes": lambda m: m["comfort"]["controlled"]["hard_brakes"],
    "time under control, s": lambda m: sum(each["held_s"] for each in m["ledger"]),
}
"""The costs of a run by name, each a function of its metrics."""


@dataclass(frozen=True)
class Curve:
    """Precision and recall (t,) by `thresholds` (t,); NaN if there is nothing to measure."""

    name: str
    thresholds: FloatArray
    precision: FloatArray
    recall: FloatArray


def tuning_of(scenario: Scenario) -> tuple[int, ...]:
    """The egos used for calibration: the tuning egos, or the ego of a scenario without any, such as a segment."""
    return scenario.tuning_egos or (scenario.ego_id,)


def recall_curve(
    name: str,
    scenarios: Sequence[Scenario],
    model: str,
    modes: int,
    config: ConflictConfig,
    second: int,
    thresholds: FloatArray,
    done: Callable[[], object] = lambda: None,
) -> Curve:
    """Precision and recall of detection for deviating egos; see :mod:`.conflict_recall`.

    Args:
        name: of the curve.
        scenarios: with the egos of :func:`tuning_of`.
        model: the predictor.
        modes: greatest number of further manoeuvres that it forecasts.
        config: of detection; its threshold is not used.
        second: horizon [s].
        thresholds: (t,).
        done: called after each ego.
    """
    parts = []
    for scenario in scenarios:
        detector = ConflictDetector(scenario.log, scenario.roi_m, config)
        for ego in tuning_of(scenario):
            one = scenario.around(ego, None)
            parts.append(score_drives(scenario, [ego], lambda _: make_predictor(model, one, modes=modes), detector))  # noqa: B023 - called at once
            done()
    return Curve(name, thresholds, *PairScores.joined(parts).curve(second, thresholds))


def costs(
    scenarios: Iterable[Scenario],
    ego: str,
    policy: str,
    parameters: dict[str, dict[str, Any]],
    done: Callable[[], object] = lambda: None,
) -> dict[str, float]:
    """Sums of :data:`COSTS` over one run for each ego of :func:`tuning_of`, of all `scenarios`.

    Args:
        scenarios: to run.
        ego: name of the ego driver.
        policy: of the background.
        parameters: by stage.
        done: called after each run.
    """
    total = dict.fromkeys(COSTS, 0.0)
    for scenario in scenarios:
        for own in tuning_of(scenario):
            plan = RunPlan(scenario.around(own, None), ego, policy, parameters=parameters)
            metrics = compute_metrics(record(Runner(plan)))
            for name, measure in COSTS.items():
                total[name] += measure(metrics)
            done()
    return total


def draw_calibration(curves: Sequence[Curve], found: dict[float, dict[str, float]], path: Path) -> None:
    """Write a PNG: precision over recall, with the thresholds, and costs over the threshold.

    Args:
        curves: at least one.
        found: costs by threshold; may be empty.
        path: of the picture.
    """
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2 if found else 1, figsize=(12 if found else 6.5, 5), squeeze=False)
    left = axes[0, 0]
    for curve in curves:
        (line,) = left.plot(100.0 * curve.recall, 100.0 * curve.precision, marker="o", markersize=3, label=curve.name)
        for threshold, x, y in zip(curve.thresholds, curve.recall, curve.precision, strict=True):
            left.annotate(f"{threshold:g}", (100.0 * x, 100.0 * y), fontsize=6, color=line.get_color())
    left.set_xlabel("recall, %")
    left.set_ylabel("precision, %")
    left.grid(alpha=0.3)
    left.legend(fontsize=8)
    for right in axes[0, 1:]:
        thresholds = sorted(found)
        for name in COSTS:
            right.plot(thresholds, [found[each][name] for each in thresholds], marker="o", markersize=3, label=name)
        right.set_xlabel("threshold")
        right.set_yscale("symlog")
        right.grid(alpha=0.3)
        right.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110, format="png")
    plt.close(figure)


def threshold_for(curve: Curve, precision: float) -> tuple[float, float] | None:
    """The threshold with the largest recall at `precision` or more, and that recall; None if there is none."""
    reached = np.flatnonzero(curve.precision >= precision)
    if not len(reached):
        return None
    best = reached[np.argmax(curve.recall[reached])]
    return float(curve.thresholds[best]), float(curve.recall[best])
