"""Passages of agents through junctions, and turns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from litsim_data.mining.lane_tracks import NOWHERE, TURN_RAD, LaneTracks, runs, true_runs
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log

TURN_RATE = np.deg2rad(5.0)  # [rad/s] smallest yaw rate of a turn; slower is a bend
RATE_SPAN = 5  # steps before and after over which a yaw rate is measured
PAUSE = 5  # longest pause within a turn [steps]
STANDING = 1.0  # [m/s] speed below which waiting does not end a turn
MARGIN = 10  # steps before and after a passage: approach and exit


@dataclass(frozen=True)
class Passage:
    """A passage of an agent through a junction from one road to another.

    Attributes:
        agent: row in the log.
        junction: id of the junction in SUMO.
        first, last: first and last step with its centre inside.
        from_lane, to_lane: lanes before and after, as indices in the lane map.
        turned: change of heading, from a second before to a second after, positive to the left [rad].
        heading: heading at the first step [rad].
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
    def way(self) -> str:
        """Where it turns by more than 45 degrees: left or right; else straight."""
        return "straight" if abs(self.turned) <= TURN_RAD else "left" if self.turned > 0.0 else "right"


@dataclass(frozen=True)
class Turn:
    """A turn of an agent by more than 45 degrees at more than 5 degrees per second.

    Attributes:
        agent: row in the log.
        begin, end: first and last step.
        angle: change of heading, positive to the left [rad].
        lateral_acceleration: largest product of speed and yaw rate [m/s2].
    """

    agent: int
    begin: int
    end: int
    angle: float
    lateral_acceleration: float


def passages(log: Log, tracks: LaneTracks, lane_map: LaneMap) -> list[Passage]:
    """Returns the passages of all agents through junctions, sorted by agent and time.

    Passages of agents that appear or disappear inside a junction are left out, and so are those back to the same road:
    the agent waited at the border.
    """
    lanes = lane_map.lanes
    through = []
    for row in range(len(log.ids)):
        pieces = [(begin, end, int(tracks.lane[row, begin])) for begin, end in runs(tracks.lane[row])]
        roads = [piece for piece in pieces if piece[2] != NOWHERE and not lanes[piece[2]].is_internal]
        for (_, leaves, before), (enters, _, after) in pairwise(roads):
            inside = tracks.lane[row, leaves:enters]
            if lanes[before].edge_id == lanes[after].edge_id or not len(inside) or (inside == NOWHERE).any():
                continue
            junction = lanes[int(inside[0])].junction
            first, last = max(leaves - MARGIN, int(log.first_step[row])), min(enters + MARGIN, int(log.last_step[row]))
            yaw = np.unwrap(log.yaw[row, first : last + 1])
            turned = float(yaw[-1] - yaw[0])
            through.append(
                Passage(row, junction, leaves, enters - 1, before, after, turned, float(log.yaw[row, leaves]))
            )
    return through


def turns(log: Log) -> list[Turn]:
    """Returns the turns of all agents, sorted by agent and time; waiting in the middle of a turn does not end it."""
    all_turns = []
    for row in range(len(log.ids)):
        first, last = int(log.first_step[row]), int(log.last_step[row])
        yaw = np.unwrap(log.yaw[row, first : last + 1])
        speed, steps = log.speed[row, first : last + 1], np.arange(len(yaw))
        early, late = np.maximum(steps - RATE_SPAN, 0), np.minimum(steps + RATE_SPAN, len(steps) - 1)
        rate = (yaw[late] - yaw[early]) / np.maximum((late - early) * STEP_S, STEP_S)
        for side in (1.0, -1.0):
            for begin, end in true_runs(_bridged(side * rate > TURN_RATE, speed < STANDING)):
                angle = float(yaw[end - 1] - yaw[begin])
                if side * angle > TURN_RAD:
                    most = float((speed * np.abs(rate))[begin:end].max())
                    all_turns.append(Turn(row, first + begin, first + end - 1, angle, most))
    return sorted(all_turns, key=lambda turn: (turn.agent, turn.begin))


def _bridged(turning: BoolArray, standing: BoolArray) -> BoolArray:
    """Returns `turning` (k,) with gaps closed that are short, or in which the agent stands."""
    closed = turning.copy()
    for begin, end in true_runs(~turning):
        inner = begin > 0 and end < len(turning)
        if inner and (end - begin <= PAUSE or int((~standing[begin:end]).sum()) <= PAUSE):
            closed[begin:end] = True
    return closed


def boxes(log: Log, row: int, first: int, last: int) -> FloatArray:
    """Returns boxes (k, 5) of an agent on the road from step `first` to `last`: x, y, yaw, length, width."""
    piece = slice(first, last + 1)
    size = np.broadcast_to([log.length[row], log.width[row]], (last + 1 - first, 2))
    return np.column_stack([log.x[row, piece], log.y[row, piece], log.yaw[row, piece], size])
