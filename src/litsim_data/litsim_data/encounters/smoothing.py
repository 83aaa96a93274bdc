"""Smoothing of recorded motion: what could be seen at each step, and what truly happened."""

from __future__ import annotations

import numpy as np
from scipy.signal import savgol_filter

from litsim_sim.core.scene import STEP_S, FloatArray

FIT_TIME = 0.8  # [s] in which weights of a trailing fit fall by e; 0.2 s of lag, half of NGSIM's swing is left
FIT_SAMPLES = 41  # of a trailing fit; earlier ones weigh less than 1 %
CENTRED_SAMPLES = 15  # of a centred fit, which is a parabola
GAIN = 1.0  # [1/s] at which a drivable motion returns to the recorded positions


def trailing_fit(values: FloatArray) -> FloatArray:
    """Returns at each step the end of the line through all `values` (T,) up to there, of which later ones weigh more.

    Weights fall by e within :data:`FIT_TIME` (Brown's double exponential smoothing): a steady change has no lag.
    """
    back = np.arange(min(FIT_SAMPLES, len(values)))
    weight = np.exp(-back * STEP_S / FIT_TIME)

    def moment(power: int, of: FloatArray) -> FloatArray:
        return np.convolve(of, weight * back**power)[: len(values)]

    once = np.ones(len(values))
    count, time, square = (moment(power, once) for power in range(3))
    spread = count * square - time**2
    ends = square * moment(0, values) - time * moment(1, values)
    return np.divide(ends, spread, out=values.astype(np.float64), where=spread > 0.0)


def centred_place(position: FloatArray) -> FloatArray:
    """Returns positions (T,) [m] by parabolas around each step, which look ahead."""
    return np.asarray(savgol_filter(position, CENTRED_SAMPLES, 2))


def centred_speed(position: FloatArray) -> FloatArray:
    """Returns the speeds (T,) [m/s] of the same parabolas; not below 0."""
    return np.maximum(savgol_filter(position, CENTRED_SAMPLES, 2, deriv=1, delta=STEP_S), 0.0)


def drivable(position: FloatArray, speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns a motion near `position` (T,) [m] and `speed` (T,) [m/s] in which the one is the integral of the other.

    It looks at no later sample, and does not reverse.
    """
    place, pace = np.array(position, np.float64), np.array(speed, np.float64)
    for step in range(1, len(place)):
        pace[step] = max(speed[step] + GAIN * (position[step - 1] - place[step - 1]), 0.0)
        place[step] = place[step - 1] + 0.5 * STEP_S * (pace[step - 1] + pace[step])
    return place, pace
