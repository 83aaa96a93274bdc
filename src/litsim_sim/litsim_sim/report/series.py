"""What the page plots over time. Series are (frames,), one value a step of the run; NaN where there is nothing."""

from __future__ import annotations

import numpy as np

from litsim_sim.analysis.run import Run
from litsim_sim.geometry import to_body
from litsim_sim.report.tracks import Mode, Tracks
from litsim_sim.scene import AgentTable, Controller, FloatArray

TTC_MAX = 12.0  # [s] above which nobody is in a hurry
CLOSING_MIN = 0.1  # [m/s] below which a gap is not closing
ON_LOG = 0.005  # [m]
LEADER_MAX = 80.0  # [m] ahead, beyond which the road may have turned away


def speeds(tracks: Tracks, agent: int) -> FloatArray:
    """Speed of one agent [m/s]."""
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


def times_to_collision(run: Run, first: int, frames: int) -> tuple[FloatArray, FloatArray]:
    """Time to collision [s] with the leader: of the ego, and the smallest among agents off their logs.

    The leader is the nearest agent whose box reaches into the straight corridor ahead of the agent; both keep their
    speeds. NaN where there is no leader, the gap does not close, or the time exceeds TTC_MAX.
    """
    ego, others = np.full(frames, np.nan), np.full(frames, np.nan)
    for table in run.tables:
        driven = np.flatnonzero(table.off_log)
        if not len(driven):
            continue
        ttc = np.nan_to_num(_to_leader(table, driven), nan=np.inf)
        is_ego = table.controller[driven] == Controller.EGO
        at = table.step - first
        for series, values in ((ego, ttc[is_ego]), (others, ttc[~is_ego])):
            smallest = float(values.min(initial=np.inf))
            series[at] = smallest if smallest <= TTC_MAX else np.nan
    return ego, others


def counts(tracks: Tracks, mode: int) -> FloatArray:
    """Number of agents in a mode of :class:`litsim_sim.report.tracks.Mode`."""
    return np.asarray((tracks.mode == mode).sum(axis=0), np.float64)


def _to_leader(table: AgentTable, rows: np.ndarray) -> FloatArray:
    """(m,) time to collision of the agents at `rows` with their leaders [s]; NaN or infinite where there is none."""
    yaw, speed = table.yaw[rows, None], table.speed[rows, None]
    ahead, left = to_body(table.x[None] - table.x[rows, None], table.y[None] - table.y[rows, None], yaw)
    turned = table.yaw[None] - yaw
    cos, sin = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    half_length = 0.5 * (table.length * cos + table.width * sin + table.length[rows, None])
    half_width = 0.5 * (table.width * cos + table.length * sin + table.width[rows, None])
    leads = (np.abs(left) < half_width) & (ahead > 0.0) & (ahead < LEADER_MAX)
    leads[np.arange(len(rows)), rows] = False
    gap = np.where(leads, ahead - half_length, np.inf)
    nearest = np.argmin(gap, axis=1)
    each = np.arange(len(rows))
    closing = speed[:, 0] - table.speed[nearest] * np.cos(turned[each, nearest])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > CLOSING_MIN, np.maximum(gap[each, nearest], 0.0) / closing, np.nan)
