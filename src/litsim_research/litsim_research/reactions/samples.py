"""Samples of car following: the situation of a follower, and by how much it changes its speed within a second."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from litsim_data.encounters.following import FollowingTrack
from litsim_policy.conflict.likelihood import LOOK, SMOOTHING
from litsim_policy.motion.habits import GAP_MAX, PRIOR, SPEED_MIN, STRIDE, WINDOW
from litsim_policy.motion.log_leaders import BACK
from litsim_policy.motion.speed_change import USUAL_HEADWAY, features_of
from litsim_sim.core.scene import STEP_S, FloatArray, IntArray

CHANGE_MAX = 6.0  # [m/s] within a second: larger changes are errors of the recording


@dataclass(frozen=True)
class Samples:
    """n samples.

    Attributes:
        features: (n, INPUTS) of :mod:`litsim_policy.motion.speed_change`.
        change: (n,) of the speed within the next second [m/s].
    """

    features: FloatArray
    change: FloatArray

    def __len__(self) -> int:
        return len(self.change)


def samples_of(tracks: Iterable[FollowingTrack]) -> Samples:
    """Returns the samples of `tracks`, every STRIDE steps."""
    parts = [_of_track(track) for track in tracks]
    return Samples(np.concatenate([part.features for part in parts]), np.concatenate([part.change for part in parts]))


def _of_track(track: FollowingTrack) -> Samples:
    """Returns the samples of one track, by the estimators with which logs are judged."""
    speed, leader = smoothed(track.speed), track.leader_speed
    moments = np.arange(BACK, len(track) - LOOK, STRIDE)
    change = speed[moments + LOOK] - speed[moments]
    acceleration = (leader[moments] - leader[moments - BACK]) / (BACK * STEP_S)
    headway = usual_headways(track, moments)
    features = features_of(speed[moments], track.gap[moments], speed[moments] - leader[moments], acceleration, headway)
    plausible = np.abs(change) < CHANGE_MAX
    return Samples(features[plausible], change[plausible])


def smoothed(speed: FloatArray) -> FloatArray:
    """Returns means (T,) over SMOOTHING steps before and after; beyond the ends, the first and last speed count."""
    width = 2 * SMOOTHING + 1
    return np.convolve(np.pad(speed, SMOOTHING, mode="edge"), np.full(width, 1.0 / width), "valid")


def usual_headways(track: FollowingTrack, moments: IntArray) -> FloatArray:
    """Returns the usual headways [s] of the follower by the steps `at`; see :mod:`litsim_policy.motion.habits`."""
    counts = (track.gap < GAP_MAX) & (track.speed >= SPEED_MIN)
    headway = np.where(counts, track.gap / np.maximum(track.speed, SPEED_MIN), 0.0)
    back = moments[:, None] - np.arange(0, WINDOW + 1, STRIDE)
    there = back >= 0
    total = np.where(there, headway[np.maximum(back, 0)], 0.0).sum(axis=1)
    number = (there & counts[np.maximum(back, 0)]).sum(axis=1)
    return (USUAL_HEADWAY * PRIOR + total) / (PRIOR + number)
