"""The measure `closest`: how near the centre of another agent came to that of the ego."""

from __future__ import annotations

import numpy as np

from litsim_eval.analysis.measure import Better, Measure
from litsim_sim.record.run import Run


def least_distance(run: Run) -> float | None:
    """Returns the least distance between the centre of the ego and that of another agent [m]; None without others."""
    nearest = []
    for table in run.tables:
        ego = table.id == run.info.ego_id
        if ego.any() and not ego.all():
            nearest.append(np.hypot(table.x[~ego] - table.x[ego], table.y[~ego] - table.y[ego]).min())
    return float(min(nearest)) if nearest else None


CLOSEST = Measure(
    "closest",
    least_distance,
    title="ego: closest centre",
    unit="m",
    better=Better.HIGHER,
    text="least distance between the centre of the ego and that of another agent, over all steps of the run",
)
