"""The lane graph: what every format of maps is read as, and what nets are built from.

A lanelet is a piece of one lane between a left and a right bound. A graph says which lanelets follow each other, which
lie side by side, which lie inside intersections, and which traffic lights hold at them. Its readers are the formats of
:mod:`.map_format`; :mod:`.net_builder` makes SUMO nets of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import shapely

from litsim_sim.core.errors import InputError
from litsim_sim.core.geometry import arc_lengths, shift_left, to_body, wrap_angle
from litsim_sim.core.scene import FloatArray

SPEED_LIMIT = 13.89  # [m/s] 50 km/h, where the map gives none
LANE_WIDTH = 3.5  # [m] of lanes of which only the centre line is known
SAMPLES_MIN = 8  # points of a centre line, at least
SAMPLE = 2.0  # [m] between them
NEAREST = 0.15  # [m] from those of its bounds, at least: netconvert drops points within 0.1 m
OPPOSED = 0.5  # [m] along the bounds within which their points lie opposite each other
REPEATED = 1e-3  # [m] between points of a line up to which one repeats the other
LONGEST = 100_000.0  # [m] of a lanelet
OPPOSITE = np.deg2rad(150.0)  # from which on two lanes lead opposite ways
SAME_LANE = 0.5  # [m] up to which the middles of two lanes that lead opposite ways are those of one lane
BESIDE = 8.0  # [m] at most, between the middles of two lanes that lead opposite ways on one road


TURNS = ("left", "straight", "right")


@dataclass(frozen=True)
class Lanelet:
    """A piece of lane.

    Attributes:
        id: unique.
        left, right: (k, 2), (l, 2) bounds in driving direction [m]; (k, 3), (l, 3) where heights are known.
        successors: ids of those that begin where this one ends; unknown ids are ignored.
        left_id, right_id: ids of neighbours in the same direction; those in the other direction are ignored.
        speed_limit: [m/s].
        lights: names of the traffic lights that hold at its end, or at its beginning if it lies inside an intersection.
        junction: whether the map says that it lies inside an intersection.
        predecessors: ids of those that end where this one begins, for formats that name them here alone.
    """

    id: str
    left: FloatArray
    right: FloatArray
    successors: tuple[str, ...] = ()
    left_id: str | None = None
    right_id: str | None = None
    speed_limit: float = SPEED_LIMIT
    lights: tuple[str, ...] = ()
    junction: bool = False
    predecessors: tuple[str, ...] = ()

    @cached_property
    def _sides(self) -> tuple[FloatArray, FloatArray]:
        """Both bounds at the same shares of their length (m, 2) or (m, 3), at those of their points as well.

        Bounds whose points lie opposite each other, as of lanes of constant width, are followed point by point.
        """
        length = max(_length(self.left), _length(self.right))
        left, right = (_distances(side) / _length(side) for side in (self.left, self.right))
        if len(left) == len(right) and np.abs(left - right).max() * length < OPPOSED:
            left = right = 0.5 * (left + right)
        even = np.linspace(0.0, 1.0, max(SAMPLES_MIN, int(np.ceil(length / SAMPLE)) + 1))
        own = np.unique(np.concatenate([left, right]))
        own = own[np.diff(own, prepend=-1.0) * length > REPEATED]  # points opposite each other, but for rounding
        own[-1] = 1.0
        apart = np.abs(even[:, None] - own).min(axis=1) * length
        share = np.union1d(own, even[apart > NEAREST])
        return _interpolated(self.left, left, share), _interpolated(self.right, right, share)

    @cached_property
    def _middle(self) -> FloatArray:
        left, right = self._sides
        axes = min(left.shape[1], right.shape[1])
        return 0.5 * (left[:, :axes] + right[:, :axes])

    @property
    def centerline(self) -> FloatArray:
        """The points (m, 2) [m] midway between the bounds."""
        return self._middle[:, :2]

    @property
    def heights(self) -> FloatArray:
        """Heights (m,) [m] of the points of the centre line; 0 where unknown."""
        return self._middle[:, 2] if self._middle.shape[1] == 3 else np.zeros(len(self._middle))

    def ends(self, index: int) -> FloatArray:
        """Returns the points (2, 2) [m] of the left and right bound at the start (`index` 0) or the end (-1)."""
        return np.stack([self.left[index, :2], self.right[index, :2]])

    @cached_property
    def width(self) -> float:
        """Median distance between the bounds [m]."""
        left, right = self._sides
        return float(np.median(np.hypot(*(left - right)[:, :2].T)))

    @cached_property
    def length(self) -> float:
        """Length of the centre line [m]."""
        return _length(self.centerline)

    def height_at(self, point: shapely.Point) -> float:
        """Returns the height [m] of the centre line where it is nearest to `point`."""
        s = shapely.LineString(self.centerline).project(point)
        return float(np.interp(s, _distances(self.centerline), self.heights))

    def course(self, index: int) -> float:
        """Returns the direction [rad] of the centre line between point `index` and the next."""
        return float(np.arctan2(*np.diff(self.centerline, axis=0)[index][::-1]))


@dataclass(frozen=True)
class LaneGraph:
    """The lanes of a map.

    Attributes:
        lanelets: all of them.
        left_hand: whether traffic keeps to the left; None: where most lanes have their oncoming lane to the right.
        notes: sentences about parts of the map that were not used, or were read otherwise than written.
        turns: those of TURNS that a traffic light is for, by its name; a light that is not named here is for all.
    """

    lanelets: tuple[Lanelet, ...]
    left_hand: bool | None = None
    notes: tuple[str, ...] = ()
    turns: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def by_id(self) -> dict[str, Lanelet]:
        """The lanelets by their ids, each with all of its successors, and with neighbours that lead the same way.

        Raises:
            InputError: there are none, or one is longer than any road.
        """
        by_id = {lanelet.id: lanelet for lanelet in self.lanelets}
        if not by_id:
            raise InputError("the map holds no lanelets")
        after = {name: [*lanelet.successors] for name, lanelet in by_id.items()}
        for name, lanelet in by_id.items():
            reach = float(np.ptp(np.concatenate([lanelet.left[:, :2], lanelet.right[:, :2]]), axis=0).max())
            if reach > LONGEST:
                raise InputError(f"lanelet {name} is {reach / 1e3:.6g} km long, expected at most {LONGEST / 1e3:g}")
            for other in lanelet.predecessors:
                after.get(other, []).append(name)
        return {
            name: replace(
                lanelet,
                successors=tuple(other for other in dict.fromkeys(after[name]) if other in by_id and other != name),
                left_id=_along(lanelet, by_id.get(lanelet.left_id or "")),
                right_id=_along(lanelet, by_id.get(lanelet.right_id or "")),
            )
            for name, lanelet in by_id.items()
        }

    @cached_property
    def keeps_left(self) -> bool:
        """Whether traffic keeps to the left: as the map says, or as most of its oncoming lanes lie."""
        if self.left_hand is not None:
            return self.left_hand
        outer = [lanelet for lanelet in self.lanelets if not lanelet.junction]
        middles = np.array([at_shares(lanelet.centerline, np.array([0.5]))[0] for lanelet in outer]).reshape(-1, 2)
        courses = np.array([lanelet.course(len(lanelet.centerline) // 2 - 1) for lanelet in outer])
        votes = 0
        for middle, course, lanelet in zip(middles, courses, outer, strict=True):
            away = middles - middle
            ahead, left = to_body(away[:, 0], away[:, 1], course)
            oncoming = np.abs(wrap_angle(courses - course)) > OPPOSITE
            beside = (np.abs(left) > SAME_LANE) & (np.abs(left) < BESIDE)
            oncoming &= (np.abs(ahead) < 0.5 * lanelet.length) & beside
            if oncoming.any():
                nearest = np.flatnonzero(oncoming)[int(np.abs(left[oncoming]).argmin())]
                votes += 1 if left[nearest] > 0.0 else -1
        return votes < 0


def around(line: FloatArray, width: float | FloatArray = LANE_WIDTH) -> tuple[FloatArray, FloatArray]:
    """Returns the left and the right bound (k, 2) or (k, 3) [m] of a lane of `width` [m] by its centre line."""
    sides = (shift_left(line[:, :2], 0.5 * side * np.asarray(width)) for side in (1, -1))
    left, right = (np.column_stack([side, line[:, 2:]]) for side in sides)
    return left, right


def at_shares(line: FloatArray, share: FloatArray) -> FloatArray:
    """Returns points (m, 2) or (m, 3) of a polyline at shares (m,) of its length in the plane."""
    return _interpolated(line, _distances(line), share * _length(line))


def extended(line: FloatArray, reach: float, segments: int = 1) -> FloatArray:
    """Returns `line` (k, 2), lengthened at both ends by `reach` [m], straight on as its outermost `segments` lead."""
    back = min(segments, len(line) - 1)
    head, tail = line[0] - line[back], line[-1] - line[-1 - back]
    before, after = (end + reach * way / np.hypot(*way) for end, way in ((line[0], head), (line[-1], tail)))
    return np.vstack([before, line, after])


def polyline(points: Sequence[Sequence[float]], what: str) -> FloatArray:
    """Returns points of a file as an array (k, 2) or (k, 3), without those that repeat the one before.

    Raises:
        ValueError: there are less than two, or some are not finite; `what` names them.
    """
    line = np.array(points, np.float64)
    if line.ndim != 2 or not np.isfinite(line).all():
        raise ValueError(f"{what} has {len(points)} points, expected at least 2 with finite x and y")
    line = without_repeats(line)
    if len(line) < 2:
        raise ValueError(f"{what} has {len(line)} points, expected at least 2 with finite x and y")
    return line


def without_repeats(line: FloatArray) -> FloatArray:
    """Returns a line (k, 2) or (k, 3) without the points that repeat the one before."""
    return line[np.concatenate([[True], np.hypot(*np.diff(line[:, :2], axis=0).T) > REPEATED])]


def turn_of(line: FloatArray, least: float) -> str:
    """Returns which of TURNS a line (k, 2) takes, by how it turns from its beginning to its end; see :func:`turn`."""
    begin, end = np.arctan2(*np.diff(line, axis=0)[[0, -1]].T[::-1])
    return turn(end - begin, least)


def turn(angle: float, least: float) -> str:
    """Returns which of TURNS a change of heading is, which is one from `least` on [rad]."""
    turned = float(wrap_angle(np.array(angle)))
    return "straight" if abs(turned) < least else "left" if turned > 0.0 else "right"


def _along(lanelet: Lanelet, other: Lanelet | None) -> str | None:
    """Returns the id of a neighbour that leads the same way as `lanelet`, else None."""
    if other is None:
        return None
    there, here = (way.centerline[-1] - way.centerline[0] for way in (other, lanelet))
    return other.id if float(there @ here) > 0.0 else None


def _interpolated(line: FloatArray, lengths: FloatArray, wanted: FloatArray) -> FloatArray:
    """Returns points (m, 2) or (m, 3) of a polyline whose own points lie `lengths` (k,), where `wanted` (m,)."""
    return np.column_stack([np.interp(wanted, lengths, values) for values in line.T])


def _distances(line: FloatArray) -> FloatArray:
    """Returns distances (k,) [m] along a line from its beginning to its points."""
    return arc_lengths(line[:, :2])


def _length(line: FloatArray) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())
