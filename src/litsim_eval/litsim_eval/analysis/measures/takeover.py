"""The ledger of takeovers: their reasons, what pure replay would have led to, and how agents returned to their logs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from litsim_eval.analysis.measure import (
    LOWER,
    MEAN_CONTROLLED,
    SUM_CONTROLLED,
    Branch,
    Count,
    Listed,
    Measure,
    Metrics,
    Row,
    Share,
    Table,
    family,
    figure_at,
    largest,
    mean,
    share_of,
    total,
)
from litsim_eval.analysis.measures.collision import collisions
from litsim_eval.analysis.measures.realism import roi_of
from litsim_policy.conflict.config import ConflictConfig
from litsim_sim.core.dynamics import SPEED_MIN, VehicleLimits
from litsim_sim.core.geometry import overlapping_pairs, to_body, wrap_angle
from litsim_sim.core.scene import AgentTable, BoolArray, Controller
from litsim_sim.core.steps import Steps
from litsim_sim.core.takeover import Takeover, TakeoverState
from litsim_sim.record.run import Run

SETTLED = 1e-3  # [m] distance from the log below which the return is over
BACK_WITHIN = 1.0  # [m] of the log, lag included, within which a released agent is back on it
SETTLING_MAX = 100  # longest return that is examined [steps]


Episode = list[tuple[int, Takeover]]
"""The first record of a takeover, those at which its state changes, and the last, each with its step."""


class TakeoverOutcome(StrEnum):
    """How a takeover ended."""

    BACK_ON_LOG = "back_on_log"
    OFF_LOG = "off_log"  # released more than BACK_WITHIN from its log
    LOG_OVER = "log_over"  # released, and removed at the end of its log
    LEFT_NET = "left_net"  # removed under control: it left the net after the end of its log
    OUTLIVED_LOG = "outlived_log"  # under control at the last step, after the end of its log
    OWN_INTENT = "own_intent"  # driving by its own intent at the last step: no conflict, but a log that is too fast


class Place(StrEnum):
    """How the opponent lies and heads as the agent sees it, at the detection: the kind of an encounter."""

    AHEAD = "ahead"  # heading within 45 degrees of the agent's, in its strip
    BEHIND = "behind"
    BESIDE = "beside"  # likewise, in another strip, as in the next lane
    CROSSING = "crossing"
    ONCOMING = "oncoming"  # more than 135 degrees


@dataclass(frozen=True)
class LedgerEntry:
    """One takeover, from detection to release; a row of `takeovers.parquet` and of `ledger` in `metrics.json`.

    Attributes:
        agent: id of the agent taken over.
        opponent: id of the other agent of the predicted overlap.
        opponent_place: where that is at the detection; None if either is missing, or the record lacks that step.
        reason: name of a :class:`TakeoverReason`, in small letters.
        detected_step: step of the detection.
        own_intent_step: first step of driving by its own intent, if the takeover ended so; else None.
        handback_step: first step of the handback; None without one.
        released_step: last step off the log; None if the run or the agent's presence ended before.
        outcome: how the takeover ended; None if the run ended first, before the log.
        held_s: time from the detection to the first step on the log again, or to the last step of the run [s].
        time_to_conflict_s: predicted at detection [s]; None for other reasons than a conflict, which are not predicted.
        overlap_probability: predicted at detection; None likewise.
        log_collision_predicted: whether the log itself led into the opponent's forecast.
        replay_would_collide: whether pure replay of this agent after the detection, with the lag of its last takeover,
            would have had a contact with the ego, or with another agent off its log or on it with a lag, as they
            actually moved.
        replay_step, replay_opponent: step and other agent of the first such contact; None without one.
        least_log_ratio: the least logarithm of how much less likely a person would do what the log does, compared with
            the recorded scene; see ``litsim_msgs/Takeover``.
        false_alarm: whether a predicted conflict is the reason, and the agent could have stayed on its log: it would
            have hit nobody, and its log never became unlikely.
        residual_m: distance from the log, delayed by its lag, at the last step of the takeover [m]; None if the log is
            over by then.
        residual_mps: speed minus that of the delayed log at the last step of the takeover [m/s]; None likewise.
        time_shift_s: lag of the log at the last step of the takeover [s].
        ego_distance_m: distance between the centres of agent and ego at the detection [m]; None if the ego is gone, or
            the recording lacks that step.
    """

    agent: int
    opponent: int
    opponent_place: Place | None
    reason: str
    detected_step: int
    own_intent_step: int | None
    handback_step: int | None
    released_step: int | None
    outcome: TakeoverOutcome | None
    held_s: float
    time_to_conflict_s: float | None
    overlap_probability: float | None
    log_collision_predicted: bool
    replay_would_collide: bool
    replay_step: int | None
    replay_opponent: int | None
    least_log_ratio: float
    false_alarm: bool
    residual_m: float | None
    residual_mps: float | None
    time_shift_s: float
    ego_distance_m: float | None


class Jump(NamedTuple):
    """The part of an agent's motion over one step that its speeds and the vehicle limits do not explain.

    Attributes:
        position: distance between the actual position and that reached with the mean velocity [m].
        speed: change beyond the strongest braking or acceleration [m/s].
        yaw: change beyond the tightest turn at this speed [rad].
    """

    position: float = 0.0
    speed: float = 0.0
    yaw: float = 0.0


class Handback(NamedTuple):
    """One return to the log, which is replayed from then on with the lag that the takeover left.

    Attributes:
        residual: distance from the delayed log at the last step under control [m]; None without a logged pose there.
        jump: componentwise largest jump from that step until the agent is on its log again.
        log_jump: the same for the delayed log over the same steps: the noise of the recording.
    """

    residual: float | None
    jump: Jump
    log_jump: Jump


def ledger(run: Run) -> list[LedgerEntry]:
    """Returns the takeovers of a run, sorted by step of detection and agent."""
    episodes = list(_episodes(run))
    contacts = _replay_contacts(run, episodes)
    least = _least_log_ratios(run)
    entries = (
        _entry(run, episode, contact, least[episode[0][1].agent, episode[0][1].detected_step])
        for episode, contact in zip(episodes, contacts, strict=True)
    )
    return sorted(entries, key=lambda entry: (entry.detected_step, entry.agent))


def _replay_contacts(run: Run, episodes: Sequence[Episode]) -> list[tuple[int, int] | None]:
    """Returns the first contact that pure replay of each taken agent would have had, as step and other agent.

    The agent follows its log after the detection, with the lag that its last takeover left. Contacts count with agents
    that are not where their own logs have them then; None stands for no contact.
    """
    contacts: list[tuple[int, int] | None] = [None] * len(episodes)
    if not (run.log and episodes):
        return contacts
    replays, lags = [], dict[int, int]()
    for (_, first), (_, last) in ((episode[0], episode[-1]) for episode in episodes):
        replays.append((first.agent, first.detected_step, lags.get(first.agent, 0)))
        lags[first.agent] = round(last.time_shift / run.info.dt)
    logged = run.logged.only({agent for agent, _, _ in replays})
    tracks = [logged.track(agent) for agent, _, _ in replays]
    whose = np.repeat(np.arange(len(replays)), list(map(len, tracks)))
    _, after, lag = np.array(replays, np.int64).T
    track = np.concatenate(tracks)
    shown = logged.step[logged.stacked.number[track]] + lag[whose]  # step of the run
    for begin, end in run.simulated.blocks():
        steps, log = run.simulated.part(begin, end), run.simulated_log.part(begin, end)
        number = np.minimum(steps.step.searchsorted(shown), len(steps) - 1)
        replayed = (steps.step[number] == shown) & (shown > after[whose])
        row, which, number = track[replayed], whose[replayed], number[replayed]
        ghosts, movers = logged.stacked.take(row), steps.stacked.take(_away_from_log(steps, log))
        x, y, yaw, length, width = (
            np.concatenate([getattr(ghosts, n), getattr(movers, n)]) for n in ("x", "y", "yaw", "length", "width")
        )
        pairs = overlapping_pairs(x, y, yaw, length, width, np.concatenate([number, movers.number]))
        for i, k in pairs[(pairs[:, 0] < len(ghosts)) & (pairs[:, 1] >= len(ghosts))].tolist():
            other = int(movers.id[k - len(ghosts)])
            if contacts[which[i]] is None and ghosts.id[i] != other:
                contacts[which[i]] = int(steps.step[number[i]]), other
    return contacts


def _away_from_log(steps: Steps, logged: Steps) -> BoolArray:
    """Returns (m,) whether each row of `steps` is of an agent off its log, or on it with a visible lag."""
    table, log = steps.stacked, logged.stacked
    then = logged.rows_at(table.number, table.id)
    there = then >= 0
    apart = np.full(len(table), np.inf)
    apart[there] = np.hypot(table.x[there] - log.x[then[there]], table.y[there] - log.y[then[there]])
    return np.asarray(table.off_log | (apart > SETTLED))


def handbacks(run: Run) -> list[Handback]:
    """Returns to the log, by step: an agent is under POLICY at one step and under LOG at the next."""
    returns = []
    for begin, end in run.steps.blocks():
        steps = run.steps.part(begin, end + 1)  # an agent is back at the step after
        table = steps.stacked
        held = np.flatnonzero(table.of_policy & (table.number < min(end - begin, len(steps) - 1)))
        held = held[steps.follows[table.number[held] + 1]]
        after = steps.rows_at(table.number[held] + 1, table.id[held])
        back = held[(after >= 0) & (table.controller[after] == Controller.LOG)]
        pairs = zip((begin + table.number[back]).tolist(), table.id[back].tolist(), strict=True)
        returns += [_handback(run, index, agent) for index, agent in pairs]
    return returns


def jump(before: AgentTable, after: AgentTable, agent: int, dt: float) -> Jump:
    """Returns the jump of `agent` between consecutive steps `dt` [s] apart, by the limits of the vehicle model."""
    i, j = before.row(agent), after.row(agent)
    limits = VehicleLimits()
    v0, v1 = (
        np.array([np.cos(table.yaw[row]), np.sin(table.yaw[row])]) * table.speed[row]
        for table, row in ((before, i), (after, j))
    )
    moved = np.array([after.x[j] - before.x[i], after.y[j] - before.y[i]])
    faster = float(after.speed[j] - before.speed[i])
    mean_speed = 0.5 * float(before.speed[i] + after.speed[j])
    turning = min(mean_speed * limits.curvature_max, limits.lateral_acceleration_max / max(mean_speed, SPEED_MIN))
    turned = abs(float(wrap_angle(after.yaw[j] - before.yaw[i])))
    return Jump(
        position=float(np.hypot(*(moved - 0.5 * (v0 + v1) * dt))),
        speed=max(0.0, faster - limits.acceleration_max * dt, -faster - limits.deceleration_max * dt),
        yaw=max(0.0, turned - turning * dt),
    )


def _episodes(run: Run) -> Iterator[Episode]:
    """Yields the records of each takeover: of one agent and one step of detection, up to its release.

    Steps that the recording lacks do not end one.
    """
    open_episodes: dict[int, Episode] = {}
    for step in sorted(run.takeovers):
        records = {record.agent: record for record in run.takeovers[step]}
        detected = {agent: record.detected_step for agent, record in records.items()}
        for agent in [a for a, e in open_episodes.items() if detected.get(a) != e[-1][1].detected_step]:
            yield open_episodes.pop(agent)
        for agent, record in records.items():
            episode = open_episodes.setdefault(agent, [])
            if len(episode) > 1 and episode[-1][1].state == episode[-2][1].state == record.state:
                episode.pop()
            episode.append((step, record))
            if record.state == TakeoverState.RELEASED:
                yield open_episodes.pop(agent)
    yield from open_episodes.values()


def _least_log_ratios(run: Run) -> dict[tuple[int, int], float]:
    """Returns the least log-ratio of each takeover, by agent and step of detection."""
    least: dict[tuple[int, int], float] = {}
    for records in run.takeovers.values():
        for record in records:
            key = record.agent, record.detected_step
            least[key] = min(least.get(key, 0.0), record.log_ratio)
    return least


def _entry(run: Run, episode: Episode, contact: tuple[int, int] | None, least: float) -> LedgerEntry:
    (first_step, first), (last_step, last) = episode[0], episode[-1]
    released = last.state == TakeoverState.RELEASED
    logged = last.residual_position >= 0  # -1 stands for no logged pose
    step, opponent = contact or (None, None)
    return LedgerEntry(
        agent=first.agent,
        opponent=first.opponent,
        opponent_place=_opponent_place(run, first),
        reason=first.reason.name.lower(),
        detected_step=first.detected_step,
        own_intent_step=_own_intent_step(episode),
        handback_step=next((step for step, record in episode if record.state == TakeoverState.HANDBACK), None),
        released_step=last_step if released else None,
        outcome=_outcome(run, last, last_step),
        held_s=round((min(last_step + 1, run.tables[-1].step) - first_step) * run.info.dt, 6),
        time_to_conflict_s=first.time_to_conflict if first.predicted else None,
        overlap_probability=first.overlap_probability if first.predicted else None,
        log_collision_predicted=bool(first.log_collision_predicted),
        replay_would_collide=contact is not None,
        replay_step=step,
        replay_opponent=opponent,
        least_log_ratio=least,
        false_alarm=contact is None and first.predicted and least >= -ConflictConfig().unlikely,
        residual_m=last.residual_position if logged else None,
        residual_mps=last.residual_speed if logged else None,
        time_shift_s=last.time_shift,
        ego_distance_m=_ego_distance(run, first.agent, first.detected_step),
    )


def _ego_distance(run: Run, agent: int, step: int) -> float | None:
    """Returns the distance [m] between the centres of `agent` and the ego at `step`; None if either is missing."""
    if (pair := _both(run, step, agent, run.info.ego_id)) is None:
        return None
    return float(np.hypot(pair.x[0] - pair.x[1], pair.y[0] - pair.y[1]))


def _opponent_place(run: Run, first: Takeover) -> Place | None:
    """Returns where the opponent of a takeover is at its detection, `first`; None if either agent is missing."""
    if (pair := _both(run, first.detected_step, first.agent, first.opponent)) is None:
        return None
    (ahead,), (left,) = to_body(np.diff(pair.x), np.diff(pair.y), pair.yaw[:1])
    turned = abs(float(wrap_angle(pair.yaw[1] - pair.yaw[0])))
    if turned > 0.25 * np.pi:
        return Place.ONCOMING if turned > 0.75 * np.pi else Place.CROSSING
    if abs(left) >= 0.5 * pair.width.sum():
        return Place.BESIDE
    return Place.AHEAD if ahead > 0.0 else Place.BEHIND


def _both(run: Run, step: int, agent: int, other: int) -> AgentTable | None:
    """Returns the two agents at `step`, in this order; None if either is missing."""
    row = int(run.steps.step.searchsorted(step))
    if row == len(run.tables) or run.tables[row].step != step:
        return None
    rows = run.tables[row].rows(np.array([agent, other]))
    return run.tables[row].take(rows) if rows.min() >= 0 else None


def _own_intent_step(episode: Episode) -> int | None:
    """Returns the first step of the state with which `episode` ends, if that is driving by the own intent."""
    begin = None
    for step, record in episode:
        own = record.state == TakeoverState.OWN_INTENT
        begin = (step if begin is None else begin) if own else None
    return begin


def _outcome(run: Run, last: Takeover, last_step: int) -> TakeoverOutcome | None:
    """Returns the outcome of the takeover with its `last` record at `last_step`."""
    agent, released = last.agent, last.state == TakeoverState.RELEASED
    on_log = TakeoverOutcome.BACK_ON_LOG if last.residual_position <= BACK_WITHIN else TakeoverOutcome.OFF_LOG
    after = int(run.steps.step.searchsorted(last_step, "right"))
    if after == len(run.steps):
        if last.state == TakeoverState.OWN_INTENT:
            return TakeoverOutcome.OWN_INTENT
        outlived = bool(run.log) and run.log[-1].row(agent) < 0
        return on_log if released else TakeoverOutcome.OUTLIVED_LOG if outlived else None
    there = run.steps[after].row(agent) >= 0
    if released:
        return on_log if there else TakeoverOutcome.LOG_OVER
    return None if there else TakeoverOutcome.LEFT_NET


def _handback(run: Run, index: int, agent: int) -> Handback:
    """Returns the return of `agent`, with its last step under control in the table at `index`."""
    at_end = run.takeovers.get(run.tables[index].step, ())  # of its takeover, 0 if none was recorded
    lag = round(next((t.time_shift for t in at_end if t.agent == agent), 0.0) / run.info.dt)
    jumps, noise = [], []
    for k in range(index, min(index + SETTLING_MAX, len(run.tables) - 1)):
        before, after = run.tables[k], run.tables[k + 1]
        row = after.row(agent)
        if row < 0 or after.controller[row] != Controller.LOG or not run.steps.follows[k + 1]:
            break
        jumps.append(jump(before, after, agent, run.info.dt))
        logged = _logged(run, k, agent, lag), _logged(run, k + 1, agent, lag)
        if logged[0] is not None and logged[1] is not None:
            noise.append(jump(logged[0], logged[1], agent, run.info.dt))
        apart = _from_log(run, k + 1, agent, lag)
        if apart is not None and apart < SETTLED:
            break
    return Handback(_from_log(run, index, agent, lag), _largest(jumps), _largest(noise))


def _largest(jumps: Iterable[Jump]) -> Jump:
    """Returns the componentwise maximum of jumps, 0 without any."""
    return Jump(*map(max, zip(Jump(), *jumps, strict=True)))


def _logged(run: Run, index: int, agent: int, lag: int) -> AgentTable | None:
    """Returns the log `lag` steps before the table at `index`; None if it is missing or lacks `agent`."""
    row = index - lag
    if not run.log or row < 0 or run.log[row].step != run.tables[index].step - lag:
        return None
    return run.log[row] if run.log[row].row(agent) >= 0 else None


def _from_log(run: Run, index: int, agent: int, lag: int) -> float | None:
    """Returns the distance [m] of `agent` in the table at `index` from its log `lag` steps before; None if unknown."""
    logged, table = _logged(run, index, agent, lag), run.tables[index]
    if logged is None or table.row(agent) < 0:
        return None
    i, j = table.row(agent), logged.row(agent)
    return float(np.hypot(table.x[i] - logged.x[j], table.y[i] - logged.y[j]))


def _share_taken_over(run: Run, within: float | None = None) -> float | None:
    """Returns the share of the background that is taken over, `within` so many metres of the ego, if given."""
    background = run.once(collisions).agents - {run.info.ego_id}
    taken_over = {
        entry.agent
        for entry in run.once(ledger)
        if within is None or (entry.ego_distance_m is not None and entry.ego_distance_m <= within)
    }
    return share_of(len(taken_over & background), len(background))


@Branch
def handback(run: Run) -> dict[str, Any]:
    """Returns the number of returns to the log, their residuals, and the largest jumps in the run and in the log."""
    back = handbacks(run)
    jumps, noise = (_largest(own) for own in ((entry.jump for entry in back), (entry.log_jump for entry in back)))
    residuals = [entry.residual for entry in back if entry.residual is not None]
    return {
        "count": len(back),
        "max_position_jump_m": jumps.position,
        "max_speed_jump_mps": jumps.speed,
        "max_yaw_jump_rad": jumps.yaw,
        "residual_m": float(np.mean(residuals)) if residuals else None,
        "max_residual_m": max(residuals, default=None),
        "log_position_jump_m": noise.position,
        "log_speed_jump_mps": noise.speed,
        "log_yaw_jump_rad": noise.yaw,
    }


def _released(run: Metrics) -> float:
    return sum(entry["released_step"] is not None for entry in run["ledger"])


def _false_alarms(place: Place) -> Callable[[Metrics], float]:
    """Returns the number of false alarms for opponents at `place`, as a figure of a run."""
    return lambda run: sum(entry.get("opponent_place") == place and entry["false_alarm"] for entry in run["ledger"])


def _by_own_intent(run: Metrics) -> float:
    return sum(entry["outcome"] == TakeoverOutcome.OWN_INTENT for entry in run["ledger"])


def _held_to_the_end(run: Metrics) -> float:
    return sum(entry["released_step"] is None and entry["outcome"] is None for entry in run["ledger"])


def _held_s(run: Metrics) -> float:
    return sum(entry["held_s"] for entry in run["ledger"])


PER_RUN = Row(
    *("takeovers_per_run", mean), title="takeovers per run", figure=lambda run: float(run["takeovers"]), of_control=True
)
OF_LEDGER = (
    Row("releases", title="handed back to their logs", figure=_released, of_control=True),
    Row(
        *("released_share", total, Table.SIMULATION, "share handed back"),
        figure=_released,
        below=figure_at("takeovers"),
        share=True,
        of_control=True,
    ),
    Row("own_intent", title="by their own intent at the end", figure=_by_own_intent, of_control=True),
    Row("releases_missing", title="held to the end of the run", figure=_held_to_the_end, of_control=True),
    Row("held_s", title="time under control", unit="s", figure=_held_s, of_control=True),
    *(
        Row(f"false_alarms_{place}", title=f"false alarms, other {place}", figure=_false_alarms(place), of_control=True)
        for place in Place
    ),
)
LARGEST = (Row(over=largest, of_control=True),)
CUT_SHORT = (Row(title="steps cut short in detection", of_control=True),)
MEASURES = family(
    "agents taken over, divided by agents; the same for takeovers that began within `roi_m` of the ego",
    Share("relevant_ratio", _share_taken_over, "taken over", rows=MEAN_CONTROLLED),
    Share("relevant_ratio_roi", lambda run: _share_taken_over(run, roi_of(run)), "taken over near the ego"),
    "takeovers; those whose log would have hit nobody",
    Count("takeovers", lambda run: len(run.once(ledger)), "takeovers", rows=(*SUM_CONTROLLED, PER_RUN)),
    Count(
        *("false_alarms", lambda run: sum(entry.false_alarm for entry in run.once(ledger)), "false alarms", "", LOWER),
        rows=SUM_CONTROLLED,
    ),
    "the most iterations of detection within a step; steps at which their bound was hit",
    Count(
        "detection.max_iterations",
        lambda run: max((detection.iterations for detection in run.detections.values()), default=0),
    ),
    Count(
        *("detection.bound_hits", lambda run: sum(not detection.converged for detection in run.detections.values())),
        better=LOWER,
        rows=CUT_SHORT,
    ),
    "every [takeover](#series-and-takeovers)",
    Listed("ledger", lambda run: [asdict(entry) for entry in run.once(ledger)], rows=OF_LEDGER),
    "hand-backs to the log, [lag included](conflicts.md#hand-back): their number; the largest jump of position, speed "
    "and heading until the agent is on its log; mean and largest residual; the jumps of the log itself in that time",
    Count("handback.count", handback, "hand-backs"),
    Measure("handback.max_position_jump_m", handback, "largest jump", "m", LOWER, rows=LARGEST),
    Measure("handback.max_speed_jump_mps", handback, "", "m/s", LOWER),
    Measure("handback.max_yaw_jump_rad", handback, "", "rad", LOWER),
    Measure("handback.residual_m", handback, "", "m", LOWER),
    Measure("handback.max_residual_m", handback, "largest distance at return", "m", LOWER, rows=LARGEST),
    Measure("handback.log_position_jump_m", handback, unit="m"),
    Measure("handback.log_speed_jump_mps", handback, unit="m/s"),
    Measure("handback.log_yaw_jump_rad", handback, unit="rad"),
)
