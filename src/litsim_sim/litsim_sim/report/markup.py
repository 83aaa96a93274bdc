"""The parts of the pages that are plain HTML: tables and lists, readable without a script too."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

NOTHING = "–"


def asset(name: str) -> str:
    """Text of a file in `assets`."""
    return (files("litsim_sim.report") / "assets" / name).read_text()


def page(template: str, scripts: Sequence[str], **values: str) -> str:
    """A page of `template` with the style and `scripts` inside; `values` are HTML already."""
    script = "\n".join(asset(name) for name in scripts)
    return Template(asset(template)).substitute(values, style=asset("report.css"), script=script)


def number(value: Any, digits: int = 2, unit: str = "") -> str:
    """A number for people; a dash where there is none."""
    if value is None:
        return NOTHING
    text = str(value) if isinstance(value, int) else f"{value:.{digits}f}"
    return f"{text} {unit}".rstrip()


def percent(value: float | None) -> str:
    """A share as a percentage."""
    return NOTHING if value is None else f"{100.0 * value:.1f} %"


def badge(good: bool, yes: str, no: str) -> str:
    """A coloured word."""
    return f'<span class="badge {"good" if good else "bad"}">{escape(yes if good else no)}</span>'


def definitions(pairs: Iterable[tuple[str, Any]]) -> str:
    """A list of names and values."""
    rows = (f"<div><dt>{escape(name)}</dt><dd>{escape(str(value))}</dd></div>" for name, value in pairs)
    return f"<dl>{''.join(rows)}</dl>"


def tree(value: Any) -> str:
    """Nested values as nested lists."""
    if isinstance(value, dict) and value:
        return "<ul>" + "".join(f"<li>{_branch(str(k), v)}</li>" for k, v in value.items()) + "</ul>"
    if isinstance(value, list) and any(isinstance(v, dict | list) for v in value):
        return "<ul>" + "".join(f"<li>{_branch(str(i), v)}</li>" for i, v in enumerate(value)) + "</ul>"
    return f"<span>{escape(_leaf(value))}</span>"


def ledger(entries: Sequence[dict[str, Any]], dt: float, ego: int) -> str:
    """The takeovers of `metrics.json` as a table; a row leads to the step of its detection."""
    if not entries:
        return '<p class="none">Nobody was taken over.</p>'
    head = "agent|opponent|why|at|predicted overlap|the log alone|off its log|back|left over"
    body = "".join(_takeover_row(entry, dt, ego) for entry in entries)
    hint = '<p class="hint">A row jumps to the moment of detection and selects the agent.</p>'
    return hint + _table(head.split("|"), body)


def contacts(metrics: dict[str, Any], dt: float, ego: int) -> str:
    """The contacts of `metrics.json` as a table; a row leads to the first step of a contact."""
    found = metrics["collision"]["contacts"]
    if not found:
        return '<p class="none">No boxes touched.</p>'
    verdicts = {(each["agent"], each["step"]): each for each in metrics["collision"]["ego_contacts"]}
    avoided = {(each["agent"], each["step"]): each["avoided"] for each in metrics["safety"]["careful_driver"]}
    body = ""
    for each in found:
        pair, step = each["pair"], each["step"]
        agent = pair[1] if pair[0] == ego else pair[0]
        verdict = verdicts.get((agent, step)) if ego in pair else None
        cells = (
            *(_who(pair[0], ego), _who(pair[1], ego), f"{step * dt:.1f} s", "yes" if each["in_log"] else "no"),
            _verdict(verdict, avoided[agent, step]) if verdict else NOTHING,
            number(verdict["delta_v_mps"], 1, "m/s") if verdict else NOTHING,
        )
        body += _row(step, agent, cells)
    return _table(("agent", "and", "at", "also in the log", "verdict", "Δv of the ego"), body)


def _verdict(contact: dict[str, Any], avoided: bool) -> str:
    kind = str(contact["verdict"]).replace("_", " ")
    fault = "at fault" if contact["ego_at_fault"] else "not at fault"
    return f"{kind}: ego {fault}; the careful driver {'avoids it' if avoided else 'hits too'}"


def _takeover_row(entry: dict[str, Any], dt: float, ego: int) -> str:
    detected = entry["detected_step"]
    certainty = entry.get("overlap_probability")
    in_time = number(entry.get("time_to_conflict_s"), 1, "s")
    predicted = f"in {in_time}" + (f", p = {certainty:.2f}" if certainty else "")
    back = entry.get("released_step")
    cells = (
        _who(entry["agent"], ego),
        _who(entry["opponent"], ego),
        str(entry["reason"]).replace("_", " "),
        f"{detected * dt:.1f} s",
        predicted,
        _replay(entry, dt, ego),
        number(entry.get("held_s"), 1, "s"),
        NOTHING if back is None else f"{back * dt:.1f} s",
        number(entry.get("residual_m"), 2, "m") if back is not None else NOTHING,
    )
    return _row(detected, entry["agent"], cells)


def _replay(entry: dict[str, Any], dt: float, ego: int) -> str:
    if not entry.get("replay_would_collide"):
        return "false alarm: meets nobody" if entry.get("false_alarm") else "meets nobody"
    return f"hits {_who(entry['replay_opponent'], ego)} at {entry['replay_step'] * dt:.1f} s"


def _who(agent: int, ego: int) -> str:
    return f"ego {agent}" if agent == ego else str(agent)


def _row(step: int, agent: int, cells: Sequence[str]) -> str:
    first, *rest = (escape(cell) for cell in cells)
    button = f'<td><button type="button" class="jump">{first}</button></td>'
    return f'<tr data-step="{step}" data-agent="{agent}">{button}{"".join(f"<td>{c}</td>" for c in rest)}</tr>'


def _table(head: Sequence[str], body: str) -> str:
    names = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    return (
        f'<div class="scroll"><table class="jumps"><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _branch(name: str, value: Any) -> str:
    if isinstance(value, dict | list) and value and any(isinstance(v, dict | list) for v in _inside(value)):
        return f"<details><summary>{escape(name)}</summary>{tree(value)}</details>"
    return f"<b>{escape(name)}</b> {tree(value)}"


def _inside(value: dict[str, Any] | list[Any]) -> Iterator[Any]:
    yield from value.values() if isinstance(value, dict) else value


def _leaf(value: Any) -> str:
    if value is None or value in ("", {}, []):
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(_leaf(v) for v in value) if isinstance(value, list) else str(value)
