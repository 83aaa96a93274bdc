"""The clauses of the ego port's contract, each judged independently; a fault is reported by one clause only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from litsim_eval.check_ads.trace import FINISHED, Evidence, Heard
from litsim_sim.core.errors import printable, shown
from litsim_sim.core.geometry import wrap_angle
from litsim_sim.core.scene import STEP_S, EgoCommand, FloatArray
from litsim_sim.core.topic_names import EGO_INPUTS, Interface
from litsim_sim.core.vehicle import VehicleModel
from litsim_sim.ego_port.answer import BODY_FRAMES, MAP_FRAME, Answer, problem
from litsim_sim.ego_port.tracking import CRAWL, OFFSET_MAX, EgoState, Reference, Trajectory, TwistTarget

ALONG = np.deg2rad(60.0)  # [rad] largest angle between a heading along the road and the lane's
FRAMES_MAX = 5  # most frames that are named
STRAY = 0.05  # share of a trajectory's headings that may deviate by more
QUIET_S = 1.0  # [s] without a message, after which a stack counts as idle
SLACK = 1.05  # factor by which a demand may exceed a limit before it counts as clipped
SMALL = 1e-2  # [m/s2], [rad/s] excess that never counts as clipped


class Verdict(StrEnum):
    PASS = "pass"  # noqa: S105 - no password
    FAIL = "fail"
    OPEN = "not judged"


@dataclass(frozen=True)
class Clause:
    """The judgement of a clause: verdict, reason for people, and figures for the JSON result."""

    name: str
    verdict: Verdict
    text: str
    figures: dict[str, Any] = field(default_factory=dict)


def judge(evidence: Evidence, *, latency_ms: float = 5000.0, clipped: float = 0.1) -> list[Clause]:
    """Judges all clauses, in the order of a run.

    Args:
        evidence: on the stack.
        latency_ms: largest 95th percentile of the latency [ms].
        clipped: largest share of answers that ask for more than the vehicle can do.
    """
    clauses = (
        discovery(evidence),
        qos(evidence),
        own_topics(evidence),
        answers(evidence),
        latency(evidence, latency_ms),
        frames(evidence),
        values(evidence, clipped),
        ending(evidence),
        *([] if evidence.difference is None else [anew(evidence.difference)]),
    )
    return [replace(clause, text=printable(clause.text)) for clause in clauses]


def discovery(evidence: Evidence) -> Clause:
    """A publisher on a topic of the port is found in time."""
    name = "discovery"
    reads = sorted({endpoint.topic for endpoint in evidence.endpoints if not endpoint.publishes})
    if not evidence.discovered_s:
        hears = f"; it reads {', '.join(reads)}" if reads else ""
        topics = ", ".join(EGO_INPUTS.values())
        when = f"within {evidence.wait_s:g} s" if evidence.left is None else "before the stack left"
        return Clause(name, Verdict.FAIL, f"no publisher on {topics} {when}{hears}")
    after = {EGO_INPUTS[interface]: round(seconds, 2) for interface, seconds in evidence.discovered_s.items()}
    text = ", ".join(f"{topic} after {seconds:.1f} s" for topic, seconds in after.items())
    nodes = sorted({endpoint.node for endpoint in evidence.endpoints if endpoint.publishes})
    text += f", by {', '.join(nodes)}" if nodes else ""
    return Clause(name, Verdict.PASS, text, {"publishers_s": after, "nodes": nodes, "reads": reads})


def qos(evidence: Evidence) -> Clause:
    """Types and QoS match on all topics that the stack publishes or reads at the port."""
    name = "types and QoS"
    if not evidence.endpoints:
        return Clause(name, Verdict.OPEN, "nothing was found")
    mismatches: dict[str, str] = {}  # the first of each topic, an empty text for none
    for endpoint in sorted(evidence.endpoints, key=lambda e: e.topic):
        mismatches[endpoint.topic] = mismatches.get(endpoint.topic) or endpoint.problem
    wrong = {topic: text for topic, text in mismatches.items() if text}
    text = "; ".join(f"{topic}: {text}" for topic, text in wrong.items())
    matching = f"{len(mismatches)} topics match: {', '.join(mismatches)}"
    return _judged(
        name, wrong, text or matching, {topic: mismatch or "matches" for topic, mismatch in mismatches.items()}
    )


def own_topics(evidence: Evidence) -> Clause:
    """Nobody but the nodes of the run publishes on the graph's internal topics, the stack least of all."""
    name = "keeps to its topics"
    if not evidence.discovered_s and not evidence.intrusions:
        return Clause(name, Verdict.OPEN, "nothing was found")
    text = "; ".join(evidence.intrusions) or "no internal topic has a foreign publisher"
    return _judged(name, evidence.intrusions, text, {"found": evidence.intrusions})


def answers(evidence: Evidence) -> Clause:
    """Every step is answered once per publication, under its own stamp."""
    name = "answers every step"
    if not evidence.reachable:
        return Clause(name, Verdict.OPEN, "the bridge cannot hear the stack")
    amid = bool(evidence.intrusions and evidence.failure)  # another clause says why the run ended amid a step
    last = max(evidence.published_ns, default=-1) - amid if evidence.left is None else evidence.left - 1
    steps = range(last + 1)
    if not steps:
        return Clause(name, Verdict.OPEN, "no step was published")
    # A run does not go past a step without an answer, so the number of answered steps tells which are missing.
    heard = {answer.answer.step_answered for answer in evidence.used} & set(steps)
    missing = list(steps[max(len(heard), evidence.counts.get("answered", 0) + evidence.counts.get("invalid", 0)) :])
    repeats = sum(len(times) - 1 for times in evidence.published_ns.values())
    counts = {kind: evidence.counts.get(kind, 0) for kind in ("late", "stale", "future", "surplus", "refused")}
    faults = [f"{len(missing)} missing, first {missing[0]}"] if missing else []
    faults += [
        f"{counts[kind]} {what}"
        for kind, most, what in (
            ("stale", repeats, "stale"),
            ("future", 0, "from the future"),
            ("surplus", repeats + len(steps), "surplus, more than one per step"),
            ("refused", 0, "on a second interface"),
            ("late", 0, "late"),
        )
        if counts[kind] > most
    ]
    if evidence.failure and evidence.left is None and not amid:
        faults.append(evidence.failure)
    text = f"{len(steps) - len(missing)} of {len(steps)} steps"
    text += "" if evidence.left is None else ", until the stack left"
    figures = {"steps": len(steps), "missing": missing, "repeated_by_bridge": repeats} | counts
    return _judged(name, faults, "; ".join([text, *faults]), figures | {"run": evidence.failure})


def latencies(evidence: Evidence) -> tuple[list[int], FloatArray]:
    """Returns steps after step 0, and their latencies [ms] from the step's first publication to its first answer."""
    first: dict[int, int] = {}
    for answer in evidence.used:
        if answer.answer.step_answered is not None:
            first.setdefault(answer.step, answer.received_ns)
    steps = sorted(step for step in first.keys() & evidence.published_ns.keys() if step > 0)
    return steps, np.array([1e-6 * (first[step] - evidence.published_ns[step][0]) for step in steps], np.float64)


def latency(evidence: Evidence, limit_ms: float) -> Clause:
    """The 95th percentile of the latency is within the limit."""
    name = "latency"
    _, took = latencies(evidence)
    if not evidence.reachable or not len(took):
        return Clause(name, Verdict.OPEN, "nothing to time")
    low, median, high, most = (float(v) for v in np.percentile(took, [0, 50, 95, 100]))
    in_time = float(np.mean(took <= 1e3 * STEP_S))
    text = f"min {low:.1f}, median {median:.1f}, 95 % {high:.1f}, max {most:.1f} ms; {in_time:.0%} within a step"
    figures = {"min_ms": low, "median_ms": median, "p95_ms": high, "max_ms": most, "within_a_step": in_time}
    text += f"; expected 95 % within {limit_ms:g} ms" if high > limit_ms else ""
    return _judged(name, high > limit_ms, text, figures)


def frames(evidence: Evidence) -> Clause:
    """Frames are those of the contract; trajectories begin at the ego and lead along the road."""
    name = "frames plausible"
    if not evidence.reachable or not evidence.used:
        return Clause(name, Verdict.OPEN, "no answers")
    wrong = [answer for answer in evidence.used if not _frame_is_right(answer.answer)]
    good = [answer for answer in evidence.used if _frame_is_right(answer.answer) and not problem(answer.answer)]
    away = [(answer, offset) for answer in good if (offset := _offset(answer, evidence)) is not None]
    stray = [(answer, share) for answer in good if (share := _stray(answer.answer, evidence)) is not None]
    faults = []
    if wrong:
        faults.append(_first(wrong, f"{len(wrong)} with another frame", problem(wrong[0].answer)))
    if far := [(answer, offset) for answer, offset in away if offset > OFFSET_MAX]:
        words = f"{far[0][1]:.1f} m away, expected at most {OFFSET_MAX:g} m"
        faults.append(_first([answer for answer, _ in far], f"{len(far)} do not begin at the ego", words))
    if lost := [(answer, share) for answer, share in stray if share > STRAY]:
        words = f"{lost[0][1]:.0%} of its headings more than 60 degrees off the lane's"
        faults.append(_first([answer for answer, _ in lost], f"{len(lost)} deviate from the road's direction", words))
    used = sorted({shown(answer.answer.frame) for answer in evidence.used})[:FRAMES_MAX]
    text = f"frame {', '.join(used)}"
    if away:
        text += f"; begins at most {max(offset for _, offset in away):.2f} m from the ego"
    if stray and not lost:
        text += ", headings along the road"
    figures = {
        "frames": used,
        "wrong": len(wrong),
        "offset_max_m": max((offset for _, offset in away), default=None),
        "off_direction": len(lost),
    }
    return _judged(name, faults, "; ".join(faults) or text, figures)


def values(evidence: Evidence, limit: float) -> Clause:
    """Values are finite, in order, and within the vehicle's limits."""
    name = "values finite and feasible"
    if not evidence.reachable or not evidence.used:
        return Clause(name, Verdict.OPEN, "no answers")
    wrong: list[tuple[Heard, str]] = []
    clipped, judged = 0, 0
    for heard in evidence.used:
        answer, ego = _in_frame(heard.answer), evidence.driven(heard.step)
        if fault := problem(answer):
            wrong.append((heard, fault))
        elif ego is not None and answer.target is not None:
            judged += 1
            clipped += is_clipped(answer.target, ego, evidence.scenario.vehicle)
            offset = _offset(heard, evidence)
            if isinstance(answer.target, Trajectory) and (offset is None or offset <= OFFSET_MAX):
                fault = Reference(answer.target, ego).problem(ego, evidence.scenario.vehicle)
                wrong += [(heard, fault)] if fault else []
    share = clipped / judged if judged else 0.0
    text = f"{share:.1%} of {judged} answers beyond the vehicle's limits"
    faults = []
    if wrong:
        faults.append(_first([heard for heard, _ in wrong], f"{len(wrong)} cannot be used", wrong[0][1]))
    if share > limit:
        faults.append(f"{text}, expected at most {limit:.1%}")
    figures = {"invalid": len(wrong), "clipped": clipped, "judged": judged, "clipped_share": share}
    return _judged(name, faults, "; ".join(faults) or f"finite; {text}", figures)


def ending(evidence: Evidence) -> Clause:
    """The stack stays until the run is over, then falls silent, and does not crash."""
    name = "end of run"
    end = evidence.ending
    figures = {
        "state": evidence.state,
        "left": evidence.left,
        "exit_status": end.exit_status,
        "last_message_s": end.last_s,
    }
    if not evidence.discovered_s and evidence.left is None:
        return Clause(name, Verdict.OPEN, "nothing was found", figures)
    how = f": {end.obituary}" if end.obituary else ""
    if evidence.left is not None:
        steps = evidence.scenario.total_steps
        text = f"the stack left at step {evidence.left} of {steps}, before the run was over{how}"
        return Clause(name, Verdict.FAIL, text, figures)
    after = "after FINISHED" if evidence.state == FINISHED else "after the run had ended early"
    if end.exit_status:
        return Clause(name, Verdict.FAIL, f"{after}, the stack crashed{how}", figures)
    if end.last_s is not None and end.last_s > end.watched_s - QUIET_S:
        text = f"{after}, it still publishes {end.watched_s:.1f} s later"
        return Clause(name, Verdict.FAIL, text, figures)
    quiet = "it is silent" if end.last_s is None else f"its last message came {end.last_s:.1f} s later"
    here = "its publisher is gone" if not end.present else "its publisher is still there, idle"
    return Clause(name, Verdict.PASS, f"{after}, {quiet}; {here}{how}", figures)


def anew(difference: str) -> Clause:
    """The stack, which stays up, drives a second run as it has driven the first."""
    text = f"second run: {difference}" if difference else "a second run has the digest of the first"
    return _judged("begins anew", difference, text, {})


def _judged(name: str, faults: object, text: str, figures: dict[str, Any]) -> Clause:
    return Clause(name, Verdict.FAIL if faults else Verdict.PASS, text, figures)


def _first(heard: Sequence[Heard], what: str, why: str) -> str:
    return f"{what}, first at step {heard[0].step}: {why}"


def _frame_is_right(answer: Answer) -> bool:
    allowed: dict[Interface, tuple[str, ...]] = {Interface.TWIST: BODY_FRAMES, Interface.TRAJECTORY: (MAP_FRAME,)}
    return answer.frame in allowed.get(answer.interface, (answer.frame,))


def _in_frame(answer: Answer) -> Answer:
    """Returns `answer` with the right frame, so that a wrong one, which another clause judges, is reported once."""
    return replace(answer, frame=MAP_FRAME if answer.interface == Interface.TRAJECTORY else BODY_FRAMES[0])


def _offset(heard: Heard, evidence: Evidence) -> float | None:
    """Returns the distance [m] from the ego to the trajectory of `heard` at the time of the step that it answers.

    None if the answer is not a trajectory, does not cover that time, or does not drive the ego.
    """
    target, ego = heard.answer.target, evidence.driven(heard.step)
    if not isinstance(target, Trajectory) or ego is None or problem(_in_frame(heard.answer)):
        return None
    if not len(target.time) or target.time[0] > ego.time + 0.5 * STEP_S:
        return None
    place = [float(np.interp(ego.time, target.time, values)) for values in (target.x, target.y)]
    return float(np.hypot(place[0] - ego.x, place[1] - ego.y))


def _stray(answer: Answer, evidence: Evidence) -> float | None:
    """Returns the share of the segments of a trajectory that do not lead along their lane; None if it does not move."""
    target = answer.target
    if not isinstance(target, Trajectory) or len(target.time) < 2:
        return None
    step = np.diff(target.x), np.diff(target.y)
    moving = np.hypot(*step) / np.diff(target.time) > CRAWL
    if not moving.any():
        return None
    heading = np.arctan2(step[1], step[0])[moving]
    lane = evidence.scenario.lane_map.nearest(target.x[1:][moving], target.y[1:][moving])
    return float(np.mean(np.abs(wrap_angle(heading - lane.heading)) > ALONG))


def is_clipped(target: EgoCommand | TwistTarget | Trajectory, ego: EgoState, vehicle: VehicleModel) -> bool:
    """Returns whether `target`, of finite values, asks for more than the vehicle can do.

    Args:
        target: acceleration and yaw rate; or speed and yaw rate to be reached within a step; or a trajectory, judged by
            its motion from pose to pose.
        ego: state of the ego at the step that is answered.
        vehicle: with the limits.
    """
    if isinstance(target, EgoCommand):
        return _exceeds(target.acceleration, target.yaw_rate, ego.speed, vehicle)
    if isinstance(target, TwistTarget):
        acceleration = (target.speed - ego.speed) / (STEP_S + 3.0 * vehicle.reaction_s)
        return _exceeds(acceleration, target.yaw_rate, ego.speed + STEP_S * max(acceleration, 0.0), vehicle)
    demands = np.stack(motion(target), axis=1).tolist()
    return any(_exceeds(acceleration, yaw_rate, speed, vehicle) for speed, acceleration, yaw_rate in demands)


def motion(trajectory: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns speed [m/s], acceleration [m/s2] and yaw rate [rad/s] at the inner poses of a trajectory, (m - 2,) each.

    The yaw rate is 0 where two poses are too close to each other to define a direction.
    """
    took = np.diff(trajectory.time)
    x, y = np.diff(trajectory.x), np.diff(trajectory.y)
    speed, heading = np.hypot(x, y) / took, np.arctan2(y, x)
    apart = 0.5 * (took[1:] + took[:-1])
    turn = np.remainder(np.diff(heading) + np.pi, 2.0 * np.pi) - np.pi
    moving = np.minimum(speed[1:], speed[:-1]) > CRAWL
    return np.maximum(speed[1:], speed[:-1]), np.diff(speed) / apart, np.where(moving, turn / apart, 0.0)


def _exceeds(acceleration: float, yaw_rate: float, speed: float, vehicle: VehicleModel) -> bool:
    cut = vehicle.within(acceleration, yaw_rate, speed)
    return any(abs(asked) > SLACK * abs(can) + SMALL for asked, can in zip((acceleration, yaw_rate), cut, strict=True))
