"""What the run cost in wall time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from litsim_sim.record.run import Run


@dataclass(frozen=True)
class StageTime:
    """Compute time of one stage for one step, over the steps after the first [ms]."""

    min: float
    median: float
    max: float


@dataclass(frozen=True)
class Timing:
    """Wall time of a run.

    Attributes:
        wall_s: from the first answered step to the last [s]; None where the bridge did not finish.
        realtime_factor: simulated time over wall time; above 1 is faster than reality.
        stages: compute times by stage.
    """

    wall_s: float | None
    realtime_factor: float | None
    stages: dict[str, StageTime]


def timing(run: Run) -> Timing:
    """Wall time and compute times; step 0 is left out of the latter, it loads and compiles."""
    wall = run.summary.get("wall_s")
    simulated = run.tables[-1].step * run.info.dt
    stages = {}
    for stage, seconds in sorted(run.timing.items()):
        values = 1e3 * np.array([s for step, s in seconds.items() if step > 0])
        if len(values):
            stages[stage] = StageTime(float(values.min()), float(np.median(values)), float(values.max()))
    return Timing(wall, simulated / wall if wall else None, stages)
