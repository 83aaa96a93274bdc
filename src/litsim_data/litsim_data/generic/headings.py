"""Headings of vehicles from the motion of one point of them, for tables that give none.

The rear axle of a vehicle goes where the vehicle points; a point ahead of it goes further to the inside of a bend: on a
radius of 12 m the front of a car by 17 degrees. Its way tells how the vehicle turns after it, as a trailer after its
hitch (a tractrix).
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from litsim_sim.core.scene import FloatArray, IntArray

SMOOTHED = 5  # frames to either side over which the direction of a track is taken
DIRECTION_MIN = 0.5  # [m] shortest displacement with a direction
CREEPING = 1.0  # [m] travel within a second below which a vehicle keeps its direction: noise would turn it
RUN_IN, RUN_IN_MIN = 2.0, 3.0  # levers, [m] of way by whose bend the heading at the beginning of a track is found
BEND_MAX = 0.9  # sine of the largest angle between heading and direction of motion there


def headings(vehicle: IntArray, x: FloatArray, y: FloatArray, lever: FloatArray) -> FloatArray:
    """Returns headings (n,) [rad] of vehicles that do not slip; held where they creep or stand.

    Args:
        vehicle: (n,) ids; rows of one vehicle are consecutive frames.
        x, y: (n,) positions of a point of the vehicle [m].
        lever: (n,) distance of this point ahead of the rear axle [m]; where it is 0, headings are directions of motion.
    """
    direction = direction_of_motion(vehicle, x, y, CREEPING)
    starts = np.flatnonzero(np.r_[True, vehicle[1:] != vehicle[:-1]])
    yaw = np.empty(len(vehicle))
    for first, end in zip(starts, np.r_[starts[1:], len(vehicle)], strict=True):
        rows = slice(first, end)
        along = _up_to_the_ends(np.unwrap(direction[rows]))
        has_lever = lever[first] > 0.0
        yaw[rows] = _drawn(along, _ways(x[rows], y[rows]), float(lever[first])) if has_lever else along
    return yaw


def direction_of_motion(vehicle: IntArray, x: FloatArray, y: FloatArray, least: float = DIRECTION_MIN) -> FloatArray:
    """Returns the heading [rad] (n,) from the way between half a second before and after.

    It is held where a vehicle stands, and 0 if it never moves.

    Args:
        vehicle: (n,) ids; rows of one vehicle are consecutive frames.
        x, y: (n,) [m].
        least: way [m] below which a vehicle stands.
    """
    index = np.arange(len(vehicle))
    begins = np.r_[True, vehicle[1:] != vehicle[:-1]]
    first, track = np.flatnonzero(begins), np.cumsum(begins) - 1
    last = np.r_[first[1:], len(vehicle)] - 1
    before, after = np.maximum(index - SMOOTHED, first[track]), np.minimum(index + SMOOTHED, last[track])
    dx, dy = x[after] - x[before], y[after] - y[before]
    moves = np.hypot(dx, dy) >= least
    yaw = pd.Series(np.where(moves, np.arctan2(dy, dx), np.nan))
    held = yaw.groupby(track).ffill().groupby(track).bfill().to_numpy()
    return np.nan_to_num(held)


def _up_to_the_ends(direction: FloatArray) -> FloatArray:
    """Returns directions of motion (k,) [rad] of a track at its rows, of those of the ways around the rows.

    At the ends of a track these ways reach to one side only, so that their directions are those in the middle of them:
    to the ends they are continued as they change over the second next to these.
    """
    index = np.arange(len(direction), dtype=np.float64)
    middle = 0.5 * (np.maximum(index - SMOOTHED, 0.0) + np.minimum(index + SMOOTHED, index[-1]))
    if middle[-1] - middle[0] < SMOOTHED:
        return direction
    continued, near = np.interp(index, middle, direction), min(2 * SMOOTHED, len(direction) - 1)
    for end, inner, beyond in ((0, near, index < middle[0]), (-1, -1 - near, index > middle[-1])):
        slope = (direction[inner] - direction[end]) / (middle[inner] - middle[end])
        continued[beyond] = direction[end] + slope * (index[beyond] - middle[end])
    return continued


def _ways(x: FloatArray, y: FloatArray) -> FloatArray:
    """Returns the way (k,) [m] from each row of a track to the next, by its speed over a second; 0 where it creeps."""
    index = np.arange(len(x))
    before, after = np.maximum(index - SMOOTHED, 0), np.minimum(index + SMOOTHED, len(x) - 1)
    way = np.hypot(x[after] - x[before], y[after] - y[before])
    return np.where(way < CREEPING, 0.0, way / np.maximum(after - before, 1))


def _drawn(direction: FloatArray, way: FloatArray, lever: float) -> FloatArray:
    """Returns headings (k,) [rad] of a vehicle whose point `lever` [m] ahead of the rear axle moves in `direction`
    (k,).

    From row to row the direction is taken as constant, its mean: then the tangent of half the angle between it and the
    heading falls by the factor exp(-way / lever).
    """
    gone = np.cumsum(way) - way
    run_in = int(np.searchsorted(gone, max(RUN_IN * lever, RUN_IN_MIN)))
    bend = (direction[run_in] - direction[0]) / gone[run_in] if run_in < len(way) else 0.0
    heading = float(direction[0]) - math.asin(min(max(lever * bend, -BEND_MAX), BEND_MAX))
    drawn = [heading]
    shares, middle = np.exp(-0.5 * (way[1:] + way[:-1]) / lever), 0.5 * (direction[1:] + direction[:-1])
    for share, towards in zip(shares.tolist(), middle.tolist(), strict=True):
        heading = towards + 2.0 * math.atan(share * math.tan(0.5 * (heading - towards)))
        drawn.append(heading)
    return np.array(drawn)
