"""Ways of agents through junctions, and turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.mining.lane_tracks import NOWHERE, TURN_RAD, LaneTracks, runs, true_runs
from litsim_sim.scenario.log import Log

TURN_RATE = np.deg2rad(5.0)  # [rad/s] slower is a bend
RATE_SPAN = 5  # steps before and after, over which a yaw rate is taken
PAUSE = 5  # steps without turning that do not end a turn
STANDING = 1.0  # [m/s] whoever waits in the middle of a turn has not ended it
MARGIN = 10  # steps before and after a passage: the way there and away


@dataclass(frozen=True)
class Passage:
    """An agent goes through a junction from one road to another.

    Attributes:
        agent: row in the log.
        junction: SUMO's name of it.
        first, last: steps, both included, with its centre inside.
        from_lane, to_lane: before and after, as positions in the lane map.
        turned: change of heading over it and a second before and after, positive to the left [rad].
        heading: before it [rad].
    """

    agent: int
    junction: str
    first: int
    last: int
    from_lane: int
    to_lane: int
    turned: float
    heading: float

    @property
    def is_left_turn(self) -> bool:
        """Whether it turns to the left by more than 45 degrees."""
        return self.turned > TURN_RAD

    @property
    def is_straight(self) -> bool:
        """Whether it turns by 45 degrees at most."""
        return abs(self.turned) <= TURN_RAD


@dataclass(frozen=True)
class Turn:
    """An agent turns by more than 45 degrees, faster than 5 degrees a second.

    Attributes:
        agent: row in the log.
        begin, end: first and last step.
        angle: positive to the left [rad].
        lateral_acceleration: the greatest, speed times yaw rate [m/s2].
    """

    agent: int
    begin: int
    end: int
    angle: float
    lateral_acceleration: float


def passages(log: Log, tracks: LaneTracks, lane_map: LaneMap) -> list[Passage]:
    """The ways of all agents through junctions, by agent and time.

    Whoever begins or ends inside a junction is left out: from where, or where to, is not known. So is whoever comes
    back to the road that it came from: it waited at the border.
    """
    lanes = lane_map.lanes
    found = []
    for row in range(len(log.ids)):
        pieces = [(begin, end, int(tracks.lane[row, begin])) for begin, end in runs(tracks.lane[row])]
        roads = [each for each in pieces if each[2] != NOWHERE and not lanes[each[2]].is_internal]
        for (_, leaves, before), (enters, _, after) in pairwise(roads):
            inside = tracks.lane[row, leaves:enters]
            if lanes[before].edge_id == lanes[after].edge_id or not len(inside) or (inside == NOWHERE).any():
                continue
            junction = lanes[int(inside[0])].edge_id.removeprefix(":").rpartition("_")[0]
            first, last = max(leaves - MARGIN, int(log.first_step[row])), min(enters + MARGIN, int(log.last_step[row]))
            yaw = np.unwrap(log.yaw[row, first : last + 1])
            turned = float(yaw[-1] - yaw[0])
            found.append(Passage(row, junction, leaves, enters - 1, before, after, turned, float(log.yaw[row, leaves])))
    return found


def turns(log: Log) -> list[Turn]:
    """The turns of all agents, by agent and time; who waits in the middle of one does not end it."""
    found = []
    for row in range(len(log.ids)):
        first, last = int(log.first_step[row]), int(log.last_step[row])
        yaw = np.unwrap(log.yaw[row, first : last + 1])
        speed, at = log.speed[row, first : last + 1], np.arange(len(yaw))
        early, late = np.maximum(at - RATE_SPAN, 0), np.minimum(at + RATE_SPAN, len(at) - 1)
        rate = (yaw[late] - yaw[early]) / np.maximum((late - early) * STEP_S, STEP_S)
        for side in (1.0, -1.0):
            for begin, end in true_runs(_bridged(side * rate > TURN_RATE, speed < STANDING)):
                angle = float(yaw[end - 1] - yaw[begin])
                if side * angle > TURN_RAD:
                    most = float((speed * np.abs(rate))[begin:end].max())
                    found.append(Turn(row, first + begin, first + end - 1, angle, most))
    return sorted(found, key=lambda turn: (turn.agent, turn.begin))


def _bridged(turning: BoolArray, standing: BoolArray) -> BoolArray:
    """`turning` (k,) with its gaps closed that are short, or in which the agent stands."""
    closed = turning.copy()
    for begin, end in true_runs(~turning):
        inner = begin > 0 and end < len(turning)
        if inner and (end - begin <= PAUSE or int((~standing[begin:end]).sum()) <= PAUSE):
            closed[begin:end] = True
    return closed


def boxes(log: Log, row: int, first: int, last: int) -> FloatArray:
    """(k, 5) x, y, yaw, length and width of an agent from step `first` through `last`, at which it is on the road."""
    piece = slice(first, last + 1)
    size = np.broadcast_to([log.length[row], log.width[row]], (last + 1 - first, 2))
    return np.column_stack([log.x[row, piece], log.y[row, piece], log.yaw[row, piece], size])
