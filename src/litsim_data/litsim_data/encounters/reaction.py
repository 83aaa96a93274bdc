"""What a vehicle did in an encounter, in figures: the same for people's records and for simulated agents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from litsim_data.surrogates.safety import times_to_collision
from litsim_sim.core.geometry import box_corners, boxes_overlap
from litsim_sim.core.scene import STEP_S, AgentTable, Controller, FloatArray, Kind
from litsim_sim.scenario.encounter_note import EncounterKind, Track

REACTED = 0.5  # [m/s] of speed lost from which on a vehicle has reacted
BRAKING_STEPS = 5  # over which an acceleration is measured: 0.5 s
CLOSING_MIN = 0.1  # [m/s] closing speed of an approach
TTC_MAX = 99.0  # [s] that stands for no approach
POSITION_AFTER = 50  # steps from the onset to the position that is compared: 5 s
SAME_LANE = 2.0  # [m] from the path of the opponent within which it goes on with the agent's
FAR = 200.0  # [m] by which paths go straight on
BY_BOXES: tuple[EncounterKind, ...] = ("crossing", "turning")
"""Kinds in which paths cross: there is no gap along a path, but a distance between boxes."""


@dataclass(frozen=True)
class Reaction:
    """What an agent did from the onset of an encounter on.

    Attributes:
        onset: time from the onset until it is 0.5 m/s slower than at the onset [s]; NaN if it never is.
        strongest_braking: least mean acceleration over 0.5 s [m/s2].
        speed_lost: speed at the onset minus the least speed [m/s].
        least_gap: least distance to the opponent's rear along the agent's path while the opponent is on it, or of their
            boxes if their paths cross [m]; inf if the opponent is never on it.
        least_ttc: least time to collision [s], at most 99: gap by closing speed, or if their paths cross the time
            until the boxes overlap at constant velocities.
        position: (2,) box centre 5 s after the onset [m]; NaN if it is not known.
        contact: whether the boxes overlap.
    """

    onset: float
    strongest_braking: float
    speed_lost: float
    least_gap: float
    least_ttc: float
    position: FloatArray
    contact: bool


def reaction(
    kind: EncounterKind,
    agent: Track,
    opponent: Track,
    onset_step: int,
    agent_size: tuple[float, float],
    opponent_size: tuple[float, float],
) -> Reaction:
    """Returns what `agent` did while `opponent` did what makes an encounter of this `kind`.

    Both tracks begin at the same step; sizes are lengths and widths of boxes [m].
    """
    end = min(len(agent), len(opponent))
    a, b = (track.part(onset_step, end) for track in (agent, opponent))
    speed = a.speed
    slower = np.flatnonzero(speed < speed[0] - REACTED)
    mean_acceleration = (speed[BRAKING_STEPS:] - speed[:-BRAKING_STEPS]) / (BRAKING_STEPS * STEP_S)
    gaps = box_gaps if kind in BY_BOXES else path_gaps
    gap, ttc = gaps(a, b, agent_size, opponent_size)
    is_long = len(a) > POSITION_AFTER
    overlap = boxes_overlap(b.x - a.x, b.y - a.y, a.yaw, b.yaw, _arrays(agent_size), _arrays(opponent_size))
    return Reaction(
        onset=float(slower[0]) * STEP_S if len(slower) else np.nan,
        strongest_braking=float(mean_acceleration.min(initial=np.inf)),
        speed_lost=float(speed[0] - speed.min()),
        least_gap=float(gap.min()),
        least_ttc=min(float(ttc.min()), TTC_MAX),
        position=np.array([a.x[POSITION_AFTER], a.y[POSITION_AFTER]]) if is_long else np.full(2, np.nan),
        contact=bool(overlap.any()),
    )


def path_gaps(
    a: Track, b: Track, a_size: tuple[float, float], b_size: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Returns the gap (T,) [m] from the front of `a` to the rear of `b` along the path of `a`, and the times to
    collision (T,) [s]; inf while `b` is not ahead on that path, and where the gap does not close.
    """
    path = shapely.LineString(_path(a, b))
    own, other = (shapely.points(track.x, track.y) for track in (a, b))
    ahead = shapely.line_locate_point(path, other) - shapely.line_locate_point(path, own)
    on_path = (ahead > 0.0) & (shapely.distance(path, other) < 0.5 * (a_size[1] + b_size[1]))
    gap = np.where(on_path, ahead - 0.5 * (a_size[0] + b_size[0]), np.inf)
    closing = a.speed - b.speed * np.cos(b.yaw - a.yaw)
    approach = on_path & (closing > CLOSING_MIN)
    return gap, np.divide(np.maximum(gap, 0.0), closing, out=np.full(len(gap), np.inf), where=approach)


def box_gaps(
    a: Track, b: Track, a_size: tuple[float, float], b_size: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Returns distances (T,) [m] between the boxes of `a` and `b`, and the times (T,) [s] until they overlap at
    constant velocities; inf beyond the horizon of :func:`times_to_collision`.
    """
    corners = (box_corners(t.x, t.y, t.yaw, *_arrays(size)) for t, size in ((a, a_size), (b, b_size)))
    distance = shapely.distance(*(shapely.polygons(corner) for corner in corners))
    rows = np.arange(2 * len(a))
    both = {name: np.column_stack([getattr(a, name), getattr(b, name)]).ravel() for name in ("x", "y", "yaw", "speed")}
    table = AgentTable(
        step=0,
        id=rows,
        scene=rows // 2,  # a scene a step
        kind=np.full(len(rows), Kind.UNKNOWN, np.uint8),
        controller=np.full(len(rows), Controller.LOG, np.uint8),
        acceleration=np.zeros(len(rows)),
        yaw_rate=np.zeros(len(rows)),
        length=np.tile([a_size[0], b_size[0]], len(a)),
        width=np.tile([a_size[1], b_size[1]], len(a)),
        **both,
    )
    return distance, times_to_collision(table, rows[::2])


def _arrays(size: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    return np.asarray(size[0], np.float64), np.asarray(size[1], np.float64)


def _path(a: Track, b: Track) -> FloatArray:
    """Returns the points (m, 2) [m] that `a` passes, then those that `b` passes from there on, then straight on."""
    points, last = np.column_stack([a.x, a.y]), a
    apart = np.hypot(b.x - a.x[-1], b.y - a.y[-1])
    nearest = int(apart.argmin())
    if apart[nearest] < SAME_LANE and nearest + 1 < len(b):
        points, last = np.concatenate([points, np.column_stack([b.x, b.y])[nearest + 1 :]]), b
    onward = FAR * np.array([np.cos(last.yaw[-1]), np.sin(last.yaw[-1])])
    return np.concatenate([points, points[-1:] + onward])
