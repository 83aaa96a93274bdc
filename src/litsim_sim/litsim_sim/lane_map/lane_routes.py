"""Ways over the lanes of a net, with lane changes where no lane leads there by itself."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from heapq import heappop, heappush

import numpy as np

from litsim_sim.core.scene import FloatArray
from litsim_sim.lane_map.lane_map import LaneMap

CHANGE_M = 50.0  # [m] length of a lane change, and what one costs in metres of way
SPACING = 2.0  # [m] between the points of a lane change


def shortest_way(
    lane_map: LaneMap, start: int, targets: Collection[int], edges: Collection[str] | None = None
) -> list[int]:
    """Returns the positions of the lanes from `start` to the nearest of `targets`; empty if no way leads there.

    A lane is followed by a successor, or by its neighbour in a lane change. Outside junctions only lanes of `edges`
    count, if given.
    """
    before: dict[int, int] = {}
    queue, done = [(0.0, start, start)], set[int]()
    while queue:
        cost, lane, origin = heappop(queue)
        if lane in done:
            continue
        done.add(lane)
        before[lane] = origin
        if lane in targets:
            way = [lane]
            while way[-1] != start:
                way.append(before[way[-1]])
            return way[::-1]
        for following, more in _onward(lane_map, lane):
            allowed = edges is None or lane_map.lanes[following].is_internal
            if allowed or lane_map.lanes[following].edge_id in (edges or ()):
                heappush(queue, (cost + more, following, lane))
    return []


def _onward(lane_map: LaneMap, lane: int) -> Iterator[tuple[int, float]]:
    """Yields the lanes that may follow a lane, both by position, and what getting there costs [m]."""
    here = lane_map.lanes[lane]
    yield from ((lane_map.row(name), here.length) for name in here.successors)
    yield from ((lane_map.row(name), CHANGE_M) for name in (here.left, here.right) if name is not None)


def points_along(lane_map: LaneMap, way: Sequence[int], s: float, keep: float) -> FloatArray:
    """Returns points (m, 2) along `way`, positions of lanes, from `s` [m] on the first to the end of the last.

    A lane change takes CHANGE_M, or what the edge leaves for it. It begins `keep` [m] after the first point, or earlier
    where it would not be over before the end of the edge.
    """
    points = []
    for first, last in _edges_of(lane_map, way):
        here, other = lane_map.lanes[first], lane_map.lanes[last]
        length = here.length - s
        if first == last:
            start = np.stack(lane_map.pose_at(first, s)[:2], axis=-1)[None]
            points += [start, here.centerline[here.s > s]]
        else:
            change = min(CHANGE_M * (abs(here.index - other.index) or 1), length)
            along = np.linspace(0.0, length, max(2, int(length / SPACING) + 1))
            share = np.clip((along - np.clip(keep, 0.0, length - change)) / max(change, SPACING), 0.0, 1.0)
            share = (share**2 * (3.0 - 2.0 * share))[:, None]
            from_, to = (
                np.stack(lane_map.pose_at(row, (s + along) * lane_map.lanes[row].length / here.length)[:2], axis=-1)
                for row in (first, last)
            )
            points.append((1.0 - share) * from_ + share * to)
        keep, s = keep - length, 0.0
    return np.concatenate(points)


def _edges_of(lane_map: LaneMap, way: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yields the first and the last lane of `way` on each edge that it passes."""
    first = way[0]
    for lane, following in zip(way, [*way[1:], None], strict=True):
        if following is None or lane_map.lanes[following].id in lane_map.lanes[lane].successors:
            yield first, lane
            first = lane if following is None else following
