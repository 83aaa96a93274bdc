"""Agents within a radius of others."""

from __future__ import annotations

from litsim_sim.core.pair_geometry import behind_scene
from litsim_sim.core.scene import AgentTable, BoolArray, FloatArray, IntArray
from litsim_sim.kernels.compiled import BOOLS, FLOATS, INTS, OUT_BOOLS, float64, kernel


def around(table: AgentTable, centres: BoolArray, radius: float) -> BoolArray:
    """Returns the mask (n,) of agents within `radius` [m] of an agent of the mask `centres` (n,) in the same scene."""
    return _around(table.scene, table.x, table.y, centres, radius)


@kernel(OUT_BOOLS(INTS, FLOATS, FLOATS, BOOLS, float64))
def _around(scene: IntArray, x: FloatArray, y: FloatArray, centres: BoolArray, radius: float) -> BoolArray:
    """See :func:`around`; `scene`, `x`, `y` (n,) are columns of the table."""
    near, begin, end = centres.copy(), 0, 0
    for i in range(len(x)):
        if i == end:
            begin, end = i, behind_scene(scene, i)
        if centres[i]:
            for j in range(begin, end):
                near[j] |= (x[j] - x[i]) ** 2 + (y[j] - y[i]) ** 2 <= radius**2
    return near
