"""Why a run has not passed, as what happened in it: contacts, red lights, standoffs, and motion beyond bounds."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

from litsim_eval.analysis.comfort import BOUNDS
from litsim_sim.core.scene import STEP_S

Metrics = Mapping[str, Any]
WITHIN = "comfort.ego.within."
MOTIONS = {
    "longitudinal_acceleration": ("accelerating and braking", "m/s²"),
    "lateral_acceleration": ("acceleration to the side", "m/s²"),
    "yaw_rate": ("yaw rate", "rad/s"),
    "yaw_acceleration": ("yaw acceleration", "rad/s²"),
    "longitudinal_jerk": ("jerk along the way", "m/s³"),
    "jerk": ("jerk", "m/s³"),
}
"""Name and unit of each of :data:`litsim_eval.analysis.comfort.BOUNDS`."""


def what_happened(field: str, value: Any, limit: str, metrics: Metrics) -> str:
    """Returns a sentence on the criterion that a run misses; empty if there is none for its field.

    Args:
        field, value, limit: of the criterion, see :class:`litsim_eval.campaign.criteria.CriterionResult`.
        metrics: of the run.
    """
    with suppress(KeyError, TypeError, ValueError):  # of measures by an earlier version
        if field.startswith(WITHIN):
            return _beyond_comfort(field.removeprefix(WITHIN), value, limit)
        if field in SENTENCES:
            return SENTENCES[field](value, limit, metrics)
    return ""


def at_fault(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the contacts at the ego's fault that the log has not."""
    yield from (each for each in metrics["collision"]["ego_contacts"] if each["ego_at_fault"] and not each["in_log"])


def avoidable(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the contacts of the ego that a careful driver avoids, and the log has not."""
    in_log = {(each["agent"], each["step"]) for each in metrics["collision"]["ego_contacts"] if each["in_log"]}
    for each in metrics["safety"]["careful_driver"]:
        if each["avoided"] and (each["agent"], each["step"]) not in in_log:
            yield each


def red_lights(metrics: Metrics) -> Iterator[Mapping[str, Any]]:
    """Yields the stop lines that the ego passed at red."""
    yield from (each for each in metrics["signals"]["reds"] if each["by"] == "ego")


def _at_fault(_: Any, __: str, metrics: Metrics) -> str:
    texts = [
        f"{each['agent']} at {_time(each['step'])} ({each['verdict'].replace('_', ' ')}, {each['delta_v_mps']:.1f} m/s)"
        for each in at_fault(metrics)
    ]
    return f"contact at the ego's fault with {' and '.join(texts)}" if texts else ""


def _avoidable(_: Any, __: str, metrics: Metrics) -> str:
    texts = [f"{each['agent']} at {_time(each['step'])}" for each in avoidable(metrics)]
    return f"contact that a careful driver avoids with {' and '.join(texts)}" if texts else ""


def _off_road(value: float, _: str, __: Metrics) -> str:
    return f"off the road at {_percent(value)} of the steps"


def _red(_: Any, __: str, metrics: Metrics) -> str:
    texts = [f"{each['connection']} at {_time(each['step'])}" for each in red_lights(metrics)]
    return f"red light passed, {' and '.join(texts)}" if texts else ""


def _minimum_risk(value: float, _: str, __: Metrics) -> str:
    return f"minimum-risk manoeuvre for {value:.1f} s"


def _ttc(value: float, limit: str, _: Metrics) -> str:
    return f"time to collision down to {value:.2f} s, expected {limit} s"


def _progress(value: float, limit: str, metrics: Metrics) -> str:
    text = f"the ego came {_percent(value)} as far as its log, expected {_in_percent(limit)}"
    return "; ".join([text, *map(standoff, metrics.get("standoffs", []))])


def standoff(entry: Mapping[str, Any]) -> str:
    """Returns a sentence on an entry of `standoffs` of `metrics.json`."""
    first = {"ego": "the ego could go first", "other": f"{entry['agent']} could go first"}.get(
        entry["could_go_first"], f"{entry['could_go_first']} could go first"
    )
    until = f"until {_time(entry['end_step'])}" if entry["resolved"] else "to the end"
    return f"ego and {entry['agent']} stand for each other from {_time(entry['step'])} {until}, {first}"


def _standoffs(_: Any, __: str, metrics: Metrics) -> str:
    return "; ".join(map(standoff, metrics["standoffs"]))


def _beyond_comfort(name: str, value: float, limit: str) -> str:
    what, unit = MOTIONS[name]
    low, high = BOUNDS[name]
    return f"{what} within {low:g} to {high:g} {unit} at {_percent(value)} of the steps, expected {_in_percent(limit)}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _in_percent(limit: str) -> str:
    """Returns the text of a limit on a share with its numbers as percentages."""
    return re.sub(r"\d+(\.\d+)?", lambda number: _percent(float(number[0])), limit)


def _time(step: int) -> str:
    return f"{step * STEP_S:.1f} s"


SENTENCES: dict[str, Callable[[Any, str, Metrics], str]] = {
    "collision.ego_at_fault": _at_fault,
    "safety.avoidable_contacts": _avoidable,
    "ego_motion.off_road": _off_road,
    "signals.red_ego": _red,
    "minimum_risk_s": _minimum_risk,
    "safety.min_own_ttc_s": _ttc,
    "safety.min_ttc_s": _ttc,
    "ego_motion.progress_ratio": _progress,
    "standoffs": _standoffs,
}
