"""The measures of a run: all that there are, and their values as one tree, which is written to `metrics.json`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from difflib import get_close_matches
from functools import cache, partial, reduce
from itertools import chain
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import Measure, MetricField, Row, Table, mean
from litsim_eval.analysis.measures import (
    comfort,
    displacement,
    driven_traffic,
    ego,
    fault,
    identity,
    lockstep,
    mission,
    progress,
    reactsim,
    realism,
    road_rules,
    safety,
    signals,
    sim_agents,
    standoff,
    takeover,
    timing,
)
from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import write_text
from litsim_sim.record.run import Run

NEAR_MAX = 5
METRICS_FILE = "metrics.json"
ADDED = "added"
"""Field of `metrics.json` that holds the values of added measures, by the names of their entry points."""
FAMILIES: dict[str, tuple[Measure, ...]] = {
    "run": identity.MEASURES,
    "collisions": fault.MEASURES,
    "fault": fault.ANSWERS,
    "displacement": displacement.MEASURES,
    "ego": ego.MOTION,
    "mission": mission.MEASURES,
    "rules": road_rules.MEASURES,
    "progress": progress.MEASURES,
    "takeovers": takeover.MEASURES,
    "safety": safety.MEASURES,
    "comfort": comfort.MEASURES,
    "realism": realism.MEASURES,
    "sim_agents": sim_agents.MEASURES,
    "reactsim": reactsim.MEASURES,
    "traffic": driven_traffic.MEASURES,
    "signals": signals.MEASURES,
    "risk": ego.RISK,
    "standoffs": standoff.MEASURES,
    "lockstep": lockstep.MEASURES,
    "timing": timing.MEASURES,
    "world": identity.WORLD,
}
"""The measures of this package in the order of `metrics.json`; those of validity come last."""
NULLABLE = ("ended", "mission", "rules", "comfort.ego", "realism", "sim_agents", "signals")
"""Branches that are null where there is nothing to measure in them."""

BY_STEP = (displacement.displacements, realism.naturalness)
"""Results that take memory for each agent at each step, and are not kept with the run once it is measured."""


@cache
def added() -> tuple[Measure, ...]:
    """Returns the installed measures of other packages; raises InputError if one cannot be imported."""
    return tuple(_added(name, plugins.load(plugins.METRICS, name)) for name in plugins.names(plugins.METRICS))


def _added(name: str, measure: Measure) -> Measure:
    """Returns a plug-in with its place in `metrics.json`, a title, and a row for its mean, if it has none."""
    rows = measure.rows or (Row(f"{ADDED}.{name}", mean, Table.EGO),)
    value = partial(_checked, name, measure)
    return replace(measure, name=f"{ADDED}.{name}", title=measure.title or name, value=value, rows=rows)


def _checked(name: str, measure: Measure, run: Run) -> float | None:
    """Returns the value of a plug-in; raises InputError if it is no finite number."""
    value = measure.value(run)
    if value is not None and not isfinite(value):
        raise InputError(f"measure {name} is {value}, expected a finite number, or None for nothing to measure")
    return None if value is None else float(value)


@cache
def measures() -> tuple[Measure, ...]:
    """Returns all measures, ours and those of other packages, in the order of `metrics.json`."""
    return (*(measure for family in FAMILIES.values() for measure in family), *added(), *lockstep.VALIDITY)


def compute_metrics(run: Run) -> dict[str, Any]:
    """Returns every measure of a run as a tree by the parts of their names.

    Measures cover the steps after the history. Rates are shares between 0 and 1; a measure with nothing to measure is
    None. Agents exclude the ego, except in `collision` and in progress.
    """
    tree: dict[str, Any] = {}
    for family in FAMILIES.values():
        _plant(tree, family, run)
    tree[ADDED] = {}
    _plant(tree, added(), run)
    _plant(tree, lockstep.VALIDITY, run)
    for function in BY_STEP:
        run.forget(function)
    for path in NULLABLE:
        *above, last = path.split(".")
        branch = reduce(dict.__getitem__, above, tree)
        branch[last] = None if _is_empty(branch[last]) else branch[last]
    return tree


def _plant(tree: dict[str, Any], family: Iterable[Measure], run: Run) -> None:
    """Puts the values of measures of a run into the tree, making branches."""
    for measure in family:
        *above, leaf = measure.name.split(".")
        reduce(lambda branch, name: branch.setdefault(name, {}), above, tree)[leaf] = measure.of(run)


def _is_empty(tree: Any) -> bool:
    return all(map(_is_empty, tree.values())) if isinstance(tree, dict) else tree is None


def write_metrics(metrics: dict[str, Any], path: Path) -> None:
    """Writes `metrics` as JSON; raises InputError if `path` cannot be written, or a measure is not finite."""
    try:
        text = json.dumps(metrics, indent=2, allow_nan=False) + "\n"
    except ValueError as error:
        first, *others = _not_finite(metrics)
        named = f"{first} and {len(others)} more" if others else first
        because = f": {metrics['why']}" if metrics.get("why") else ""
        raise InputError(f"{path}: {named} not finite, expected finite numbers{because}") from error
    write_text(path, text)


def _not_finite(value: Any, name: str = "") -> Iterator[str]:
    """Yields paths of the numbers in the tree `value`, which is at `name`, that are not finite, joined by dots."""
    if isinstance(value, dict | list):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _not_finite(below, f"{name}.{key}" if name else str(key))
    elif isinstance(value, float) and not np.isfinite(value):
        yield name


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
