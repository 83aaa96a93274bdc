"""Alignment of recorded tracks with the lanes of a net by a shift and a turn, and possible causes of a turn.

Iterated closest points, point to line: every position is matched with the lane that it is on or nearest to, and the
small rigid motion that brings the positions onto those centre lines is solved for by weighted least squares (Chen and
Medioni 1992); far matches count little. It starts from where the tracks are, and, where that does not bring nearly all
of them onto lanes, from the best of a grid of shifts and turns: the nearest lane of a track that is a few metres off is
the one beside its own. What the lanes do not determine, such as a shift along a straight road, stays 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd

from litsim_data.generic.geography import meridian_of
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.lane_map import LaneMap

POINTS, COARSE_POINTS = 1500, 250  # positions that are compared, and by which starts are chosen
ITERATIONS = 25
SCALES = (1.5, 0.6)  # [m] of the weights, from the first iteration to the last: farther matches count little
START_SHIFTS = np.arange(-9.6, 9.7, 1.2)  # [m] along x and y: a third of a lane apart
START_TURNS = np.deg2rad(np.arange(-3.0, 3.1, 0.75))
REACH = 1000.0  # [m] between tracks and net, beyond which they are not compared
STARTS = 6  # of these, the best, that are followed
NEAR = 1.0  # [m] from a centre line at which a position counts a third of one in the middle, for choosing starts
BETTER = 0.02  # share of the positions on lanes that another start must win to be preferred to no start at all
UNDETERMINED = 1e-3  # of the largest eigenvalue, below which a direction is not determined
FACING = math.radians(45.0)  # by which a vehicle on a lane may head elsewhere than the lane

IN_PLACE_M, IN_PLACE_RAD = 0.3, math.radians(0.1)  # largest motion that is not a misplacement but drivers' preference
FOUND_MIN = 0.5  # smallest share of positions on lanes with which tracks are on the net at all
GAIN_MIN = 0.01  # smallest share of positions that a reported motion brings onto lanes
CONVERGENCE_MAX = math.radians(3.6)  # of UTM, at the edge of a zone of 6 degrees, near the poles; more is another cause
CONVERGENCE_MATCH = math.radians(0.15)  # by which a turn may differ from the convergence that explains it


@dataclass(frozen=True)
class Alignment:
    """The motion of the tracks that brings them best onto the lanes: a turn about a centre, then a shift.

    Attributes:
        centre: (x, y) of the tracks, about which they turn [m].
        shift: (x, y) [m].
        turn: counter-clockwise [rad].
        before, after: share of the positions that are on a lane which leads where they head, without and with it.
        determined: whether the lanes determine all of it; on a straight road they do not say how far along it.
        net_centre: (x, y) of the middle of the net [m].
    """

    centre: tuple[float, float]
    shift: tuple[float, float]
    turn: float
    before: float
    after: float
    determined: bool
    net_centre: tuple[float, float]

    @property
    def lost(self) -> bool:
        """Whether most positions are on no lane even then: they belong farther away, or lanes are missing."""
        return max(self.before, self.after) < FOUND_MIN

    @property
    def in_place(self) -> bool:
        """Whether the tracks lie where they belong: the motion is small, or puts hardly more of them on lanes."""
        small = math.hypot(*self.shift) <= IN_PLACE_M and abs(self.turn) <= IN_PLACE_RAD
        return small or self.after < self.before + GAIN_MIN

    def apply(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns positions (n,) after the motion [m]."""
        return _moved(x, y, np.array([*self.shift, self.turn]), self.centre)

    def transform(self, yaw_deg: float = 0.0, x: float = 0.0, y: float = 0.0) -> tuple[float, float, float]:
        """Returns fields yaw_deg [degrees], x, y [m] of a mapping's transform that does this after what it does now.

        The angle is rounded, and x and y are those that go with it: in UTM, which is 6000 km wide, the angle that is
        written down moves positions by 100 m with its third decimal.
        """
        rounded = round(yaw_deg + math.degrees(self.turn), 3)
        turn = math.radians(rounded - yaw_deg)
        cos, sin = math.cos(turn), math.sin(turn)
        dx, dy = x - self.centre[0], y - self.centre[1]
        return (
            rounded,
            self.centre[0] + self.shift[0] + cos * dx - sin * dy,
            self.centre[1] + self.shift[1] + sin * dx + cos * dy,
        )


def align(lane_map: LaneMap, table: pd.DataFrame) -> Alignment:
    """Returns the best motion of the positions of a neutral `table` (x, y, yaw), at least one row."""
    rows = np.unique(np.linspace(0, len(table) - 1, min(POINTS, len(table))).astype(np.int64))
    x, y, yaw = (table[name].to_numpy(np.float64)[rows] for name in ("x", "y", "yaw"))
    centre = (float(x.mean()), float(y.mean()))
    points = np.concatenate([lane.centerline for lane in lane_map.lanes])
    low, high = points.min(axis=0), points.max(axis=0)
    net_centre = (float(0.5 * (low[0] + high[0])), float(0.5 * (low[1] + high[1])))
    away = np.maximum(np.maximum(low - [x.max(), y.max()], [x.min(), y.min()] - high), 0.0)
    if np.hypot(*away) > REACH:  # no motion of those below brings a track onto a lane
        return Alignment(centre, (0.0, 0.0), 0.0, 0.0, 0.0, determined=False, net_centre=net_centre)
    before = share_along(lane_map, x, y, yaw)
    best, determined = _descended(lane_map, (x, y, yaw), np.zeros(3), centre)
    after = share_along(lane_map, *_moved(x, y, best, centre), yaw + best[2])
    for start in _starts(lane_map, (x, y, yaw), centre) if after < 1.0 - BETTER else ():
        motion, complete = _descended(lane_map, (x, y, yaw), start, centre)
        share = share_along(lane_map, *_moved(x, y, motion, centre), yaw + motion[2])
        if share > after + BETTER:
            best, after, determined = motion, share, complete
    shift = (float(best[0]), float(best[1]))
    return Alignment(centre, shift, float(best[2]), before, after, determined, net_centre)


def grid_convergence(latitude: float, longitude: float) -> float:
    """Returns UTM's grid convergence [rad] at a place [degrees]: by how much grid north lies clockwise of true north.

    That of the transverse Mercator projection of a sphere, atan(tan(longitude - central meridian) sin(latitude)); the
    ellipsoid changes it by less than 0.01 degrees within a zone.
    """
    east = math.radians(longitude - meridian_of(latitude, longitude))
    return math.atan(math.tan(east) * math.sin(math.radians(latitude)))


def explained(turn: float, origin: tuple[float, float] | None) -> str:
    """Returns a possible cause of a `turn` of the tracks [rad] by the site's latitude and longitude [degrees]; else
    empty.

    Tracks in metres east and true north that are brought onto a net in UTM turn by the convergence, those in UTM on a
    net along true north by its opposite.
    """
    if not IN_PLACE_RAD < abs(turn) <= CONVERGENCE_MAX:
        return ""
    if origin is None:
        return (
            "a turn of this size is what UTM's grid convergence looks like, one of net and tracks being in UTM and the "
            "other along true north: --origin LAT LON of the site compares"
        )
    expected = grid_convergence(*origin)
    there = f"UTM's grid convergence at {origin[0]:g}, {origin[1]:g} is {math.degrees(expected):+.2f} degrees"
    if abs(turn - expected) <= CONVERGENCE_MATCH:
        return f"{there}: the net is in UTM, the tracks are along true north"
    if abs(turn + expected) <= CONVERGENCE_MATCH:
        return f"{there}: the tracks are in UTM, the net is along true north"
    return f"{there}, which does not explain the turn"


def _starts(
    lane_map: LaneMap, poses: tuple[FloatArray, FloatArray, FloatArray], centre: tuple[float, float]
) -> list[FloatArray]:
    """Returns shifts and turns (3,) of a grid that bring most positions near the middle of lanes, the best first."""
    every = max(1, len(poses[0]) // COARSE_POINTS)
    x, y, yaw = (values[::every] for values in poses)
    grid = np.array(list(product(START_SHIFTS, START_SHIFTS, START_TURNS)))
    grid = grid[np.argsort(np.abs(grid / [1.0, 1.0, 0.1]).sum(axis=1), kind="stable")]  # of equal ones, the smallest
    scores = np.empty(len(grid))
    for row, motion in enumerate(grid):
        now_x, now_y = _moved(x, y, motion, centre)
        distance, facing = _on_lanes(lane_map, now_x, now_y, yaw + motion[2])[:2]
        scores[row] = (np.exp(-((distance / NEAR) ** 2)) * facing).mean()
    return list(grid[np.argsort(-scores, kind="stable")[:STARTS]])


def _descended(
    lane_map: LaneMap,
    poses: tuple[FloatArray, FloatArray, FloatArray],
    start: FloatArray,
    centre: tuple[float, float],
) -> tuple[FloatArray, bool]:
    """Returns the shift and turn (3,) reached from `start`, and whether the lanes determine all three; others are 0."""
    x, y, yaw = poses
    radius = max(1.0, math.sqrt(float(((x - centre[0]) ** 2 + (y - centre[1]) ** 2).mean())))
    scaled = np.array([1.0, 1.0, radius])  # so that the turn, too, is in metres
    motion, usable = start.copy(), np.ones(3, np.bool_)
    for scale in np.geomspace(*SCALES, ITERATIONS):
        now_x, now_y = _moved(x, y, motion, centre)
        place = lane_map.nearest(now_x, now_y, yaw + motion[2])
        normal = np.column_stack([-np.sin(place.heading), np.cos(place.heading)])
        arm = np.column_stack([-(now_y - centre[1] - motion[1]), now_x - centre[0] - motion[0]])
        design = np.column_stack([normal, (normal * arm).sum(axis=1) / radius])
        weight = 1.0 / (1.0 + (place.d / scale) ** 2) ** 2  # Geman and McClure
        values, vectors = np.linalg.eigh(design.T @ (weight[:, None] * design))
        usable = values > UNDETERMINED * values[-1]
        towards = (vectors.T @ (design.T @ (weight * -place.d)))[usable] / values[usable]
        unchanged = vectors[:, usable] @ (vectors[:, usable].T @ (motion * scaled))
        motion = (unchanged + vectors[:, usable] @ towards) / scaled
    return motion, bool(usable.all())


def _on_lanes(
    lane_map: LaneMap, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> tuple[FloatArray, BoolArray, IntArray]:
    """Returns distances (n,) of poses to centre lines [m], whether these lead about the same way, and their lanes."""
    place = lane_map.nearest(x, y, yaw)
    foot_x, foot_y, _ = lane_map.pose_at(place.lane, place.s)
    return np.hypot(x - foot_x, y - foot_y), np.abs(wrap_angle(place.heading - yaw)) <= FACING, place.lane


def _moved(
    x: FloatArray, y: FloatArray, motion: FloatArray, centre: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Returns positions (n,) turned by motion[2] about `centre`, then shifted by motion[:2]."""
    cos, sin, dx, dy = math.cos(motion[2]), math.sin(motion[2]), x - centre[0], y - centre[1]
    return centre[0] + motion[0] + cos * dx - sin * dy, centre[1] + motion[1] + sin * dx + cos * dy


def share_along(lane_map: LaneMap, x: FloatArray, y: FloatArray, yaw: FloatArray) -> float:
    """Returns the share of poses (n,) on a lane that leads about where they head."""
    distance, facing, lane = _on_lanes(lane_map, x, y, yaw)
    half = 0.5 * np.array([lane_of_net.width for lane_of_net in lane_map.lanes])[lane]
    return float(((distance <= half) & facing).mean())
