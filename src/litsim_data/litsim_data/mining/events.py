"""Events, their severity, and the data of a log that they are found in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from math import isfinite

import numpy as np

from litsim_data.mining.lane_changes import LaneChange, lane_changes
from litsim_data.mining.lane_tracks import NOWHERE, LaneTracks, Ways, ways_of
from litsim_data.mining.leaders import leaders
from litsim_data.mining.passages import Passage, Turn, passages, turns
from litsim_data.mining.signals import WaySignals
from litsim_data.surrogates.safety import Following
from litsim_sim.core.scene import STEP_S, IntArray
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.scenario.log import Log
from litsim_sim.scenario.scenario import Scenario

Number = float | int | str | None
"""Measure of an event in SI units and radians, or a word; None if there is nothing to measure."""

DECIMALS = 3

AFTER = round(3.0 / STEP_S)  # steps after an event in which the shortest TTC is searched for
CLOSING_MIN = 0.1  # [m/s] smallest closing speed of an approach: 100 m would take a quarter of an hour; our choice

HEADWAY_MAX_S = 3.5  # [s] headway beyond which an agent ahead is irrelevant to the ego
TTC_S = 2.0  # [s] criticality target of time to collision
HEADWAY_S = 0.9  # [s] the lower of the usual targets, 0.9 to 1.8 s
PET_S = 1.5  # [s] criticality target; grave below 1 s
BRAKE_THREAT = 1.0  # full braking
LATERAL_ACCELERATION = 3.0  # [m/s2] uncomfortable above; our choice


class EventKind(StrEnum):
    """Kinds of events around an ego."""

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
    RIGHT_TURN = "right_turn"


@dataclass(frozen=True)
class Event:
    """An event around an ego.

    Attributes:
        kind: its kind.
        ego: id of the ego.
        other: id of the other vehicle; None for none.
        begin, step, end: first step, step of its measures, and last step, in steps of the scenario.
        severity: from 0 to 1, see :func:`severity`; 0.5 is the criticality target of its worst measure.
        numbers: measures by name, which ends with the unit; None if there is nothing to measure.
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
        """Returns the event as an entry of a suite, with times in seconds of the scenario."""
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
    """Returns the severity of an event, from 0 to 1: the maximum over its measures.

    A measure x with criticality target c has severity c / (c + x) if small values are critical (TTC 2 s, time headway
    0.9 s, PET 1.5 s), and x / (c + x) if large ones are (brake threat number 1, lateral acceleration 3 m/s2), so that
    0.5 is the target. None counts as 0. The form is our choice: one scale for all kinds, without ties at either end.
    """
    small = ((ttc, TTC_S), (headway, HEADWAY_S), (pet, PET_S))
    great = ((brake_threat, BRAKE_THREAT), (lateral_acceleration, LATERAL_ACCELERATION))
    values = [target / (target + value) for value, target in small if value is not None]
    values += [1.0 if value == np.inf else value / (target + value) for value, target in great if value is not None]
    return float(max(values, default=0.0))


@dataclass(frozen=True)
class Situation:
    """A log with all data that events are found by.

    Attributes:
        log: recorded motion of all agents.
        lane_map: lanes of the net.
        ways: connections between the lanes.
        tracks: positions of the agents on the lanes.
        following: leader of every agent, and how it is followed; arrays (n, steps).
        changes, passages, turns: lane changes, passages of junctions and turns of all agents.
        signals: signals of the ways through junctions.
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
        """Returns the situation of `log` on the lanes of `lane_map`."""
        tracks = LaneTracks.of(log, lane_map)
        return cls(
            log=log,
            lane_map=lane_map,
            ways=ways_of(lane_map),
            tracks=tracks,
            following=leaders(log, tracks, lane_map),
            changes=lane_changes(tracks),
            passages=passages(log, tracks, lane_map),
            turns=turns(log),
            signals=signals or WaySignals(),
        )

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Situation:
        """Returns the situation of a scenario's log, net and signals."""
        return cls.of(scenario.log, scenario.lane_map, WaySignals.of(scenario))

    def event(
        self,
        kind: EventKind,
        ego: int,
        other: int,
        steps: tuple[int, int, int],
        size: float,
        numbers: Mapping[str, Number],
    ) -> Event:
        """Returns an event of severity `size` between the agents in rows `ego` and `other`; -1 for none.

        `steps` are begin, step and end. Fractions among `numbers` are rounded; None where they are not finite.
        """
        other_id = None if other == NOWHERE else int(self.log.ids[other])
        rounded = {
            name: value if not isinstance(value, float) else round(float(value), DECIMALS) if isfinite(value) else None
            for name, value in numbers.items()
        }
        return Event(kind, int(self.log.ids[ego]), other_id, *steps, size, rounded)

    def followers(self, row: int, step: int) -> IntArray:
        """Returns rows (k,) of the agents that follow the one in `row` at `step`, the nearest first."""
        behind = np.flatnonzero(self.following.leader[:, step] == row)
        return behind[np.argsort(self.following.gap[behind, step], kind="stable")]

    def ttc_after(self, row: int, step: int, end: int) -> float:
        """Returns the shortest time to collision [s] of agent `row` from `step` to 3 s after step `end`."""
        return self.ttc_min(row, step, min(end + AFTER, int(self.log.last_step[row])))

    def ttc_min(self, row: int, first: int, last: int) -> float:
        """Returns the shortest time to collision [s] of agent `row` with its leader, steps `first` to `last`; else
        inf.
        """
        piece = slice(first, last + 1)
        gap, closing = self.following.gap[row, piece], self.following.closing[row, piece]
        times = np.divide(gap, closing, out=np.full(len(gap), np.inf), where=closing > CLOSING_MIN)
        return float(times.min(initial=np.inf))
