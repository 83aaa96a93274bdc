"""Formatting of values for the pages: numbers, shares and nested measures as plain text, which templates escape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from litsim_eval.analysis.measure import Measure, Metrics
from litsim_eval.analysis.metrics import leaves, measures

NOTHING = "–"


def number(value: Any, digits: int = 2, unit: str = "") -> str:
    """Returns `value` with `digits` after the point (none if it is an int) and its unit; a dash for None."""
    if value is None:
        return NOTHING
    text = str(value) if isinstance(value, int) else f"{value:.{digits}f}"
    return f"{text} {unit}".rstrip()


def percent(value: float | None) -> str:
    """Returns a share from 0 to 1 as a percentage with one digit; a dash for None."""
    return NOTHING if value is None else f"{100.0 * value:.1f} %"


def measured(metrics: Metrics) -> Iterator[tuple[str, str]]:
    """Yields title and value, as text, of the measures of a run that have a title, and a value in the run.

    Several values of one measure are behind each other, and so are their keys in the title.
    """
    values = leaves(metrics)
    for measure in (shown for shown in measures() if shown.title):
        keys = [key for key in measure.keys or ("",) if values.get(measure.path(key)) is not None]
        texts = [_value_text(measure, values[measure.path(key)]) for key in keys]
        if texts:
            yield measure.title.format("/".join(keys)), f"{' / '.join(texts)} {measure.unit}".rstrip()


def _value_text(measure: Measure, value: Any) -> str:
    """Returns a value without its unit; of a list its length."""
    if isinstance(value, bool):
        return leaf(value)
    return percent(value) if measure.share else number(len(value) if isinstance(value, list) else value)


def branches(value: Any) -> list[tuple[str, Any]]:
    """Returns the names and values one level below `value`.

    Returns:
        (name, value) of a dict, (index, value) of a list that holds dicts or lists; [] for all that :func:`leaf` shows.
    """
    if isinstance(value, dict):
        return [(str(name), item) for name, item in value.items()]
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return [(str(index), item) for index, item in enumerate(value)]
    return []


def is_nested(value: Any) -> bool:
    """Returns whether `value` has at least two levels below it: a dict or list that holds a dict or list."""
    inside = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(isinstance(item, dict | list) for item in inside)


def lockstep_text(lockstep: Mapping[str, Any]) -> str:
    """Returns missed answers, gaps and unused messages of an external ego, of `lockstep` of `metrics.json`, as text."""
    own = ("interface", "answered", "joined")
    port = {name: count for name, count in lockstep["ego_port"].items() if name not in own}
    unused = "".join(f", {count} {name}" for name, count in port.items() if count)
    text = f"{lockstep['missed']} missed answers, {lockstep['gaps']} gaps"
    text += f"; of the ego's messages{unused[1:]}" if unused else ""
    joined = lockstep["ego_port"].get("joined", 0)
    return f"{text}; {joined} publishers of the ego joined in mid-run" if joined else text


def leaf(value: Any) -> str:
    """Returns a value without further levels as text: floats with four digits, bools as yes or no, None as a dash."""
    if value is None or value in ("", {}, []):
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    return ", ".join(leaf(item) for item in value) if isinstance(value, list) else str(value)
