"""Events: what they are, how severe one is, and all that is known of a log to find them in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

import numpy as np

from litsim_sim.analysis.safety import Following
from litsim_sim.core.scene import STEP_S, IntArray
from litsim_sim.maps.lane_map import LaneMap
from litsim_sim.mining.lane_changes import LaneChange, lane_changes
from litsim_sim.mining.lane_tracks import LaneTracks, Ways
from litsim_sim.mining.leaders import leaders
from litsim_sim.mining.passages import Passage, Turn, passages, turns
from litsim_sim.mining.signals import WaySignals
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

Number = float | int | str | None
"""Of an event: a measure in SI units and radians, a word, or None where there is nothing to measure."""

DECIMALS = 3

CLOSING_MIN = 0.1  # [m/s] less is no approach: of hundred metres, the time would be a quarter of an hour; our choice

HEADWAY_MAX_S = 3.5  # [s] who is ahead of the ego, or goes there, farther away is nothing to it
TTC_S = 2.0  # [s] a new follower's is critical below
HEADWAY_S = 0.9  # [s] the lower of the usual targets, 0.9 to 1.8 s
PET_S = 1.5  # [s] critical below, grave below 1 s
BRAKE_THREAT = 1.0  # as much as the brakes can
LATERAL_ACCELERATION = 3.0  # [m/s2] more is uncomfortable; our choice


class EventKind(StrEnum):
    """What can happen around an ego."""

    CUT_IN = "cut_in"
    CUT_OUT = "cut_out"
    HARD_BRAKING = "hard_braking"
    LEADER_BRAKING = "leader_braking"
    LANE_CHANGE = "lane_change"
    MERGE = "merge"
    STOP_AND_GO = "stop_and_go"
    FOLLOWING = "following"
    TURN = "turn"
    CROSSING = "crossing"
    LEFT_TURN = "left_turn"


@dataclass(frozen=True)
class Event:
    """Something happens around an ego.

    Attributes:
        kind: what.
        ego: id of the vehicle from whose seat it is seen.
        other: id of the vehicle that it happens with, None where there is none.
        begin, step, end: first step of it, the one that its numbers are of, and its last, in steps of the scenario.
        severity: from 0 to 1; 0.5 is the criticality target of the measure that is worst, see :func:`severity`.
        numbers: its measures by name, the unit at the end of each; None where there is nothing to measure.
    """

    kind: EventKind
    ego: int
    other: int | None
    begin: int
    step: int
    end: int
    severity: float
    numbers: Mapping[str, Number] = field(default_factory=dict)

    def entry(self) -> dict[str, Number]:
        """The event as it stands in a suite, times in seconds of the scenario."""
        times = {"time_s": self.step, "begin_s": self.begin, "end_s": self.end}
        head: dict[str, Number] = {"kind": str(self.kind), "other": self.other}
        head |= {name: round(step * STEP_S, DECIMALS) for name, step in times.items()}
        return head | {"severity": round(self.severity, DECIMALS)} | dict(self.numbers)


def severity(
    *,
    ttc: float | None = None,
    headway: float | None = None,
    pet: float | None = None,
    brake_threat: float | None = None,
    lateral_acceleration: float | None = None,
) -> float:
    """How severe an event is, from 0 to 1: of its measures the worst, c / (c + x) where x may not be small.

    c is the criticality target of a measure, so that 0.5 says it is met: TTC 2 s, time headway 0.9 s, PET 1.5 s. Of
    measures that may not be great it is x / (c + x): brake threat number 1, lateral acceleration 3 m/s2. None and
    infinity say nothing. The form is our choice: one scale for all kinds, without ties at either end.
    """
    small = ((ttc, TTC_S), (headway, HEADWAY_S), (pet, PET_S))
    great = ((brake_threat, BRAKE_THREAT), (lateral_acceleration, LATERAL_ACCELERATION))
    values = [target / (target + value) for value, target in small if value is not None]
    values += [1.0 if value == np.inf else value / (target + value) for value, target in great if value is not None]
    return float(max(values, default=0.0))


def measured(value: float) -> float | None:
    """`value` rounded as events hold it, None where it is infinite: there is nothing to measure."""
    return round(float(value), DECIMALS) if isfinite(value) else None


@dataclass(frozen=True)
class Situation:
    """A log with everything that events are found by.

    Attributes:
        log: what every agent did.
        lane_map: the lanes.
        ways: how they lead into each other.
        tracks: where agents are on them.
        following: who follows whom; arrays (n, steps).
        changes, passages, turns: of all agents.
        signals: of the ways through junctions.
    """

    log: Log
    lane_map: LaneMap
    ways: Ways
    tracks: LaneTracks
    following: Following
    changes: list[LaneChange]
    passages: list[Passage]
    turns: list[Turn]
    signals: WaySignals = field(default_factory=WaySignals)

    @classmethod
    def of(cls, log: Log, lane_map: LaneMap, signals: WaySignals | None = None) -> Situation:
        """Find who is where, follows whom, changes lanes and turns in `log` on the lanes of `lane_map`."""
        tracks = LaneTracks.of(log, lane_map)
        return cls(
            log=log,
            lane_map=lane_map,
            ways=Ways(lane_map.lanes),
            tracks=tracks,
            following=leaders(log, tracks, lane_map),
            changes=lane_changes(tracks),
            passages=passages(log, tracks, lane_map),
            turns=turns(log),
            signals=signals or WaySignals(),
        )

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Situation:
        """The same of a scenario's log, net and signals."""
        return cls.of(scenario.log, scenario.lane_map, WaySignals.of(scenario))

    def id_of(self, row: int) -> int:
        """Id of the agent in `row`."""
        return int(self.log.ids[row])

    def followers(self, row: int, step: int) -> IntArray:
        """Rows of the agents whose leader at `step` is the one in `row`, the nearest first."""
        behind = np.flatnonzero(self.following.leader[:, step] == row)
        return behind[np.argsort(self.following.gap[behind, step], kind="stable")]

    def ttc_min(self, row: int, first: int, last: int) -> float:
        """The least time of the agent in `row` to its leader, from step `first` through `last` [s]; inf without."""
        piece = slice(first, last + 1)
        gap, closing = self.following.gap[row, piece], self.following.closing[row, piece]
        times = np.divide(gap, closing, out=np.full(len(gap), np.inf), where=closing > CLOSING_MIN)
        return float(times.min(initial=np.inf))
