"""How the ego drove, compared with the vehicle that it replaces in the recording."""

from __future__ import annotations

from typing import Any

import numpy as np

from litsim_eval.analysis.measure import (
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
    in_percent,
    mean,
    of_log,
    percent,
)
from litsim_eval.analysis.measures.comfort import comfort, spans
from litsim_eval.analysis.measures.progress import distance_of
from litsim_eval.analysis.measures.standoff import moments_of_standoffs, standoff_text
from litsim_sim.core.geometry import box_corners
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.lane_map import LaneMap
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

UNKNOWN, NORMAL = 0, 1  # states of autoware_adapi_v1_msgs/MrmState without a minimum-risk manoeuvre
PROGRESS_LEAST_M = 0.1  # lower bound on both distances of the ratio: 1 where neither vehicle moves (nuPlan)


@Branch
def ego_motion(run: Run) -> dict[str, Any]:
    """Returns measures of the ego after the history; `log` holds those of the recorded vehicle.

    - `off_road`, `over_edge`: shares of steps at which its centre, or a corner of its box, is on no lane;
    - `hard_brakes`: number of manoeuvres that brake harder than 3 m/s2;
    - `progress_m`: distance travelled; `progress_ratio` (ego only): the ego's distance up to the end of its log over
      that of the log.
    """
    ego, lane_map = run.info.ego_id, lane_map_of(run)
    driven_steps, log_steps = (steps.once(Steps.only, (ego,)) for steps in (run.steps, run.logged))
    history = run.info.history_steps
    way, log_way = (steps.after(history - 1) for steps in (driven_steps, log_steps))  # from where it ends
    driven = _motion(driven_steps.after(history), way, ego, lane_map, run.info.dt)
    log = _motion(log_steps.after(history), log_way, ego, lane_map, run.info.dt)
    logged, distance = log_way.track(ego), log["progress_m"]
    last = int(log_way.step[log_way.stacked.number[logged[-1]]]) if len(logged) else -1
    until = distance_of(way, ego, last)
    ratio = None
    if until is not None and distance is not None:
        ratio = max(until, PROGRESS_LEAST_M) / max(distance, PROGRESS_LEAST_M)
    return {**driven, "progress_ratio": ratio, "log": log}


def minimum_risk_s(run: Run) -> float | None:
    """Returns the time after the history in which the ego's stack has told of a minimum-risk manoeuvre [s].

    A state holds until the stack tells of another; one in which the manoeuvre has succeeded or failed counts as well.
    None if the recording holds no states.
    """
    if not run.minimum_risk:
        return None
    told = np.array(sorted(run.minimum_risk))
    states = np.array([UNKNOWN, *(run.minimum_risk[step] for step in told.tolist())])
    state = states[np.searchsorted(told, run.simulated.step, side="right")]
    return round(float(np.sum((state != UNKNOWN) & (state != NORMAL)) * run.info.dt), 6)


def _motion(steps: Steps, way: Steps, agent: int, lane_map: LaneMap | None, dt: float) -> dict[str, Any]:
    rows = steps.track(agent)
    x, y, yaw, length, width = (getattr(steps.stacked, f)[rows] for f in ("x", "y", "yaw", "length", "width"))
    felt = comfort(steps, agent, dt)
    off_road = over_edge = None
    if lane_map is not None and len(x):
        corners = box_corners(x, y, yaw, length, width)
        on_lane = lane_map.inside_road(corners[..., 0].ravel(), corners[..., 1].ravel()).reshape(-1, 4)
        off_road = float(np.mean(~lane_map.inside_road(x, y)))
        over_edge = float(np.mean(~on_lane.all(axis=1)))
    return {
        "off_road": off_road,
        "over_edge": over_edge,
        "hard_brakes": None if felt is None else felt.hard_brakes,
        "progress_m": distance_of(way, agent),
    }


def _moments_off_road(run: Run, _: Metrics) -> list[Span]:
    rows, table, lane_map = run.simulated.track(run.info.ego_id), run.simulated.stacked, lane_map_of(run)
    if lane_map is None:
        return []
    return spans(run.simulated.step[table.number[rows]], ~lane_map.inside_road(table.x[rows], table.y[rows]))


def _progress_text(value: float, limit: str, metrics: Metrics) -> str:
    text = f"the ego came {percent(value)} as far as its log, expected {in_percent(limit)}"
    return "; ".join([text, *map(standoff_text, metrics.get("standoffs", []))])


DRIVEN = family(
    "shares of steps at which the ego's centre, or a corner of its box, is on no lane",
    Share("ego_motion.off_road", ego_motion, "ego: off the road", "", LOWER, moments=_moments_off_road),
    Share("ego_motion.over_edge", ego_motion, "ego: over the edge", "", LOWER),
    "[hard brakes](#hard-brakes) of the ego, and distance that it travels",
    Count("ego_motion.hard_brakes", ego_motion, better=LOWER),
    Measure("ego_motion.progress_m", ego_motion, "ego: progress", "m"),
)
MOTION = (
    *DRIVEN,
    *family(
        "the ego's progress over that of its log, while the log lasts (each at least 0.1 m, as in nuPlan)",
        Measure(
            *("ego_motion.progress_ratio", ego_motion, "ego: progress over its log's"),
            rows=(Row("ego_progress", mean, Table.EGO, share=True),),
            sentence=_progress_text,
            moments=moments_of_standoffs,
        ),
        "the same of the recorded vehicle",
        *of_log(DRIVEN),
    ),
)
RISK = family(
    "seconds in which the ego's stack told of a minimum-risk manoeuvre, also one that had succeeded or failed, by "
    "messages `autoware_adapi_v1_msgs/MrmState`, which [Autoware's adapter](autoware.md) records; null without any",
    Measure("minimum_risk_s", minimum_risk_s, "ego: minimum-risk manoeuvres", "s", LOWER),
)
