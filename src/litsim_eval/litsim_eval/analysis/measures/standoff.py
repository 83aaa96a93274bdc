"""Standoffs: the ego and another vehicle stand for each other, with no light that holds one of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import shapely

from litsim_data.mining.lane_tracks import true_runs
from litsim_eval.analysis.measure import KNOWN_OF_EGO, LOWER, Listed, Metrics, family, moments_of
from litsim_sim.core.geometry import arc_lengths, box_corners, wrap_angle
from litsim_sim.core.scene import STEP_S, AgentRows, BoolArray, FloatArray, IntArray
from litsim_sim.core.signals import AMBER_STATES, STOP_STATES, SignalState
from litsim_sim.core.steps import Steps
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.record.run import Run

STANDS_MPS = 0.3  # [m/s] below which a vehicle stands
LASTS_S = 3.0  # [s] shortest standoff
NEAR_M, AHEAD_M = 40.0, 40.0  # [m] between the two; of their ways ahead that may cross
QUEUE_RAD = np.deg2rad(30.0)  # below which the headings of two vehicles that stand in a queue differ
OFF_WAY_M = 10.0  # [m] from its log beyond which the way of a vehicle is not known
HELD = (*STOP_STATES, *AMBER_STATES, SignalState.FLASHING_RED)


@dataclass(frozen=True)
class Standoff:
    """The ego and another vehicle stand, and their ways cross.

    Attributes:
        agent: id of the other.
        step, end_step: first and last step at which both stand, and no light holds one of them.
        could_go_first: ego, other, either or neither: whose way ahead is free of the box of the other one.
        resolved: whether one of them has moved before the end of the run.
    """

    agent: int
    step: int
    end_step: int
    could_go_first: str
    resolved: bool


@dataclass(frozen=True)
class _Track:
    """States (n,) of an agent by step, as rows of a table, and its logged way (m, 2) [m]."""

    step: IntArray
    state: AgentRows
    log: FloatArray


def standoffs(run: Run) -> list[Standoff]:
    """Returns the standoffs of the ego after the history, sorted by step and agent.

    The way of a vehicle is that of its log, from where it stands on. Vehicles that head into nearly one direction stand
    in a queue, which is none.
    """
    steps = run.steps.after(run.info.history_steps - 1)
    ego_id = run.info.ego_id
    ego = _track(steps.only([ego_id]), run.logged.only([ego_id]), ego_id)
    if ego is None or not _lasting(ego.state.speed < STANDS_MPS, run.info.dt):
        return []
    counts = Counter[int]()
    for part in steps.parts():
        table = part.stacked
        counts.update(table.id[(table.speed < STANDS_MPS) & (table.id != ego_id)].tolist())
    standing = [agent for agent, count in counts.items() if count * run.info.dt >= LASTS_S]
    between = []
    for group, own in steps.groups(standing):
        logged = run.logged.only(group)
        for agent in group:
            if (other := _track(own, logged, agent)) is not None:
                between += _between(run, ego, other, agent)
    return sorted(between, key=lambda standoff: (standoff.step, standoff.agent))


def _track(steps: Steps, logged: Steps, agent: int) -> _Track | None:
    """Returns the motion of an agent at `steps`; None if it is not there, or its log is not known."""
    rows, ways = steps.track(agent), logged.track(agent)
    if not len(rows) or not len(ways):
        return None
    table, log = steps.stacked, logged.stacked
    return _Track(steps.step[table.number[rows]], table.take(rows), np.stack([log.x[ways], log.y[ways]], axis=1))


def _between(run: Run, ego: _Track, other: _Track, agent: int) -> list[Standoff]:
    """Returns the standoffs of the ego with one other agent."""
    steps, mine, theirs = np.intersect1d(ego.step, other.step, return_indices=True)
    own, others = ego.state.take(mine), other.state.take(theirs)
    both = (np.hypot(own.x - others.x, own.y - others.y) < NEAR_M) & (own.speed < STANDS_MPS)
    both &= (others.speed < STANDS_MPS) & (np.abs(wrap_angle(own.yaw - others.yaw)) > QUEUE_RAD)
    if run.signals is not None and _lasting(both, run.info.dt):
        both &= ~(_held(run, ego)[mine] | _held(run, other)[theirs])
    between = []
    for begin, end in _lasting(both, run.info.dt):
        first = _could_go_first(ego, int(mine[begin]), other, int(theirs[begin]))
        if first:
            last = int(steps[end - 1])
            between.append(Standoff(agent, int(steps[begin]), last, first, resolved=last < run.tables[-1].step))
    return between


def _could_go_first(ego: _Track, here: int, other: _Track, there: int) -> str:
    """Returns who could go first where both stand; empty if their ways do not cross."""
    ways = _way(ego, here), _way(other, there)
    if ways[0] is None or ways[1] is None or not ways[0].intersects(ways[1]):
        return ""
    could = not ways[0].intersects(_box(other, there)), not ways[1].intersects(_box(ego, here))
    return {(True, True): "either", (True, False): "ego", (False, True): "other"}.get(could, "neither")


def _way(track: _Track, here: int) -> shapely.Geometry | None:
    """Returns the area that a vehicle sweeps along its log ahead; None if its log is elsewhere, or ends there."""
    place, width = np.array([track.state.x[here], track.state.y[here]]), float(track.state.width[here])
    away = np.hypot(*(track.log - place).T)
    nearest = len(away) - 1 - int(np.argmin(away[::-1]))  # the last, where the log stands there itself
    ahead = track.log[nearest:]
    if away[nearest] > OFF_WAY_M or len(ahead) < 2:
        return None
    along = arc_lengths(ahead)
    ahead = ahead[along <= AHEAD_M]
    if along[-1] < 0.5 * track.state.length[here] or len(ahead) < 2:
        return None
    return shapely.LineString(ahead).buffer(0.5 * width, cap_style="flat")


def _box(track: _Track, row: int) -> shapely.Geometry:
    state = track.state.take(np.array([row]))
    return shapely.Polygon(box_corners(state.x, state.y, state.yaw, state.length, state.width)[0])


def _held(run: Run, track: _Track) -> BoolArray:
    """Returns (n,) the steps at which a light ahead of a vehicle, on its lane and within AHEAD_M, holds it."""
    assert run.signals is not None
    held = np.zeros(len(track.step), np.bool_)
    last = run.signals.states.shape[1] - 1
    for link, group in zip(run.signals.links, run.signals.link_group.tolist(), strict=True):
        shown = run.signals.states[group, np.minimum(track.step, last)]
        held |= np.isin(shown, HELD) & _before(link, track)
    return held


def _before(link: SignalLink, track: _Track) -> BoolArray:
    cos, sin = np.cos(link.heading), np.sin(link.heading)
    dx, dy = link.stop[0] - track.state.x, link.stop[1] - track.state.y
    ahead, beside = cos * dx + sin * dy, cos * dy - sin * dx
    facing = np.abs(wrap_angle(track.state.yaw - link.heading)) < QUEUE_RAD
    return (ahead > -1.0) & (ahead < AHEAD_M) & (np.abs(beside) < 0.5 * link.width) & facing


def _lasting(true: BoolArray, dt: float) -> list[tuple[int, int]]:
    """Returns begin and end (exclusive) of each run of True that lasts for LASTS_S at least."""
    return [(begin, end) for begin, end in true_runs(true) if (end - begin) * dt >= LASTS_S]


def standoff_text(entry: Mapping[str, Any]) -> str:
    """Returns a sentence on an entry of `standoffs` of `metrics.json`."""
    first = {"ego": "the ego could go first", "other": f"{entry['agent']} could go first"}.get(
        entry["could_go_first"], f"{entry['could_go_first']} could go first"
    )
    until = f"until {STEP_S * entry['end_step']:.1f} s" if entry["resolved"] else "to the end"
    begin = f"{STEP_S * entry['step']:.1f} s"
    return f"ego and {entry['agent']} stand for each other from {begin} {until}, {first}"


def _texts(_: Any, __: str, metrics: Metrics) -> str:
    return "; ".join(map(standoff_text, metrics["standoffs"]))


moments_of_standoffs = moments_of(lambda metrics: metrics.get("standoffs", []))
MEASURES = family(
    "[standoffs](#standoffs) of the ego: `agent`, the other; `step`, `end_step`; `could_go_first`: `ego`, `other`, "
    "`either` or `neither`; `resolved`: whether one of them moved on",
    Listed(
        *("standoffs", lambda run: [asdict(standoff) for standoff in standoffs(run)], "standoffs", "", LOWER),
        rows=KNOWN_OF_EGO,
        sentence=_texts,
        moments=moments_of_standoffs,
    ),
)
