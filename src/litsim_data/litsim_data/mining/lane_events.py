"""Events across lanes: cut-in, cut-out, lane change of the ego, and merging from a ramp."""

from __future__ import annotations

from collections.abc import Iterator

from litsim_data.mining.events import HEADWAY_MAX_S, Event, EventKind, Number, Situation, severity
from litsim_data.mining.lane_changes import LaneChange
from litsim_data.mining.lane_tracks import NOWHERE
from litsim_sim.core.scene import STEP_S

CREEP = 1.0  # [m/s] lower bound on the ego's speed in headways
AROUND = round(3.0 / STEP_S)  # steps around a cut-in without another lane change of the intruder
ORIGIN_M = 300.0  # [m] distance upstream within which the roads that lead to a lane are searched for

R157_BRAKING, R157_DELAY = 6.0, 0.35  # [m/s2], [s] UN Regulation 157: of the TTC above which a cut-in must be avoided


def cut_ins(situation: Situation) -> Iterator[Event]:
    """Yields cut-ins: a vehicle becomes the leader of an ego that keeps its lane, by its one lane change within 3 s."""
    leader = situation.following.leader
    for change in situation.changes:
        if _again(situation, change):
            continue
        for ego in situation.followers(change.agent, change.cross).tolist():
            new = leader[ego, change.cross - 1] != change.agent
            if new and _keeps_lane(situation, ego, change) and _near(situation, ego, change.cross):
                yield _cut_in(situation, change, ego)


def cut_outs(situation: Situation) -> Iterator[Event]:
    """Yields cut-outs: the leader of an ego that keeps its lane changes lanes and reveals the vehicle ahead of it."""
    following = situation.following
    for change in situation.changes:
        shown = int(following.leader[change.agent, change.cross - 1])
        for ego in situation.followers(change.agent, change.cross - 1).tolist():
            if shown == NOWHERE or int(following.leader[ego, change.cross]) != shown:
                continue
            if not (_keeps_lane(situation, ego, change) and _near(situation, ego, change.cross - 1)):
                continue
            numbers, worst = _gap(situation, ego, change.cross)
            ttc_min = situation.ttc_after(ego, change.cross, change.cross)
            numbers["ttc_min_s"] = ttc_min
            numbers["leader_ttc_min_s"] = situation.ttc_min(change.agent, change.begin, change.cross - 1)
            numbers["leader_id"] = int(situation.log.ids[change.agent])
            size = max(worst, severity(ttc=ttc_min))
            yield situation.event(EventKind.CUT_OUT, ego, shown, change.steps, size, numbers)


def lane_change_events(situation: Situation) -> Iterator[Event]:
    """Yields lane changes of the ego, between a new leader and a new follower, if any."""
    return (_own_change(situation, change, EventKind.LANE_CHANGE) for change in situation.changes)


def lane_merges(situation: Situation) -> Iterator[Event]:
    """Yields merges: a vehicle changes from a lane of a smaller road, such as a ramp, to one of a larger road.

    Gives one event for the merging vehicle, and one for its new follower.
    """
    for change in situation.changes:
        if not _merging(situation, change):
            continue
        yield _own_change(situation, change, EventKind.MERGE, {"role": "merging"})
        for ego in situation.followers(change.agent, change.cross)[:1].tolist():
            if _near(situation, ego, change.cross) and _keeps_lane(situation, ego, change):
                yield _cut_in(situation, change, ego, EventKind.MERGE, {"role": "merged ahead of"})


def _cut_in(
    situation: Situation,
    change: LaneChange,
    ego: int,
    kind: EventKind = EventKind.CUT_IN,
    more: dict[str, Number] | None = None,
) -> Event:
    cross = change.cross
    numbers, worst = _gap(situation, ego, cross)
    closing, ttc_min = float(situation.following.closing[ego, cross]), situation.ttc_after(ego, cross, cross)
    numbers |= {"ttc_min_s": ttc_min, "from": "right" if change.left else "left"}
    if closing > 0.0:
        avoidable = situation.ttc_min(ego, cross, cross) > closing / (2.0 * R157_BRAKING) + R157_DELAY
        numbers["r157"] = "to be avoided" if avoidable else "unavoidable"
    numbers |= {"duration_s": change.duration_s} | (more or {})
    return situation.event(kind, ego, change.agent, change.steps, max(worst, severity(ttc=ttc_min)), numbers)


def _own_change(
    situation: Situation, change: LaneChange, kind: EventKind, more: dict[str, Number] | None = None
) -> Event:
    """Returns a lane change as an event of who makes it, with the more critical of its new leader and follower."""
    cross, row = change.cross, change.agent
    ahead, worst_ahead = _gap(situation, row, cross)
    numbers: dict[str, Number] = {f"ahead_{name}": value for name, value in ahead.items()}
    behind = situation.followers(row, cross)[:1].tolist()
    after, worst_behind = _gap(situation, behind[0], cross) if behind else (dict.fromkeys(ahead), 0.0)
    numbers |= {f"behind_{name}": value for name, value in after.items()}
    numbers |= {"to": "left" if change.left else "right", "duration_s": change.duration_s}
    numbers |= {"lateral_speed_mps": change.lateral_speed} | (more or {})
    other = behind[0] if behind and worst_behind > worst_ahead else int(situation.following.leader[row, cross])
    return situation.event(kind, row, other, change.steps, max(worst_ahead, worst_behind), numbers)


def _gap(situation: Situation, row: int, step: int) -> tuple[dict[str, Number], float]:
    """Measures of the agent in `row` with respect to its leader at `step`, and their severity."""
    following = situation.following
    headway, ttc = float(following.headway[row, step]), situation.ttc_min(row, step, step)
    numbers: dict[str, Number] = {
        "gap_m": following.gap[row, step],
        "closing_mps": following.closing[row, step] if following.leader[row, step] != NOWHERE else None,
        "headway_s": headway,
        "ttc_s": ttc,
    }
    return numbers, severity(ttc=ttc, headway=headway)


def _near(situation: Situation, row: int, step: int) -> bool:
    """Returns whether the leader is within a headway of 3.5 s, at the ego's speed or at least 1 m/s."""
    speed = max(float(situation.log.speed[row, step]), CREEP)
    return bool(situation.following.gap[row, step] <= HEADWAY_MAX_S * speed)


def _again(situation: Situation, change: LaneChange) -> bool:
    """Returns whether the agent makes another lane change within 3 s."""
    return any(
        other is not change and other.agent == change.agent and abs(other.cross - change.cross) <= AROUND
        for other in situation.changes
    )


def _keeps_lane(situation: Situation, row: int, change: LaneChange) -> bool:
    """Returns whether the agent in `row` makes no lane change during `change`."""
    return not any(
        other.agent == row and other.begin <= change.end and other.end >= change.begin for other in situation.changes
    )


def _merging(situation: Situation, change: LaneChange) -> bool:
    """Returns whether the old lane comes from another and smaller road than the new one."""
    left, entered = (_upstream(situation, lane) for lane in (change.from_lane, change.to_lane))
    lanes = situation.lane_map.lanes

    def size(edges: set[str]) -> int:
        return max((sum(lane.edge_id == edge for lane in lanes) for edge in edges), default=0)

    return bool(left - entered) and 0 < size(left - entered) < size(entered - left)


def _upstream(situation: Situation, lane: int) -> set[str]:
    """Returns ids of the edges that lead to a lane without lane changes, within 300 m upstream."""
    lanes = situation.lane_map.lanes
    waiting, edges, visited = [(lane, 0.0)], set[str](), set[int]()
    while waiting:
        here, way = waiting.pop()
        for before in situation.ways.predecessors[here]:
            if before in visited:
                continue
            visited.add(before)
            if not lanes[before].is_internal:
                edges.add(lanes[before].edge_id)
            if way + lanes[before].length < ORIGIN_M:
                waiting.append((before, way + lanes[before].length))
    return edges
