"""Headings and overlaps of boxes along forecast paths."""

from __future__ import annotations

import numpy as np

from litsim_predictor.inference.in_map import headings
from litsim_sim.core.geometry import overlapping_pairs
from litsim_sim.core.scene import BoolArray, FloatArray


def path_headings(path: FloatArray, yaw: FloatArray) -> FloatArray:
    """Returns headings (..., T) [rad] along `path` (..., T, 2) [m] from the origin, with heading `yaw` (...) there.

    They are computed like those that :class:`.predictor.LearnedPredictor` publishes.
    """
    flat = path.reshape(-1, *path.shape[-2:])
    return headings(flat, np.zeros((len(flat), 2)), yaw.reshape(-1)).reshape(path.shape[:-1])


def agents_that_overlap(
    x: FloatArray, y: FloatArray, yaw: FloatArray, size: tuple[FloatArray, FloatArray], valid: BoolArray
) -> BoolArray:
    """Returns a mask (B, N) of the agents whose box overlaps that of another agent of the same scene at any instant.

    Args:
        x, y, yaw: (B, N, T) box centres [m] and headings [rad] in the axes of the scene.
        size: lengths and widths (B, N) [m].
        known: (B, N, T) mask of the boxes that exist; the others overlap nothing.
    """
    scene, agent, instant = np.nonzero(valid)
    hit = np.zeros(valid.shape[:2], np.bool_)
    if not len(scene):
        return hit
    x, y, yaw = x[valid], y[valid], yaw[valid]
    length, width = size[0][scene, agent], size[1][scene, agent]
    # One search for all scenes and instants: each is moved far to the right of the one before.
    apart = np.ptp(x) + 2.0 * float(np.hypot(length, width).max())
    x = x - x.min() + apart * (scene * valid.shape[2] + instant)
    pairs = overlapping_pairs(x, y, yaw, length, width)
    hit[scene[pairs], agent[pairs]] = True
    return hit
