"""Cubic Bezier curves between poses, tangent to both, and their curvature."""

from __future__ import annotations

import numpy as np

from litsim_sim.core.scene import FloatArray

HANDLE = 1.0 / 3.0  # length of a handle relative to the chord, between poses with equal headings
LOOKS = np.linspace(0.0, 1.0, 33)[:, None]  # parameters at which the curvature is looked at


def between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Control points (4, 2) of the cubic from pose `start` to pose `end` ((3,) x, y [m], yaw [rad]), tangent to both.

    The handles are a third of the chord without a turn. With a turn by the angle a, they are those that approximate a
    circular arc: 4/3 tan(a/4) of its radius.
    """
    chord = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    turned = abs(float((end[2] - start[2] + np.pi) % (2.0 * np.pi) - np.pi))
    # chord = 2 r sin(a/2), handle = 4/3 r tan(a/4), so handle/chord = 2/3 tan(a/4)/sin(a/2), which is 1/3 at a = 0
    share = HANDLE if turned < 1e-3 else 2.0 / 3.0 * np.tan(turned / 4.0) / np.sin(turned / 2.0)
    handle = float(share) * chord
    leave = handle * np.array([np.cos(start[2]), np.sin(start[2])])
    arrive = handle * np.array([np.cos(end[2]), np.sin(end[2])])
    return np.array([start[:2], start[:2] + leave, end[:2] - arrive, end[:2]])


def points(control: FloatArray, spacing: float) -> FloatArray:
    """Returns points (m, 2) of the cubic with control points `control` (4, 2), at most about `spacing` [m] apart.

    The first and the last point are exactly the first and the last control point.
    """
    length = float(np.hypot(*np.diff(control, axis=0).T).sum())
    t = np.linspace(0.0, 1.0, max(2, int(np.ceil(length / spacing)) + 1))[:, None]
    p0, p1, p2, p3 = control
    curve = (1 - t) ** 3 * p0 + 3 * t * (1 - t) ** 2 * p1 + 3 * t**2 * (1 - t) * p2 + t**3 * p3
    curve[0], curve[-1] = p0, p3
    return curve


def curvature_max(control: FloatArray) -> float:
    """Returns the largest absolute curvature [1/m] at 33 parameters of the cubic; infinite at a cusp."""
    t = LOOKS
    a, b, c = control[1:] - control[:-1]
    first = 3 * ((1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c)
    second = 6 * ((1 - t) * (b - a) + t * (c - b))
    speed = np.hypot(first[:, 0], first[:, 1])
    if (speed < 1e-9).any():
        return float("inf")
    return float((np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3).max())
