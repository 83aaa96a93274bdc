"""Candidates of the hard suite: what may happen to an ego, by kind; acts begin where the ego is in the run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from planted_egos import from_ramp

from litsim_data.mining.events import EventKind
from litsim_data.mining.mine import mine
from litsim_eval.analysis.measures.signals import passages
from litsim_eval.search.places import Places, agents_by_act
from litsim_sim.core.geometry import to_body
from litsim_sim.core.scene import STEP_S, Kind
from litsim_sim.core.signals import STOP_STATES, SignalState
from litsim_sim.lane_map.signal_links import SignalLink
from litsim_sim.scenario.scenario import Scenario
from litsim_sim.world.places import headways

HARD_MPS2, LONG_S = 6.0, 3.0  # how a leader brakes, and for how long
JAM_MPS = 7.0  # [m/s] of the ego below which its leader is in a queue
NEAR_S, NEXT_S = 2.0, 3.5  # headway to the leader within which it acts, and to the one before it
ROOM_S = (0.3, 1.5)  # headway that a vehicle leaves that cuts in
WALKERS = {  # who crosses: kind, speeds [m/s], length and width [m]
    "walker": (Kind.PEDESTRIAN, (0.8, 1.6), 0.6, 0.6),
    "cyclist": (Kind.BICYCLE, (3.0, 5.0), 1.8, 0.6),
}
START_MPS2 = 2.0  # with which they start
CROSSING_M = (35.0, 70.0)  # from the ego to where they cross
KERB_M = (4.0, 12.0)  # from the ego's way to where they wait
EARLY_S = (-1.0, 1.0)  # by how much the ego is farther than they take to the middle of its way
ARRIVAL_MPS = 8.0  # least speed with which the ego is expected at a stop line
LINE_M = (15.0, 90.0)  # from the ego to a stop line
AMBER_S = (3.0, 5.0)  # before the ego is expected at which it turns amber; red is 3 s later
PACES = (0.6, 0.8, 1.25, 1.5)  # of the recorded speed, of who merges or crosses
LATER_S = 15.0  # most by which signals change at another time
SEVERITY = 0.5  # of recorded events: the criticality target of one of their measures
Candidate = dict[str, Any]


def candidates(scenario: Scenario, ego: int, random: np.random.Generator) -> Iterator[tuple[str, Candidate]]:
    """Yields what may happen to an ego in generated traffic, by kind."""
    yield from _of_vehicles(scenario, ego)
    if scenario.signals is not None:
        yield from _of_walkers(scenario, ego, random)
        yield from _of_lights(scenario, ego, random)


def _of_vehicles(scenario: Scenario, ego: int) -> Iterator[tuple[str, Candidate]]:
    log, row, first = scenario.log, scenario.log.row(ego), scenario.history_steps
    steps = np.arange(first + 5, first + 70)
    steps = steps[log.valid[row, steps]]
    around = agents_by_act(scenario.around(ego, None), log, steps) if len(steps) else {}
    for agent, there in list(around.get("brake", {}).items())[:1]:
        at = int(there[len(there) // 3])
        kind = "queue" if log.speed[row, at] < JAM_MPS else "brake"
        yield kind, changed(act("brake", agent, at, LONG_S, NEAR_S, deceleration=HARD_MPS2))
    ramp = from_ramp(log, scenario.lane_map)
    for agent, there in around.get("cut_in", {}).items():
        ahead = Places.of(log, np.full(len(there), row), there).ahead[log.row(agent)]
        left = headways(ahead, log.length[log.row(agent)], log.length[row], log.speed[row, there])
        near = there[(left >= ROOM_S[0]) & (left <= ROOM_S[1])]
        if len(near):
            kind = "merge" if agent in ramp else "cut_in"
            yield kind, changed(act("cut_in", agent, int(near[0]), 2.0) | {"headway_s": [*ROOM_S]})
    leaders = list(around.get("cut_out", {}).items())[:2]
    if len(leaders) == 2:
        (leader, there), (second, _) = leaders
        at = int(there[len(there) // 3])
        stops = act("brake", second, at, LONG_S, NEXT_S, deceleration=HARD_MPS2)
        yield "cut_out", changed(stops, act("cut_out", leader, at + 15, 2.0, NEAR_S))


def _of_walkers(scenario: Scenario, ego: int, random: np.random.Generator) -> Iterator[tuple[str, Candidate]]:
    """Yields who waits at the kerb to the right of the ego's straight way, and crosses when the ego comes."""
    log, row, first = scenario.log, scenario.log.row(ego), scenario.history_steps
    steps = np.arange(first, log.last_step[row])
    way = np.cumsum(log.speed[row, steps]) * STEP_S
    for name, (kind, speeds, *_) in WALKERS.items():
        far, speed, early = (random.uniform(*between) for between in (CROSSING_M, speeds, EARLY_S))
        if not len(way) or way[-1] < far:
            continue
        step = int(steps[way.searchsorted(far)])
        x, y, yaw = (float(values[row, step]) for values in (log.x, log.y, log.yaw))
        right = np.array([np.sin(yaw), -np.cos(yaw)])
        aside = np.arange(*KERB_M, 0.5)
        off = ~scenario.lane_map.inside_road(x + right[0] * aside, y + right[1] * aside)
        if abs(np.sin(yaw - log.yaw[row, first])) > 0.2 or not off.any():
            continue
        kerb = float(aside[off.argmax()]) + 0.5
        if _others_pass(scenario, row, step, kerb):
            continue
        walks = {
            "kind": kind.name.lower(),
            "x": x + kerb * right[0],
            "y": y + kerb * right[1],
            "yaw": yaw + 0.5 * np.pi,
        }
        near = max(0.5, round(kerb / speed + 0.5 * speed / START_MPS2 + early, 1))
        agent = int(scenario.recording.columns["vehicle_id"].max()) + 1
        crosses = {"kind": "cross", "agent": agent, "begin_s": round(first * STEP_S, 1), "speed": round(speed, 1)}
        yield name, {"walker": _rounded(walks)} | changed(crosses | {"headway_s": [0.0, near]})


def _others_pass(scenario: Scenario, row: int, step: int, kerb: float) -> bool:
    """Returns whether another vehicle is where one walks from the kerb to the ego's way, about when the ego comes."""
    log, steps = scenario.log, np.arange(max(0, step - 45), min(step + 15, scenario.total_steps))
    dx, dy = log.x[:, steps] - log.x[row, step], log.y[:, steps] - log.y[row, step]
    ahead, left = to_body(dx, dy, np.full(dx.shape, log.yaw[row, step]))
    there = log.valid[:, steps] & (np.abs(ahead) < 4.0) & (left > -kerb - 1.0) & (left < 2.5)
    there[row] = False
    return bool(there.any())


def _of_lights(scenario: Scenario, ego: int, random: np.random.Generator) -> Iterator[tuple[str, Candidate]]:
    """Yields lights that are red, or turn amber, where the ego comes first to the stop line; and late ones."""
    if ego in _passing(scenario):
        yield "stale lights", changed({"kind": "signals", "later_s": 5.0})
    signals, log, row, first = scenario.signals, scenario.log, scenario.log.row(ego), scenario.history_steps
    assert signals is not None
    x, y, speed = (float(values[row, first]) for values in (log.x, log.y, log.speed))
    place = Places.of(log, np.array([row]), np.array([first]))
    for link, group in zip(signals.links, signals.link_group.tolist(), strict=True):
        far = _ahead_on(scenario, link, x, y, float(log.yaw[row, first]))
        if not LINE_M[0] < far < LINE_M[1] or (place.leading[:, 0] & (place.ahead[:, 0] < far + 5.0)).any():
            continue
        arrives = first + round(far / max(speed, ARRIVAL_MPS) / STEP_S)
        states = signals.states[group]
        if arrives >= len(states):
            continue
        if states[arrives] in STOP_STATES and states[arrives - 10] in STOP_STATES:
            yield "red light", changed()
        (turns,) = ((states[:-1] == SignalState.GREEN) & (states[1:] == SignalState.AMBER)).nonzero()
        for step in turns[:1].tolist():
            later = round((arrives - step - 1) * STEP_S - random.uniform(*AMBER_S), 1)
            if abs(later) <= LATER_S:
                yield "amber light", changed({"kind": "signals", "later_s": later})


def _ahead_on(scenario: Scenario, link: SignalLink, x: float, y: float, yaw: float) -> float:
    """Returns how far a link's stop line is ahead of a vehicle on its lane [m]; NaN if it is none of its way on."""
    at = scenario.lane_map.nearest(np.array([x]), np.array([y]), np.array([yaw]))
    lane = scenario.lane_map.lanes[int(at.lane[0])]
    return float("nan") if link.turns or lane.id != link.from_lane else lane.length - float(at.s[0])


@lru_cache(maxsize=1)
def _passing(scenario: Scenario) -> set[int]:
    """Returns the agents that pass a stop line."""
    assert scenario.signals is not None
    steps = scenario.log.replay(scenario.total_steps).after(scenario.history_steps)
    return {passage.agent for passage in passages(scenario.signals, steps)}


def encounters(scenario: Scenario) -> Iterator[tuple[str, int, Candidate]]:
    """Yields merges, turns and crossings, the other of each at another pace."""
    for event in mine(scenario, (EventKind.MERGE, EventKind.CROSSING, EventKind.LEFT_TURN)):
        if event.other is not None:
            kind = "merge" if event.kind == EventKind.MERGE else "turn"
            for factor in PACES:
                begin = max(scenario.history_steps, event.step - 40)
                yield kind, event.ego, changed(act("pace", event.other, begin, 5.0, factor=factor))


def recorded(scenario: Scenario) -> Iterator[tuple[int, Candidate]]:
    """Yields egos of recorded conflicts, as they were: events that reach the criticality target of a measure."""
    kinds = set(EventKind) - {EventKind.FOLLOWING, EventKind.TURN}
    worst: dict[int, str] = {}
    for event in sorted(mine(scenario, kinds), key=lambda event: -event.severity):
        if event.severity >= SEVERITY:
            worst.setdefault(event.ego, str(event.kind))
    for ego, kind in sorted(worst.items()):
        yield ego, {"event": kind}


def act(kind: str, agent: int, step: int, duration_s: float, within_s: float = 0.0, **more: float) -> dict[str, Any]:
    """Returns a change of a scenario; with `within_s` it waits until the ego's headway is less."""
    near = {"headway_s": [0.0, within_s]} if within_s else {}
    return {"kind": kind, "agent": agent, "begin_s": round(step * STEP_S, 1), "duration_s": duration_s, **more, **near}


def changed(*changes: Mapping[str, Any]) -> Candidate:
    """Returns a candidate with changes."""
    return {"changes": [dict(change) for change in changes]}


def _rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value if isinstance(value, str) else round(float(value), 3) for name, value in values.items()}
