"""A run on the terminal: the measures with a title, contacts of the ego, and takeovers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from litsim_eval.analysis.measures.answers import cause_text
from litsim_eval.analysis.measures.standoff import standoff_text
from litsim_eval.analysis.measures.takeover import Outcome
from litsim_eval.analysis.measures.timing import pace_text
from litsim_eval.report.wording import lockstep_text, measured
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import RunEnd

NOTHING = "-"
CONTACT_COLUMNS = ("agent", "at", "kind", "delta-v", "answers", "why", "in the other's place")
LEDGER_COLUMNS = ("agent", "why", "with", "at", "in", "p", "pure replay", "held", "back", "off")


def print_metrics(metrics: dict[str, Any], console: Console | None = None) -> None:
    """Prints the measures that have a title."""
    console = console or Console()
    title = "{run_id}: {scenario}, ego {ego}, policy {policy}, seed {seed}".format(**metrics)
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in _rows(metrics):
        table.add_row(Text(name), Text(value))
    console.print(table)


def print_ledger(metrics: dict[str, Any], console: Console | None = None) -> None:
    """Prints every contact of the ego and every takeover, with its reason and outcome; nothing if there are none."""
    console = console or Console()
    for title, head, rows in (
        ("contacts of the ego (s, m/s)", CONTACT_COLUMNS, list(_contact_rows(metrics))),
        ("takeovers (s; off: distance from the log at the return, m)", LEDGER_COLUMNS, list(_ledger_rows(metrics))),
    ):
        if rows:
            table = Table(*head, title=title, title_justify="left", box=None, pad_edge=False)
            for row in rows:
                table.add_row(*row)
            console.print("", table)


def _contact_rows(metrics: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    fault = {(contact["agent"], contact["step"]): contact for contact in metrics["fault"]["contacts"]}
    for contact in metrics["collision"]["ego_contacts"]:
        agent, step = contact["agent"], contact["step"]
        why = fault[agent, step]
        yield (
            str(agent),
            _time(step),
            contact["verdict"].replace("_", " "),
            _plain(contact["delta_v_mps"]),
            "none: in the log" if contact["in_log"] else "the ego" if why["of_ego"] else "not the ego",
            cause_text(why),
            _careful(why["other_avoids"]),
        )


def _careful(avoids: bool | None) -> str:
    """Returns a text on what the careful driver would have done; a dash if the other agent is not a vehicle."""
    if avoids is None:
        return NOTHING
    return "avoids it" if avoids else "hits too"


def _ledger_rows(metrics: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for entry in metrics["ledger"]:
        replay = "false alarm" if entry["false_alarm"] else "no contact"
        if entry["replay_would_collide"]:
            replay = f"hits {entry['replay_opponent']} at {_time(entry['replay_step'])}"
        yield (
            str(entry["agent"]),
            entry["reason"].replace("_", " "),
            str(entry["opponent"]),
            _time(entry["detected_step"]),
            NOTHING if entry["time_to_conflict_s"] is None else f"{entry['time_to_conflict_s']:.1f}",
            _plain(entry["overlap_probability"]),
            replay,
            f"{entry['held_s']:.1f}",
            "own intent" if entry["outcome"] == Outcome.OWN_INTENT else _time(entry["released_step"]),
            _plain(entry["residual_m"]),
        )


def _time(step: int | None) -> str:
    return NOTHING if step is None else f"{step * STEP_S:.1f}"


def _rows(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    yield "valid", "yes" if metrics["valid"] else f"NO: {metrics['why']}"
    end = RunEnd.of_plain(metrics["ended"])
    yield "ended", NOTHING if end is None else f"at {metrics['ended']['time_s']:.1f} s: {end.sentence}"
    yield from measured(metrics)
    yield from (("standoff", standoff_text(standoff)) for standoff in metrics.get("standoffs", []))
    if slow := pace_text(metrics):
        yield "pace", slow
    yield "lock-step", lockstep_text(metrics["lockstep"])
    stages = (f"{stage} {t['median']:.1f}/{t['max']:.1f}" for stage, t in metrics["timing"]["stage_ms"].items())
    yield "stages, median/max ms", ", ".join(stages) or NOTHING
    yield "digest", metrics["digest"][:16]
    if metrics.get("seal"):
        yield "seal", metrics["seal"]


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.2f}"
