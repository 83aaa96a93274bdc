"""The measure `closest`: how near the centre of another agent came to that of the ego."""

from __future__ import annotations

import numpy as np

from litsim_eval.analysis.metric import Better, Metric
from litsim_sim.record.run import Run


class Closest(Metric):
    """Least distance between the centre of the ego and that of another agent, over all steps of the run."""

    unit, better = "m", Better.HIGHER

    def measure(self, run: Run) -> float | None:
        """See :class:`litsim_eval.analysis.metric.Metric`."""
        nearest = []
        for table in run.tables:
            ego = table.id == run.info.ego_id
            if ego.any() and not ego.all():
                nearest.append(np.hypot(table.x[~ego] - table.x[ego], table.y[~ego] - table.y[ego]).min())
        return float(min(nearest)) if nearest else None
