"""Wall time of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_eval.analysis.step_path import step_path
from litsim_sim.record.run import Run


@dataclass(frozen=True)
class StageTime:
    """Time [ms] of one stage, or of one part of a step's way, over the steps after the first."""

    min: float
    median: float
    max: float


@dataclass(frozen=True)
class Timing:
    """Wall time of a run.

    Attributes:
        wall_s: from the first answered step to the last [s]; None if the bridge did not finish.
        realtime_factor: simulated time over wall time; above 1 is faster than real time.
        stages: compute times by stage.
        path: durations of the parts of a step; see :func:`litsim_eval.analysis.step_path.step_path`.
    """

    wall_s: float | None
    realtime_factor: float | None
    stages: dict[str, StageTime]
    path: dict[str, StageTime]


def timing(run: Run) -> Timing:
    """Wall time and compute times; the latter without step 0, which includes loading and compilation."""
    wall = run.summary.get("wall_s")
    simulated = run.tables[-1].step * run.info.dt
    path: dict[str, list[float]] = {}
    for step in range(1, run.tables[-1].step):
        for name, seconds in step_path(step, run.marks).items():
            path.setdefault(name, []).append(seconds)
    stages = {name: [s for step, s in seconds.items() if step > 0] for name, seconds in sorted(run.timing.items())}
    return Timing(wall, simulated / wall if wall else None, _spread(stages), _spread(path))


def _spread(seconds: dict[str, list[float]]) -> dict[str, StageTime]:
    found = {name: 1e3 * np.array(values) for name, values in seconds.items() if values}
    return {name: StageTime(float(v.min()), float(np.median(v)), float(v.max())) for name, v in found.items()}
