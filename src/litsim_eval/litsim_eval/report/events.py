"""The takeovers and contacts of `metrics.json` as tables of text; each row belongs to a step and an agent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from litsim_eval.analysis.measures.fault import cause_text
from litsim_eval.analysis.measures.takeover import TakeoverOutcome
from litsim_eval.report.wording import NOTHING, number


class EventRow(NamedTuple):
    """One event: step and agent (id) that its row links to, and a text for each column."""

    step: int
    agent: int
    cells: tuple[str, ...]


class EventTable(NamedTuple):
    """Names of the columns, and the events in the order of `metrics.json`."""

    head: tuple[str, ...]
    rows: tuple[EventRow, ...]


def takeover_table(entries: Sequence[dict[str, Any]], dt: float, ego: int) -> EventTable:
    """Returns the ledger of `metrics.json`, one row per takeover, linked to the step of the detection.

    Args:
        entries: `ledger` of the metrics.
        dt: length of a step [s].
        ego: id of the ego.
    """
    head = "agent|opponent|why|at|predicted overlap|the log alone|off its log for|back at|distance then"
    return EventTable(tuple(head.split("|")), tuple(_takeover(entry, dt, ego) for entry in entries))


def contact_table(metrics: dict[str, Any], dt: float, ego: int) -> EventTable:
    """Returns the contacts of `metrics`, one row each, linked to its first step.

    Args:
        metrics: the tree of `metrics.json`; its `collision` and `fault` are read.
        dt: length of a step [s].
        ego: id of the ego, whose contacts have a verdict.
    """
    verdicts = {(contact["agent"], contact["step"]): contact for contact in metrics["collision"]["ego_contacts"]}
    fault = {(contact["agent"], contact["step"]): contact for contact in metrics["fault"]["contacts"]}
    rows = []
    for contact in metrics["collision"]["contacts"]:
        pair, step = contact["pair"], contact["step"]
        agent = pair[1] if pair[0] == ego else pair[0]
        verdict = verdicts.get((agent, step)) if ego in pair else None
        cells = (
            *(_who(pair[0], ego), _who(pair[1], ego), f"{step * dt:.1f} s", "yes" if contact["in_log"] else "no"),
            _verdict(verdict, fault[agent, step]) if verdict else NOTHING,
            number(verdict["delta_v_mps"], 1, "m/s") if verdict else NOTHING,
        )
        rows.append(EventRow(step, agent, cells))
    return EventTable(("agent", "and", "at", "also in the log", "verdict", "Δv of the ego"), tuple(rows))


def _takeover(entry: dict[str, Any], dt: float, ego: int) -> EventRow:
    detected = entry["detected_step"]
    certainty, in_time = entry.get("overlap_probability"), entry.get("time_to_conflict_s")
    predicted = NOTHING if in_time is None else f"in {in_time:.1f} s"
    predicted += f", p = {certainty:.2f}" if certainty else ""
    replay = "false alarm: no contact" if entry.get("false_alarm") else "no contact"
    if entry.get("replay_would_collide"):
        replay = f"hits {_who(entry['replay_opponent'], ego)} at {entry['replay_step'] * dt:.1f} s"
    cells = (
        _who(entry["agent"], ego),
        _who(entry["opponent"], ego),
        str(entry["reason"]).replace("_", " "),
        f"{detected * dt:.1f} s",
        predicted,
        replay,
        number(entry.get("held_s"), 1, "s"),
        _back(entry, dt),
        number(entry.get("residual_m"), 2, "m") if entry.get("released_step") is not None else NOTHING,
    )
    return EventRow(detected, entry["agent"], cells)


def _back(entry: dict[str, Any], dt: float) -> str:
    """Returns a text on when the agent was back on its log, or why it was not."""
    outcome, step = entry.get("outcome"), entry.get("released_step")
    if outcome == TakeoverOutcome.OWN_INTENT:
        return f"own intent from {entry['own_intent_step'] * dt:.1f} s"
    if outcome == TakeoverOutcome.LEFT_NET:
        return "left the net"
    if outcome == TakeoverOutcome.OUTLIVED_LOG:
        return "no log left"
    when = NOTHING if step is None else f"{step * dt:.1f} s"
    return f"{when}, its log was over" if outcome == TakeoverOutcome.LOG_OVER else when


def _verdict(contact: dict[str, Any], fault: dict[str, Any]) -> str:
    kind = str(contact["verdict"]).replace("_", " ")
    answers = "the ego answers for it" if fault["of_ego"] else "the ego does not answer for it"
    text = f"{kind}: {'no fault' if contact['in_log'] else answers}; {cause_text(fault)}"
    other = fault["other_avoids"]
    if other is None:
        return text
    return f"{text}, in the other's place {'avoids it' if other else 'hits too'}"


def _who(agent: int, ego: int) -> str:
    return f"ego {agent}" if agent == ego else str(agent)
