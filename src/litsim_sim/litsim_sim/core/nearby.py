"""Agents within a radius of others, and a search for them that does not look at all agents."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from litsim_sim.core.pair_geometry import behind_scene, within_scenes
from litsim_sim.core.scene import AgentRows, AgentTable, BoolArray, IntArray
from litsim_sim.kernels.compiled import Bools, Floats, Ints, kernel

FEW = 16  # agents of a scene, times the share of agents that is asked for, up to which sorting costs more than it saves


class Sorted(NamedTuple):
    """Agents (n,) sorted by one coordinate within their scenes, for :func:`within_reach` of some of them (m,).

    Attributes:
        order: (n,) their rows, by scene and then by the coordinate.
        place: (n,) coordinates in that order [m].
        along: (n,) coordinate of each row [m].
        begin, end: (m,) positions in `order` between which the scene of each agent that is asked for is.
    """

    order: Ints
    place: Floats
    along: Floats
    begin: Ints
    end: Ints


def sorted_by_place(table: AgentRows, rows: IntArray) -> Sorted:
    """Returns the agents of `table` sorted by the coordinate in which they are spread most, to ask for those in `rows`.

    If it is not worth the sorting, all agents of a scene are said to be at one place.
    """
    begin, end = within_scenes(table.scene, rows)
    if (end - begin).sum() <= FEW * len(table):
        nowhere = np.zeros(len(table))
        return Sorted(np.arange(len(table)), nowhere, nowhere, begin, end)
    along = max((table.x, table.y), key=lambda values: float(np.fmax.reduce(values) - np.fmin.reduce(values)))
    order = np.lexsort((along, table.scene))
    return Sorted(order, along[order], along, begin, end)


@kernel
def within_reach(agents: Sorted, m: int, row: int, reach: float) -> tuple[int, int]:
    """Returns the range (first, end) of positions in `agents.order` that holds all agents up to `reach` [m] away.

    Agents farther away to the side are in the range as well. `row` is the row of the `m`-th agent of the question; the
    range lies within its scene.
    """
    begin, end = agents.begin[m], agents.end[m]
    place = agents.place[begin:end]
    first = np.searchsorted(place, agents.along[row] - reach)
    return begin + first, begin + np.searchsorted(place, agents.along[row] + reach, "right")


def around(table: AgentTable, centres: BoolArray, radius: float) -> BoolArray:
    """Returns the mask (n,) of agents within `radius` [m] of an agent of the mask `centres` (n,) in the same scene."""
    return _around(table.scene, table.x, table.y, centres, radius)


@kernel
def _around(scene: Ints, x: Floats, y: Floats, centres: Bools, radius: float) -> Bools:
    """See :func:`around`; `scene`, `x`, `y` (n,) are columns of the table."""
    near, begin, end = centres.copy(), 0, 0
    for i in range(len(x)):
        if i == end:
            begin, end = i, behind_scene(scene, i)
        if centres[i]:
            for j in range(begin, end):
                near[j] |= (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 <= radius**2
    return near
