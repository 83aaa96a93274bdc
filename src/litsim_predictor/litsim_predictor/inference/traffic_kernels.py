"""How fast the traffic ahead of each agent drives, as a compiled kernel in single precision.

The same is for training in :mod:`litsim_predictor.learned.models.traffic_ahead`.
"""

from __future__ import annotations

import numpy as np

from litsim_predictor.forecast import Float32Array
from litsim_predictor.inference.attention_kernels import near_first
from litsim_predictor.inference.joint_units import TRAFFIC_KNOTS, TRAFFIC_SOME, TRAFFIC_WIDTHS
from litsim_sim.core.compiled import BOOLS, FLOATS2, INTS, OUT_SINGLES2, SINGLES, float32, kernel, void
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray

KNOTS, WIDTHS = np.array(TRAFFIC_KNOTS, np.float32), np.array(TRAFFIC_WIDTHS, np.float32)


@kernel(void(FLOATS2, SINGLES, SINGLES, BOOLS, INTS, OUT_SINGLES2))
def look_ahead(
    frame: FloatArray,
    speed: Float32Array,
    earlier: Float32Array,
    seen: BoolArray,
    begins: IntArray,
    out: Float32Array,
) -> None:
    """Write how fast the traffic ahead of each of n agents of several scenes drives.

    Args:
        frame: (n, 3) x, y [m] and heading [rad] of the agent frames.
        speed: (n,) [m/s].
        earlier, seen: (n,) speed [m/s] :data:`.joint_units.TRAFFIC_AGO` steps ago, and whether it is known.
        begins: (S,) rows at which the scenes begin.
        out: (n, TRAFFIC_CHANNELS); see :func:`.learned.models.traffic_ahead.traffic_ahead`.
    """
    agents, places = len(frame), len(KNOTS) - 2
    one, none, some = float32(1.0), float32(0.0), float32(TRAFFIC_SOME)
    position, heading = np.empty((agents, 2), np.float32), np.empty(agents, np.float32)
    near_first(frame, begins, position, heading)
    x, y, cos, sin = position[:, 0], position[:, 1], np.cos(heading), np.sin(heading)
    known = np.empty(places * len(WIDTHS), np.float32)  # of those who count at a place, whose earlier speed is known
    for scene in range(len(begins)):
        begin, end = begins[scene], begins[scene + 1] if scene + 1 < len(begins) else agents
        for i in range(begin, end):
            of = out[i]
            of[:], known[:] = none, none
            for j in range(begin, end):
                dx, dy = x[j] - x[i], y[j] - y[i]
                ahead, left = cos[i] * dx + sin[i] * dy, abs(cos[i] * dy - sin[i] * dx)
                along = cos[i] * cos[j] + sin[i] * sin[j]
                if ahead <= KNOTS[0] or ahead >= KNOTS[-1] or along <= none:
                    continue
                for k in range(places):
                    before, knot, after = KNOTS[k], KNOTS[k + 1], KNOTS[k + 2]
                    near = min((ahead - before) / (knot - before), (after - ahead) / (after - knot))
                    if near <= none:
                        continue
                    for w in range(len(WIDTHS)):
                        share, place = along * max(one - left / WIDTHS[w], none) * near, places * w + k
                        of[3 * place] += share * (speed[j] - speed[i])
                        if seen[j]:
                            of[3 * place + 1] += share * (speed[j] - earlier[j])
                            known[place] += share
                        of[3 * place + 2] += share
            for place in range(len(known)):
                of[3 * place] /= of[3 * place + 2] + some
                of[3 * place + 1] /= known[place] + some
                of[3 * place + 2] = min(of[3 * place + 2], one)
