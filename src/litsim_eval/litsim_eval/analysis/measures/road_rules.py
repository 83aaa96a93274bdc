"""Rules of the road that the map tells: driving direction, speed limits and stop signs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import (
    HIGHER,
    LOWER,
    Branch,
    Count,
    Measure,
    Metrics,
    Row,
    Share,
    Span,
    Table,
    family,
    known_total,
    largest,
    of_log,
)
from litsim_eval.analysis.measures.comfort import spans
from litsim_sim.core.scene import STEP_S, BoolArray, FloatArray
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.lane_map.signal_links import SignalLink, crossings
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

WINDOW = round(1.0 / STEP_S)  # steps over which driving against the lanes is added up (nuPlan)
OVERSPEED_MPS = 2.23  # [m/s] mean excess over the limit at which the score is 0 (nuPlan)
STOP_WITHIN, STANDING = 5.0, 0.1  # [m] before the line, [m/s]: where and how slow a stop counts (nuPlan)


@Branch
def rules(run: Run) -> dict[str, Any] | None:
    """Returns what the ego does against the rules after the history, and the recorded vehicle as `log`; None if no map.

    - `wrong_way_m`: longest way against the lanes within a second;
    - `over_limit_mps`: largest speed over the limit of the lane; `speed_score`: nuPlan's, 1 where it is kept;
    - `stop_signs`, `stop_signs_run`: stop lines with signs passed; those passed without a stop. None without signs.
    """
    lane_map, ego, last = lane_map_of(run), run.info.ego_id, run.info.history_steps - 1
    if lane_map is None:
        return None
    own, log = (_kept(steps.once(Steps.only, (ego,)), last, ego, lane_map) for steps in (run.steps, run.logged))
    return {**own, "log": log}


def _kept(whole: Steps, last: int, ego: int, lane_map: LaneMap) -> dict[str, Any]:
    """Returns what is kept after step `last`, the last of the history."""
    steps, lines = whole.after(last), stop_lines(lane_map)
    over = over_limit(steps, ego, lane_map)
    passed = stops_at(lines, whole, last, ego) if lines else None
    return {
        "wrong_way_m": float(_within_window(_against(steps, ego, lane_map)).max(initial=0.0)),
        "over_limit_mps": float(over.max(initial=0.0)),
        "speed_score": max(0.0, 1.0 - float(over.mean()) / OVERSPEED_MPS) if len(over) else None,
        "stop_signs": None if passed is None else len(passed),
        "stop_signs_run": None if passed is None else int(np.sum(~passed)),
    }


def over_limit(steps: Steps, ego: int, lane_map: LaneMap) -> FloatArray:
    """Returns by how much the ego is faster than the limit of its lane at each step (n,) [m/s]."""
    rows, table = steps.track(ego), steps.stacked
    lane = lane_map.nearest(table.x[rows], table.y[rows], table.yaw[rows]).lane
    return np.maximum(table.speed[rows] - lane_map.speed_limits[lane], 0.0)


def _against(steps: Steps, ego: int, lane_map: LaneMap) -> FloatArray:
    """Returns how far the ego drives against the lanes outside junctions since the step before (n,) [m]."""
    rows, table = steps.track(ego), steps.stacked
    x, y = table.x[rows], table.y[rows]
    wrong, heading = on_wrong_side(lane_map, x, y, table.yaw[rows])
    back = -(np.diff(x, prepend=x[:1]) * np.cos(heading) + np.diff(y, prepend=y[:1]) * np.sin(heading))
    return np.where(wrong, np.maximum(back, 0.0), 0.0)


def on_wrong_side(lane_map: LaneMap, x: FloatArray, y: FloatArray, yaw: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Returns whether box centres (n,) are on lanes outside junctions that lead the other way, and the lanes' headings.

    A lane in its direction that a centre is on as well makes it right, such as of a road for both directions.
    """
    half = 0.5 * lane_map.widths
    own, near = lane_map.nearest(x, y, yaw), lane_map.nearest(x, y)
    right = ~own.against(yaw) & (np.abs(own.d) <= half[own.lane])
    on_other = near.against(yaw) & (np.abs(near.d) <= half[near.lane]) & ~lane_map.internal[near.lane]
    return ~right & on_other, near.heading


def _within_window(parts: FloatArray) -> FloatArray:
    """Returns the sums of `parts` (n,) over the last second at each of them (n,)."""
    total = np.append(np.zeros(WINDOW), np.cumsum(parts))
    return total[WINDOW:] - total[:-WINDOW]


def stop_lines(lane_map: LaneMap) -> list[SignalLink]:
    """Returns the connections of the lanes before which a stop sign stands."""
    ways = ((lane, lane_map.lanes[lane_map.row(name)]) for lane in lane_map.lanes for name in lane.stops)
    return [replace(SignalLink.between(lane, inside), exit=inside.centerline[-1]) for lane, inside in ways]


def stops_at(lines: Sequence[SignalLink], steps: Steps, last: int, ego: int) -> BoolArray:
    """Returns for each stop line that the ego passes after step `last` whether it has stopped before it (c,)."""
    rows, table = steps.track(ego), steps.stacked
    x, y, yaw, speed, length = (getattr(table, name)[rows] for name in ("x", "y", "yaw", "speed", "length"))
    if not len(rows):
        return np.empty(0, np.bool_)
    passed = crossings(lines, x[None], y[None], yaw[None], length[:1], np.ones((1, len(rows)), np.bool_))
    stopped = []
    after = steps.step[table.number[rows]][passed.step] > last
    for step, link in zip(passed.step[after], passed.link[after], strict=True):
        line = lines[link]
        front_x, front_y = (place + 0.5 * length * part(yaw) for place, part in ((x, np.cos), (y, np.sin)))
        before = (line.stop[0] - front_x) * np.cos(line.heading) + (line.stop[1] - front_y) * np.sin(line.heading)
        near = (np.abs(before) <= STOP_WITHIN) & (np.arange(len(rows)) <= step)
        stopped.append(bool((speed[near] <= STANDING).any()))
    return np.array(stopped, np.bool_)


def _moments_wrong_way(run: Run, _: Metrics) -> list[Span]:
    lane_map, ego = lane_map_of(run), run.info.ego_id
    if lane_map is None:
        return []
    steps = run.simulated
    rows = steps.track(ego)
    return spans(steps.step[steps.stacked.number[rows]], _against(steps, ego, lane_map) > 0.0)


def _wrong_way_text(value: float, limit: str, _: Metrics) -> str:
    return f"the ego drove {value:.1f} m within a second against the direction of the lanes, expected {limit} m"


def _stop_text(value: int, _: str, metrics: Metrics) -> str:
    return f"the ego passed {value} of {metrics['rules']['stop_signs']} stop signs without a stop"


OWN = family(
    "longest way that the ego drives within a second against the lanes, outside junctions (nuPlan allows 2 m, and 6 m "
    "at half the score)",
    Measure(
        *("rules.wrong_way_m", rules, "ego: against the lanes", "m", LOWER),
        rows=(Row("ego_wrong_way_m", largest, Table.EGO),),
        sentence=_wrong_way_text,
        moments=_moments_wrong_way,
    ),
    "largest speed over the limit of the ego's lane, and nuPlan's score: 1 where the limits are kept, 0 from a mean "
    "excess of 2.23 m/s on. Within a junction the higher limit of the lanes before and after holds",
    Measure(
        *("rules.over_limit_mps", rules, "ego: over speed limits", "m/s", LOWER),
        rows=(Row("ego_over_limit_mps", largest, Table.EGO),),
    ),
    Share("rules.speed_score", rules, better=HIGHER),
    "stop signs passed, and those passed without a stop: slower than 0.1 m/s within 5 m of the line (nuPlan); null if "
    "the net has none",
    Count("rules.stop_signs", rules),
    Count(
        *("rules.stop_signs_run", rules, "ego: stop signs run", "", LOWER),
        rows=(Row("ego_stop_signs_run", known_total, Table.EGO),),
        sentence=_stop_text,
    ),
)
MEASURES = (*OWN, *family("the same of the recorded vehicle", *of_log(OWN)))
