"""Signal-controlled connections of a SUMO net, and their stop lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import BoolArray, FloatArray, IntArray
from litsim_sim.lane_map.net_lanes import UNREADABLE, Lane, read_net, unreadable_net

ARROW = " -> "  # between the lanes of a connection's name
BESIDE = 0.5  # [m] beyond the lane's edge at which a stop line still counts as crossed
FACING = np.cos(np.deg2rad(45.0))  # cosine between a vehicle and the lane whose stop line it crosses
PASSED = 1.0  # [m] beyond the stop line at which it is passed: drivers stop on it, and maps and tracks are that far off
STRAIGHT = "s"  # SUMO's letter for the direction of a connection that goes straight on
LEAVES = 300  # steps after the stop line within which a vehicle has passed the junction: one that turns may wait in it


@dataclass(frozen=True)
class SignalLink:
    """A connection between two lanes that a traffic light controls.

    Attributes:
        name: ``FROM_LANE -> TO_LANE``, by SUMO's ids; positions among a light's links change when a net is built anew.
        from_lane, to_lane: ids of the lanes.
        stop: (2,) middle of the stop line: where `from_lane` ends, frame map [m].
        heading: heading of `from_lane` there [rad].
        width: width of `from_lane` [m].
        exit: (2,) where `to_lane` begins [m].
        exit_heading: heading of `to_lane` there [rad].
        via: ids of the lanes inside the junction, in driving direction.
        light: id of the traffic light; empty where only the record of a run is known.
        index: position among its links, -1 likewise.
        junction: id of the junction; empty likewise.
        turns: whether it leads to the left, to the right or back, by SUMO's direction.
        foes: names of the controlled connections of the junction that it crosses or merges with, except those from its
            own edge, which a light does not tell apart.
    """

    name: str
    from_lane: str
    to_lane: str
    stop: FloatArray
    heading: float
    width: float
    exit: FloatArray
    exit_heading: float
    via: tuple[str, ...] = ()
    light: str = ""
    index: int = -1
    junction: str = ""
    turns: bool = False
    foes: tuple[str, ...] = ()

    @classmethod
    def between(cls, begin: Lane, end: Lane, **more: Any) -> SignalLink:
        """Returns the connection of two lanes, with `more` that is told of it beside their places."""
        return cls(
            name=f"{begin.id}{ARROW}{end.id}",
            from_lane=begin.id,
            to_lane=end.id,
            stop=begin.centerline[-1],
            heading=begin.headings[1],
            width=begin.width,
            exit=end.centerline[0],
            exit_heading=end.headings[0],
            **more,
        )


def read_links(path: Path, *, lights: bool = True) -> tuple[SignalLink, ...]:
    """Returns the connections of a net that cars may use and lights control, by name; empty where there are no lights.

    Without `lights` these are all connections, controlled or not.
    """
    net, every = read_net(path)
    lanes = {lane.id: lane for lane in every}
    try:
        controlled = [
            connection
            for edge in net.getEdges(withInternal=False)
            for lane in edge.getLanes()
            for connection in lane.getOutgoing()
            if (connection.getTLSID() or not lights)
            and lane.getID() in lanes
            and connection.getToLane().getID() in lanes
        ]
        by_junction: dict[str, list[Any]] = {}
        for connection in controlled:
            by_junction.setdefault(connection.getFrom().getToNode().getID(), []).append(connection)
        links = [
            _link(connection, lanes, tuple(_name(other) for other in same if _are_foes(connection, other)))
            for same in by_junction.values()
            for connection in same
        ]
    except UNREADABLE as error:
        raise unreadable_net(path, error) from error
    return tuple(sorted(links, key=lambda link: link.name))


def by_lane(links: Sequence[SignalLink]) -> list[list[int]]:
    """Returns the places in `links` of the connections from each lane, by the first of them."""
    places: dict[str, list[int]] = {}
    for place, link in enumerate(links):
        places.setdefault(link.from_lane, []).append(place)
    return [*places.values()]


def relation_id(name: str) -> int:
    """Returns the id of the Lanelet2 relation that stands for a controlled connection, by its name: 48 bits of a hash.

    Maps that LitSim writes have it, and the adapter of a stack that reads such a map publishes states under it.
    """
    return int.from_bytes(sha256(name.encode()).digest()[:6], "big")


def _are_foes(own: Any, other: Any) -> bool:
    """Returns whether their junction marks two connections of different edges as foes."""
    junction = own.getFrom().getToNode()
    try:
        foes = bool(junction.areFoes(junction.getLinkIndex(own), junction.getLinkIndex(other)))
    except (KeyError, IndexError):
        return False
    return foes and own.getFrom() is not other.getFrom()


def _name(connection: Any) -> str:
    return f"{connection.getFromLane().getID()}{ARROW}{connection.getToLane().getID()}"


def _link(connection: Any, lanes: dict[str, Lane], foes: tuple[str, ...]) -> SignalLink:
    begin, end = lanes[connection.getFromLane().getID()], lanes[connection.getToLane().getID()]
    via: list[str] = []
    following = connection.getViaLaneID()
    while following and following in lanes and lanes[following].is_internal and following not in via:
        via.append(following)  # a connection with a waiting place inside the junction has two lanes
        following = next(iter(lanes[following].successors), "")
    return SignalLink.between(
        begin,
        end,
        via=tuple(via),
        light=connection.getTLSID(),
        index=int(connection.getTLLinkIndex()),
        junction=connection.getFrom().getToNode().getID(),
        turns=connection.getDirection() != STRAIGHT,
        foes=foes,
    )


def stop_line_parts(links: Sequence[SignalLink]) -> FloatArray:
    """Returns (n, 2, 2) left and right end of each connection's part of its stop line, in frame map [m].

    The connections of a lane share its line from left to right, as they turn, with a little space between them.
    """
    parts = np.zeros((len(links), 2, 2))
    for link, ends in zip(links, parts, strict=True):
        of_lane = sorted(
            (other for other in links if other.from_lane == link.from_lane),
            key=lambda other: -wrap_angle(np.array(other.exit_heading - other.heading)),
        )
        place = [other.name for other in of_lane].index(link.name)
        left = np.array([-np.sin(link.heading), np.cos(link.heading)])
        for end, side in enumerate((0.05, 0.95)):
            ends[end] = link.stop + left * link.width * (0.5 - (place + side) / len(of_lane))
    return parts


@dataclass(frozen=True)
class Crossings:
    """Passages of stop lines; arrays (c,), sorted by agent and step.

    Attributes:
        agent: row of the agent.
        step: first step, counted from that of the arrays' first column, at which it is past the line.
        link: position of the connection among those asked about.
    """

    agent: IntArray
    step: IntArray
    link: IntArray


def crossings(
    links: Sequence[SignalLink], x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray, valid: BoolArray
) -> Crossings:
    """Finds the passages of the stop lines of `links` by boxes (n, steps), `valid` where they are on the road.

    A line is passed when the front centre gets `PASSED` beyond it, in the direction of the lane. Recorded vehicles
    that stand there rock back and forth: one passes the last time that it does so without being back at the line.
    The connection is determined after the junction; for a vehicle that is not seen there, by the exit that it came
    nearest to.
    """
    half = 0.5 * length[:, None]
    front_x, front_y = x + half * np.cos(yaw), y + half * np.sin(yaw)
    both = valid[:, :-1] & valid[:, 1:]
    passages: list[tuple[int, int, int]] = []
    for places in by_lane(links):
        line = links[places[0]]
        cos, sin = np.cos(line.heading), np.sin(line.heading)
        dx, dy = front_x - line.stop[0], front_y - line.stop[1]
        along, beside = cos * dx + sin * dy - PASSED, cos * dy - sin * dx
        passed = both & (along[:, :-1] < 0.0) & (along[:, 1:] >= 0.0)
        passed &= np.abs(beside[:, 1:]) <= 0.5 * line.width + BESIDE
        passed &= np.cos(yaw[:, 1:] - line.heading) >= FACING
        for agent, step in zip(*np.nonzero(passed), strict=True):
            again = np.flatnonzero(passed[agent, step + 1 :])
            if len(again) and (along[agent, step + 1 : step + 2 + again[0]] > -PASSED).all():
                continue
            after = slice(step + 1, step + 2 + LEAVES)
            present = valid[agent, after]
            x_after, y_after = front_x[agent, after][present], front_y[agent, after][present]
            nearest = [float(np.hypot(x_after - links[p].exit[0], y_after - links[p].exit[1]).min()) for p in places]
            passages.append((int(agent), int(step) + 1, places[int(np.argmin(nearest))]))
    ordered = np.array(sorted(passages), np.int64).reshape(-1, 3)
    return Crossings(ordered[:, 0], ordered[:, 1], ordered[:, 2])
