"""Whether the ego drives its mission: its progress along the route, where it leaves it, and its goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import (
    HIGHER,
    LOWER,
    Branch,
    Listed,
    Measure,
    Metrics,
    Row,
    Table,
    Truth,
    family,
    known_total,
    mean,
    moments_of,
)
from litsim_eval.analysis.measures.comfort import spans
from litsim_eval.analysis.measures.ego import PROGRESS_LEAST_M
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray, IntArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run
from litsim_sim.scenario.mission import Mission

ARRIVAL_M = 5.0  # [m] from the goal, about a car's length, within which it is reached
NOT_RECORDED = "the ego's mission is not recorded: the record is of an earlier version"
NO_RATIO = "the ego's progress has nothing to compare with: its goal is named, or its mission is not recorded"


@dataclass(frozen=True)
class Way:
    """The way of the ego, at the steps at which it is on the road; arrays (n,).

    Attributes:
        step: the steps.
        x, y: its box centre [m].
        lane: position of its lane.
        moved: distance since the step before [m]; 0 where it was not on the road then.
        along: the same in the direction of the lane [m].
    """

    step: IntArray
    x: FloatArray
    y: FloatArray
    lane: IntArray
    moved: FloatArray
    along: FloatArray

    @classmethod
    def of(cls, steps: Steps, ego: int, lane_map: LaneMap) -> Way:
        """Returns the way of `ego` in `steps`."""
        rows, table = steps.track(ego), steps.stacked
        x, y, step = table.x[rows], table.y[rows], steps.step[table.number[rows]]
        place = lane_map.nearest(x, y, table.yaw[rows])
        follows = np.diff(step, prepend=step[:1] - 2) == 1
        dx, dy = (np.where(follows, np.diff(part, prepend=part[:1]), 0.0) for part in (x, y))
        along = dx * np.cos(place.heading) + dy * np.sin(place.heading)
        return cls(step, x, y, place.lane, np.hypot(dx, dy), along)

    def progress(self, mission: Mission, last: float) -> float:
        """Returns how far it comes on the lanes of the route until step `last` [m]."""
        return float(self.along[mission.on_route[self.lane] & (self.step <= last)].sum())


@Branch
def mission(run: Run) -> dict[str, Any] | None:
    """Returns measures of the mission after the history; None if the mission is not recorded.

    `progress_ratio` is nuPlan's: the ego's progress on the lanes of the route over that of its log, while the log
    lasts, each at least 0.1 m. None where the scenario names a goal, as the log drives elsewhere.
    """
    given, lane_map = run.mission, lane_map_of(run)
    if given is None or lane_map is None:
        return None
    named, last_history = bool(run.scenario.get("goal")), run.info.history_steps - 1
    way, log = (
        Way.of(steps.once(Steps.only, (run.info.ego_id,)).after(last_history), run.info.ego_id, lane_map)
        for steps in (run.steps, run.logged)
    )
    if not len(way.step):
        return None
    away = np.hypot(way.x - given.goal[0], way.y - given.goal[1])
    ratio = None
    if len(log.step) and not named:
        until = float(log.step[-1])
        driven, logged = (max(path.progress(given, until), PROGRESS_LEAST_M) for path in (way, log))
        ratio = driven / logged
    arrived = away <= ARRIVAL_M
    left = _off_route(way, given, lane_map, arrived if named else arrived | _on_last_edge(way, given, lane_map))
    return {
        "progress_m": way.progress(given, np.inf),
        "progress_ratio": ratio,
        "off_route_m": float(way.moved[left].sum()),
        "left": [
            {"step": begin, "end_step": end, "lane": lane_map.lanes[way.lane[way.step.searchsorted(begin)]].id}
            for begin, end in spans(way.step, left)
        ],
        "goal_m": float(away.min()),
        "goal_reached": bool(arrived.any()) if named else None,
    }


def _off_route(way: Way, given: Mission, lane_map: LaneMap, arrived: BoolArray) -> BoolArray:
    """Returns at which steps (n,) the ego is on a lane outside junctions and off its route, before it arrives."""
    return ~given.on_route[way.lane] & ~lane_map.internal[way.lane] & ~np.logical_or.accumulate(arrived)


def _on_last_edge(way: Way, given: Mission, lane_map: LaneMap) -> BoolArray:
    """Returns at which steps (n,) the ego is on the edge of the goal; beyond its end no log tells where to drive."""
    goal = lane_map.nearest(*(given.goal[k : k + 1] for k in range(3))).lane[0]
    same = np.array([lane.edge_id == lane_map.lanes[goal].edge_id for lane in lane_map.lanes])
    return same[way.lane]


def _left_text(value: float, limit: str, metrics: Metrics) -> str:
    places = [
        f"at {STEP_S * departure['step']:.1f} s onto lane {departure['lane']}"
        for departure in metrics["mission"]["left"]
    ]
    return f"the ego left its route {' and '.join(places)}, and drove {value:.0f} m beside it, expected {limit} m"


def _goal_text(_: Any, __: str, metrics: Mapping[str, Any]) -> str:
    return f"the ego did not reach its goal: it came within {metrics['mission']['goal_m']:.1f} m of it"


_Given = partial(Measure, missing=NOT_RECORDED)
MEASURES = family(
    "the ego's progress on the lanes of [its route](ego-interface.md#the-mission), and the same over its log's, while "
    "the log lasts (each at least 0.1 m, as in nuPlan; null where the scenario names a goal)",
    _Given("mission.progress_m", mission, "ego: progress along the route", "m"),
    _Given(
        *("mission.progress_ratio", mission, "ego: progress along the route over its log's", "", HIGHER),
        missing=NO_RATIO,
        rows=(Row("ego_route_progress", mean, Table.EGO, "ego: progress on its route", share=True),),
    ),
    "distance that the ego drives on lanes outside junctions that are not of its route, before it comes to the goal, "
    "or to the last edge of its log; and when, onto which lane",
    _Given(
        *("mission.off_route_m", mission, "ego: off its route", "m", LOWER),
        rows=(Row("ego_off_route_m", known_total, Table.EGO),),
        sentence=_left_text,
        moments=moments_of(lambda metrics: (metrics.get("mission") or {}).get("left", [])),
    ),
    Listed("mission.left", mission, better=LOWER),
    "shortest distance from the goal; whether the ego comes within 5 m of it (null unless the scenario names a goal)",
    _Given("mission.goal_m", mission, "ego: from its goal", "m", LOWER),
    Truth("mission.goal_reached", mission, "ego: goal reached", "", HIGHER, sentence=_goal_text),
)
