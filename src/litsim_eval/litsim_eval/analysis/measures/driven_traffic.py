"""Driven traffic against the log: how closely agents follow, and how hard and steadily they drive, under control.

Distance from the log cannot tell whether an agent that had to leave it drives as people do. So the same is measured of
agents while a policy drives them, of the logs of the same agents, and of all of the log.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from litsim_data.mining.lane_changes import STAYED_S, lane_changes
from litsim_data.mining.lane_tracks import LaneTracks
from litsim_data.surrogates.safety import following
from litsim_eval.analysis.measure import (
    LOWER,
    Branch,
    Figure,
    Measure,
    Metrics,
    Row,
    Table,
    family,
    figure_at,
    mean_of,
    middle,
)
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.motion_features import SAMPLE
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import StackedTable, Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run
from litsim_sim.scenario.log import Log

HEADWAY_CLOSE_S = 0.5  # [s]
TTC_SHORT_S = 3.0  # [s]
BRAKING_HARD = 2.0  # [m/s2]
MOVING = 1.0  # [m/s] least speed of a follower: headways grow without bound towards rest
SAME_WAY = math.cos(math.radians(45.0))  # least cosine between the headings of a follower and its leader
SPAN = round(1.0 / STEP_S)  # steps over which accelerations are taken: over one step, those of a log are mostly noise
STAY = round(STAYED_S / STEP_S)  # steps after a change of lanes that show whether it is one
LEAD = 3 * STAY  # steps that are looked at before those that count
QUANTITIES = ("headway", "gap", "time_to_leader", "acceleration", "jerk")


class Samples(NamedTuple):
    """Values of one quantity at m agent-steps.

    Attributes:
        agent: (m,) ids.
        value: (m,) values.
    """

    agent: IntArray
    value: FloatArray

    def of(self, agents: Collection[int]) -> Samples:
        """Returns the samples of `agents`."""
        whose = np.isin(self.agent, sorted(agents))
        return Samples(self.agent[whose], self.value[whose])


@dataclass(frozen=True)
class Traffic:
    """How vehicles drive.

    Attributes:
        steps: number of steps of each agent.
        samples: values at every fifth step, by quantity: `headway` and `time_to_leader` [s] and `gap` [m] of agents
            that follow a leader; `acceleration` [m/s2], the change of speed over the last second, and `jerk` [m/s3],
            that of the acceleration.
        lane_changes: number of each agent's; None without lanes.
    """

    steps: Counter[int]
    samples: dict[str, Samples]
    lane_changes: Counter[int] | None

    def of(self, agents: Collection[int]) -> Traffic:
        """Returns how `agents` drive."""
        changes = self.lane_changes
        return Traffic(
            steps=Counter({agent: self.steps[agent] for agent in agents}),
            samples={name: samples.of(agents) for name, samples in self.samples.items()},
            lane_changes=None if changes is None else Counter({agent: changes[agent] for agent in agents}),
        )

    def measures(self) -> dict[str, Any]:
        """Returns medians, shares and rates over all agent-steps; None for those of nothing."""
        headway, gap, time_to_leader, acceleration, jerk = (self.samples[name].value for name in QUANTITIES)
        minutes = self.steps.total() * STEP_S / 60.0
        changes = None if self.lane_changes is None else self.lane_changes.total()
        return {
            "minutes": minutes,
            "following": len(headway),
            "headway_s": float(np.median(headway)) if len(headway) else None,
            "gap_m": float(np.median(gap)) if len(gap) else None,
            "headway_below_half_s": mean_of(headway < HEADWAY_CLOSE_S),
            "ttc_below_3_s": mean_of(time_to_leader < TTC_SHORT_S),
            "accelerations": len(acceleration),
            "braking_beyond_2_mps2": mean_of(acceleration < -BRAKING_HARD),
            "jerks": len(jerk),
            "jerk_mps3": mean_of(np.abs(jerk)),
            "lane_changes": changes,
            "lane_changes_per_minute": None if changes is None or not minutes else changes / minutes,
        }


def driven_traffic(run: Run, controlled: Collection[int]) -> dict[str, Any]:
    """Returns measures of driven agents, of the logs of those ever under control (`controlled`), and of all of the log.

    All are of the steps after the history; pedestrians and cyclists are left out.
    """
    lane_map = lane_map_of(run)
    log = run.simulated_log.once(traffic, lane_map)
    driven = traffic(run.simulated, lane_map, driven=True).measures()
    same_log = log.of(controlled).measures()
    own, theirs = driven["headway_s"], same_log["headway_s"]
    ratio = None if own is None or not theirs else own / theirs
    return {"driven": driven, "same_log": same_log, "log": log.measures(), "headway_ratio": ratio}


def traffic(steps: Steps, lane_map: LaneMap | None, *, driven: bool = False) -> Traffic:
    """Returns how vehicles drive at `steps`: all of them, or only while a policy drives them."""
    present, changes = Counter[int](), Counter[int]()
    parts: dict[str, list[Samples]] = {name: [] for name in QUANTITIES}
    for begin, end in steps.blocks():
        lead = max(0, begin - LEAD)
        part = steps.part(lead, end)
        table = part.stacked
        judged = ~table.obstacle
        if driven:
            judged &= table.of_policy
        present.update(table.id[judged & (table.number >= begin - lead)].tolist())
        rows = np.flatnonzero(judged & (table.number >= begin - lead) & ((lead + table.number) % SAMPLE == 0))
        for name, samples in (_behind(table, rows) | _over_time(part, rows, judged)).items():
            parts[name].append(samples)
        if lane_map is not None:
            first, last = begin - lead - (STAY if begin else 0), len(part) - (STAY if end < len(steps) else 0)
            changes.update(_changing(table.take(judged), len(part), lane_map, range(first, last)))
    return Traffic(
        steps=present,
        samples={name: _joined(some) for name, some in parts.items()},
        lane_changes=None if lane_map is None else changes,
    )


def _behind(table: StackedTable, rows: IntArray) -> dict[str, Samples]:
    """Returns headways, gaps and times to the leader of those in `rows` that move behind one that goes their way."""
    behind = following(table, rows)
    turned = np.cos(table.yaw[behind.leader] - table.yaw[rows])
    follows = (behind.leader >= 0) & (table.speed[rows] >= MOVING) & (turned >= SAME_WAY)
    values = {"headway": behind.headway, "gap": behind.gap, "time_to_leader": behind.time_to_leader}
    return {name: Samples(table.id[rows[follows]], value[follows]) for name, value in values.items()}


def _over_time(steps: Steps, rows: IntArray, judged: BoolArray) -> dict[str, Samples]:
    """Returns accelerations and jerks of those in `rows` that were among the rows `judged` (all,) one, two seconds ago.

    Of a track with a gap, or from before a takeover, there is none.
    """
    table, duration = steps.stacked, SPAN * STEP_S
    before = _earlier(steps, rows, judged)
    rows, before = rows[before >= 0], before[before >= 0]
    acceleration = (table.speed[rows] - table.speed[before]) / duration
    first = _earlier(steps, before, judged)
    there = first >= 0
    acceleration_before = (table.speed[before] - table.speed[first]) / duration
    jerk = (acceleration - acceleration_before)[there] / duration
    agent = table.id[rows]
    return {"acceleration": Samples(agent, acceleration), "jerk": Samples(agent[there], jerk)}


def _earlier(steps: Steps, rows: IntArray, judged: BoolArray) -> IntArray:
    """Returns the rows (m,) of the agents in `rows` (m,) one second before; -1 where that is not among `judged`."""
    table = steps.stacked
    number = table.number[rows]
    before = steps.rows_at(number - SPAN, table.id[rows])
    elapsed = steps.step[number] - steps.step[np.maximum(number - SPAN, 0)]
    return np.where((before >= 0) & judged[before] & (elapsed == SPAN), before, -1)


def _changing(table: StackedTable, steps: int, lane_map: LaneMap, within: range) -> list[int]:
    """Returns the agent of each lane change that crosses between lanes `within` some of `steps` steps."""
    if not len(table):
        return []
    log = Log.from_rows(table, steps)
    changes = lane_changes(LaneTracks.of(log, lane_map))
    return [int(log.ids[change.agent]) for change in changes if change.cross in within]


def _joined(parts: list[Samples]) -> Samples:
    """Returns the samples of all blocks of steps."""
    return Samples(
        np.concatenate([np.empty(0, np.int64), *(part.agent for part in parts)]),
        np.concatenate([np.empty(0), *(part.value for part in parts)]),
    )


@Branch
def of_run(run: Run) -> dict[str, Any]:
    """Returns :func:`driven_traffic` of the agents ever under control."""
    return driven_traffic(run, run.once(collisions).controlled)


def _sum_of(mean_or_share: str, count: str) -> Figure:
    """Returns the figure of the sum that a mean or share was made of, both by their paths; 0 over nothing."""
    value, number = figure_at(mean_or_share), figure_at(count)

    def figure(run: Metrics) -> float | None:
        average, over = value(run), number(run)
        return 0.0 if over == 0 else None if average is None or over is None else average * over

    return figure


WHOSE = {"driven": "driven", "same_log": "of their logs", "log": "of all logs"}
"""Whose driving the branches of `traffic` tell of."""


def _drivers(name: str, title: str = "", unit: str = "", over: str = "", **more: Any) -> list[Measure]:
    """Returns three measures of one quantity: of driven vehicles, which has the title, of their logs and of all logs.

    Over runs, a measure is the mean over all that `over` counts in these runs; without `over`, the median of the runs.
    """
    made = []
    for whose, named in WHOSE.items():
        path, count = f"traffic.{whose}.{name}", f"traffic.{whose}.{over}"
        row: dict[str, Any] = {"table": Table.TRAFFIC, "title": f"{title}, {named}", "of_control": whose != "log"}
        row |= {"figure": _sum_of(path, count), "below": figure_at(count)} if over else {"over": middle}
        rows = (Row(f"traffic_{whose}.{name}", **row),) if title else ()
        own = f"{title}, {named}" if title and whose == "driven" else ""
        made.append(Measure(path, of_run, own, unit, rows=rows, **more))
    return made


COUNTED: dict[str, Any] = {"kinds": (int,)}
BAD: dict[str, Any] = {"share": True, "better": LOWER}
OF_DRIVERS = family(
    "time that these vehicles drive, in all",
    *_drivers("minutes", unit="min"),
    "number of agent-steps behind a leader: of vehicles that move at 1 m/s or more behind the leader of "
    "[`series.parquet`](#series-and-takeovers), if that heads within 45° of their way",
    *_drivers("following", **COUNTED),
    "over these: median time headway, and gap between the boxes",
    *_drivers("headway_s", "median headway", "s"),
    *_drivers("gap_m", "median gap", "m"),
    "their share with a time headway below 0.5 s",
    *_drivers("headway_below_half_s", "headway below 0.5 s", over="following", **BAD),
    "their share with less than 3 s to contact with the leader at constant speeds",
    *_drivers("ttc_below_3_s", "TTC below 3 s", over="following", **BAD),
    "number of accelerations, each the change of speed over 1 s; share of them below −2 m/s²",
    *_drivers("accelerations", **COUNTED),
    *_drivers("braking_beyond_2_mps2", "braking beyond 2 m/s²", over="accelerations", **BAD),
    "number of changes of these accelerations over 1 s, and their mean magnitude. Of a log it is mostly noise",
    *_drivers("jerks", **COUNTED),
    *_drivers("jerk_mps3", "mean jerk", "m/s³", over="jerks"),
    "[lane changes](mining.md) that cross into the next lane meanwhile; null without a net",
    *_drivers("lane_changes", **COUNTED),
    *_drivers("lane_changes_per_minute", "lane changes per minute", over="minutes"),
)
MEASURES = (
    *sorted(OF_DRIVERS, key=lambda measure: list(WHOSE).index(measure.name.split(".")[1])),
    *family(
        "the median headway under control over that in the same agents' logs",
        Measure("traffic.headway_ratio", of_run, "driven: headway over their logs'"),
    ),
)
