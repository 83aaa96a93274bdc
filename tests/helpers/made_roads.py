"""Plans of roads for tests of nets."""

from __future__ import annotations

import numpy as np

from litsim_data.maps.highway import HighwayPlan, Ramp


def us101_like_plan() -> HighwayPlan:
    """A straight section of 640 m with US-101's layout: x runs along the road from 0, the left edge is y = 0.

    Five lanes and an auxiliary lane from the on-ramp at 579 ft to the off-ramp 698 ft further on.
    """
    return HighwayPlan(np.array([[0.0, 0.0], [640.0, 0.0]]), Ramp(gore=176.0), Ramp(gore=389.0))
