"""A run on the terminal: the most important measures, contacts of the ego, and takeovers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from litsim_eval.analysis.metric import ADDED, added_metrics
from litsim_eval.campaign.reasons import standoff
from litsim_eval.report.wording import lockstep_text
from litsim_sim.core.run_end import RunEnd
from litsim_sim.core.scene import STEP_S

NOTHING = "-"
CONTACT_COLUMNS = ("agent", "at", "kind", "at fault", "delta-v", "careful driver", "in the other's place")
LEDGER_COLUMNS = ("agent", "why", "with", "at", "in", "p", "pure replay", "held", "back", "off")


def print_metrics(metrics: dict[str, Any], console: Console | None = None) -> None:
    """Prints the most important measures."""
    console = console or Console()
    title = "{run_id}: {scenario}, ego {ego}, policy {policy}, seed {seed}".format(**metrics)
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for name, value in _rows(metrics):
        table.add_row(name, value)
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
    careful = {(each["agent"], each["step"]): each for each in metrics["safety"]["careful_driver"]}
    for each in metrics["collision"]["ego_contacts"]:
        agent, step = each["agent"], each["step"]
        yield (
            str(agent),
            _time(step),
            each["verdict"].replace("_", " "),
            "none: in the log" if each["in_log"] else "ego" if each["ego_at_fault"] else "other",
            _plain(each["delta_v_mps"]),
            _careful(careful[agent, step]["avoided"]),
            _careful(careful[agent, step]["other_avoids"]),
        )


def _careful(avoids: bool | None) -> str:
    """Returns a text on what the careful driver would have done; a dash if the other agent is not a vehicle."""
    if avoids is None:
        return NOTHING
    return "avoids it" if avoids else "hits too"


def _ledger_rows(metrics: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    for each in metrics["ledger"]:
        replay = "false alarm" if each["false_alarm"] else "no contact"
        if each["replay_would_collide"]:
            replay = f"hits {each['replay_opponent']} at {_time(each['replay_step'])}"
        yield (
            str(each["agent"]),
            each["reason"].replace("_", " "),
            str(each["opponent"]),
            _time(each["detected_step"]),
            NOTHING if each["time_to_conflict_s"] is None else f"{each['time_to_conflict_s']:.1f}",
            _plain(each["overlap_probability"]),
            replay,
            f"{each['held_s']:.1f}",
            _time(each["released_step"]),
            _plain(each["residual_m"]),
        )


def _time(step: int | None) -> str:
    return NOTHING if step is None else f"{step * STEP_S:.1f}"


def _rows(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    collision, back, timing = metrics["collision"], metrics["handback"], metrics["timing"]
    yield "valid", "yes" if metrics["valid"] else f"NO: {metrics['why']}"
    end = RunEnd.of_plain(metrics["ended"])
    yield "ended", NOTHING if end is None else f"at {metrics['ended']['time_s']:.1f} s: {end.sentence}"
    yield "agents", f"{metrics['agents']}, of which {metrics['controlled_agents']} were ever under control"
    touching = f"{collision['pairs']} pairs, {collision['excess']} in excess of the log's {collision['log_floor']}"
    fault = f"ego at fault {collision['ego_at_fault']}, background {collision['background_at_fault']}"
    yield "collisions", f"{touching}; {fault}"
    by = collision["by_fault"]
    helped = f"ego's fault {by['ego_avoidable']} that a careful other avoids, {by['ego_unavoidable']} that it does not"
    yield "not in the log", f"{helped}; a background agent's fault {by['background']}"
    rates = (_percent(collision["rate_all"]), _percent(collision["rate_controlled"]))
    yield "collision rate", f"{rates[0]} of all, {rates[1]} of controlled agents"
    yield "new contacts", "none" if metrics["reactive"] else "yes"
    horizons = list(metrics["ade_all_m"])
    for name, key in (("ADE all", "ade_all_m"), ("ADE controlled", "ade_controlled_m"), ("ADE ego", "ade_ego_m")):
        values = " / ".join(_plain(metrics[key][h]) for h in horizons)
        yield name, f"{values} m at {'/'.join(horizons)} s" if horizons else NOTHING
    yield "progress", f"{_number(metrics['progress_m'], 'm')} (log {_number(metrics['progress_log_m'], 'm')})"
    share = _percent(metrics["relevant_ratio"])
    yield "takeovers", f"{metrics['takeovers']} ({share} of agents), {metrics['false_alarms']} false alarms"
    jumps = f"{back['max_position_jump_m']:.3f} m, {back['max_speed_jump_mps']:.2f} m/s"
    jumps += f", {back['max_yaw_jump_rad']:.3f} rad"
    yield "hand-backs", f"{back['count']}, mean residual {_number(back['residual_m'], 'm')}; largest jump {jumps}"
    yield from _driving_rows(metrics)
    for name, value in metrics.get(ADDED, {}).items():
        yield name, _number(value, added_metrics()[name].unit).rstrip() if name in added_metrics() else _plain(value)
    yield "lock-step", lockstep_text(metrics["lockstep"])
    factor = timing["realtime_factor"]
    yield "wall time", f"{_number(timing['wall_s'], 's')}, {NOTHING if factor is None else f'{factor:.2f}'} x real time"
    stages = (f"{stage} {t['median']:.1f}/{t['max']:.1f}" for stage, t in timing["stage_ms"].items())
    yield "stages, median/max ms", ", ".join(stages) or NOTHING
    yield "digest", metrics["digest"][:16]


def _driving_rows(metrics: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields how safely, comfortably and naturally it was driven."""
    safety, road = metrics["safety"], metrics["ego_motion"]
    below = ", ".join(f"{_percent(share)} below {limit} s" for limit, share in safety["ttc_below"].items())
    yield "ego: TTC", f"shortest {_number(safety['min_ttc_s'], 's')}; {below}"
    near = f"headway {_number(safety['min_headway_s'], 's')}, PET {_number(safety['min_pet_s'], 's')}"
    yield "ego: closest", f"{near}, DRAC {_number(safety['max_drac_mps2'], 'm/s²')}"
    if road:
        yield "ego: off road", f"{_percent(road['off_road'])} of steps, over its edge {_percent(road['over_edge'])}"
    for each in metrics.get("standoffs", []):
        yield "standoff", standoff(each)
    ego, others = metrics["comfort"]["ego"], metrics["comfort"]["controlled"]
    yield "hard brakes", f"ego {ego['hard_brakes'] if ego else NOTHING}, agents under control {others['hard_brakes']}"
    within = _percent(min(ego["within"].values())) if ego else NOTHING
    comfortable = _percent(others["comfortable"])
    kept = f"ego {within} of steps within the bound least kept; controlled agents that keep all: {comfortable}"
    yield "comfort", kept
    guarded = others["guarded"]
    yield "guarded", f"{guarded['count']} of the policy's agent-steps ({_percent(guarded['share'])})"
    traffic = metrics.get("traffic")
    if traffic and traffic["driven"]["following"]:
        yield from _traffic_rows(traffic["driven"], traffic["same_log"])
    realism = metrics["realism"]
    yield "realism", f"{realism['score']:.3f} of the log's own likelihood" if realism else NOTHING


def _traffic_rows(driven: dict[str, Any], log: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields how the policy drives, with how the same agents do in their logs in brackets."""

    def both(name: str, text: Callable[[float | None], str]) -> str:
        return f"{text(driven[name])} ({text(log[name])})"

    close, short = both("headway_below_half_s", _percent), both("ttc_below_3_s", _percent)
    headway = f"median headway {both('headway_s', _plain)} s, {close} below 0.5 s, TTC {short} below 3 s"
    yield "driven (in their logs)", headway
    braking = f"{both('braking_beyond_2_mps2', _percent)} of accelerations below -2 m/s²"
    yield "", f"{braking}, {both('lane_changes_per_minute', _plain)} lane changes per minute"


def _plain(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.2f}"


def _number(value: float | None, unit: str) -> str:
    return NOTHING if value is None else f"{value:.2f} {unit}"


def _percent(value: float | None) -> str:
    return NOTHING if value is None else f"{100 * value:.1f} %"
