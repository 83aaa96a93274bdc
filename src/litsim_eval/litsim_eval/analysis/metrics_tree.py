"""The fields of `metrics.json`, which criteria and tables name by their paths. docs/metrics.md defines every one."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from itertools import chain
from typing import Any

from litsim_eval.analysis.measure import Measure, MetricField
from litsim_eval.analysis.metrics import measures

NEAR_MAX = 5


def leaves(tree: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Returns the leaves of a tree of measures by their paths, joined by dots; a list is a leaf."""
    by_path: dict[str, Any] = {}
    for key, value in tree.items():
        by_path |= leaves(value, f"{above}{key}.") if isinstance(value, Mapping) else {f"{above}{key}": value}
    return by_path


@cache
def metric_fields() -> tuple[MetricField, ...]:
    """Returns every field that a run may have, in the order of `metrics.json`."""
    return tuple(field for measure in measures() for field in measure.fields)


@cache
def measures_by_field() -> dict[str, Measure]:
    """Returns all measures by the paths of their fields, with `*` for a key that depends on the run."""
    return {field.name: measure for measure in measures() for field in measure.fields}


def find_field(name: str) -> MetricField:
    """Returns the field called `name`.

    Raises:
        ValueError: there is none; the message suggests similar names.
    """
    for field in metric_fields():
        if field.covers(name):
            return field
    raise ValueError(f"no field {name} of metrics.json{_near(name)}")


def _near(name: str) -> str:
    names = [field.name for field in metric_fields()]
    last = name.rsplit(".", 1)[-1]
    alike = get_close_matches(last, {path.rsplit(".", 1)[-1] for path in names}, NEAR_MAX, 0.75)
    same_end = [path for path in names if path.rsplit(".", 1)[-1] in alike]
    below = [path for path in names if path.startswith(f"{name}.")]
    nearest = dict.fromkeys(chain(below, get_close_matches(name, names, NEAR_MAX), same_end))
    return f" (near: {', '.join(list(nearest)[:NEAR_MAX])})" if nearest else "; docs/metrics.md has all"
