"""Series that the page plots over time: (frames,), one value per step of the run; NaN for none."""

from __future__ import annotations

import numpy as np

from litsim_data.surrogates.safety import following
from litsim_eval.report.tracks import Tracks
from litsim_sim.core.colours import Mode
from litsim_sim.core.scene import Controller, FloatArray
from litsim_sim.record.run import Run

TTC_MAX = 12.0  # [s] largest time to collision that is plotted
ON_LOG = 0.005  # [m]


def speeds(tracks: Tracks, agent: int) -> FloatArray:
    """Speed of `agent` at every step (frames,) [m/s]."""
    row = tracks.row(agent)
    return np.full(tracks.frames, np.nan) if row < 0 else np.where(tracks.present[row], tracks.speed[row], np.nan)


def deviations(tracks: Tracks, logged: Tracks) -> FloatArray:
    """(agents of `logged`, frames) distance of each from its log [m]; NaN while it follows its log exactly."""
    out = np.full(logged.present.shape, np.nan)
    for i, agent in enumerate(logged.id.tolist()):
        j = tracks.row(agent)
        if j >= 0:
            far = np.hypot(tracks.x[j] - logged.x[i], tracks.y[j] - logged.y[i])
            apart = (far > ON_LOG) | (tracks.mode[j] != Mode.LOG)
            out[i] = np.where(tracks.present[j] & logged.present[i] & apart, far, np.nan)
    return out


def times_to_leader(run: Run, first: int, frames: int) -> tuple[FloatArray, FloatArray]:
    """Time to collision [s] with the leader: of the ego, and the smallest among agents off their logs.

    The leader is that of :func:`litsim_data.surrogates.safety.following`; both keep their speeds. NaN where there is no
    leader, the gap does not close, or the time exceeds TTC_MAX.
    """
    ego, others = np.full(frames, np.nan), np.full(frames, np.nan)
    for table in run.tables:
        driven = np.flatnonzero(table.off_log)
        if not len(driven):
            continue
        ttc = following(table, driven).time_to_leader
        is_ego = table.controller[driven] == Controller.EGO
        at = table.step - first
        for series, values in ((ego, ttc[is_ego]), (others, ttc[~is_ego])):
            smallest = float(values.min(initial=np.inf))
            series[at] = smallest if smallest <= TTC_MAX else np.nan
    return ego, others


def counts(tracks: Tracks, mode: int) -> FloatArray:
    """Number of agents in a mode of :class:`litsim_sim.core.colours.Mode`."""
    return np.asarray((tracks.mode == mode).sum(axis=0), np.float64)
