"""Successors and neighbours of lanes by their geometry, for maps that do not name them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from litsim_data.maps.lane_graph import Lanelet
from litsim_sim.core.geometry import to_body, wrap_angle

APART = 1.0  # [m] between the end of a lane and the beginning of the next one
TURN = np.deg2rad(30.0)  # between their directions there
BESIDE = (2.2, 5.0)  # [m] between the middles of two lanes side by side
OFFSET = 3.0  # [m] along the road between the ends of two lanes side by side


def linked(lanelets: Sequence[Lanelet], *, ends: bool) -> list[Lanelet]:
    """Returns lanelets with their neighbours, and, if `ends`, with those that begin where they end as successors."""
    begins = np.array([lanelet.centerline[0] for lanelet in lanelets])
    stops = np.array([lanelet.centerline[-1] for lanelet in lanelets])
    out = np.array([lanelet.course(0) for lanelet in lanelets])
    into = np.array([lanelet.course(-1) for lanelet in lanelets])
    names = [lanelet.id for lanelet in lanelets]
    result = []
    for row, lanelet in enumerate(lanelets):
        after = np.hypot(*(begins - stops[row]).T) < APART
        after &= np.abs(wrap_angle(out - into[row])) < TURN
        apart, apart_end = begins - begins[row], stops - stops[row]
        ahead, left = to_body(apart[:, 0], apart[:, 1], out[row])
        ahead_end, left_end = to_body(apart_end[:, 0], apart_end[:, 1], into[row])
        beside = (np.abs(ahead) < OFFSET) & (np.abs(ahead_end) < OFFSET) & (np.abs(wrap_angle(out - out[row])) < TURN)
        neighbours: dict[float, str | None] = {}
        for side in (1.0, -1.0):
            fits = beside & (side * left > BESIDE[0]) & (side * left < BESIDE[1])
            fits &= (side * left_end > BESIDE[0]) & (side * left_end < BESIDE[1])
            neighbours[side] = names[int(np.argmin(np.where(fits, np.abs(left), np.inf)))] if fits.any() else None
        followers = tuple(names[other] for other in np.flatnonzero(after) if other != row) if ends else ()
        result.append(
            replace(
                lanelet,
                left_id=neighbours[1.0],
                right_id=neighbours[-1.0],
                successors=(*lanelet.successors, *followers),
            )
        )
    return result
