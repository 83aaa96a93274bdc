"""Measures that other packages add: plug-ins of ``litsim.metrics``."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import StrEnum
from functools import cache
from typing import ClassVar

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.record.run import Run

ADDED = "added"
"""Field of `metrics.json` that holds the values of added measures, by the names of their entry points."""


class Better(StrEnum):
    """Which values of a measure are better."""

    LOWER = "lower"
    HIGHER = "higher"
    NEITHER = "neither"


class Metric(ABC):
    """A measure of a run, made without arguments; the name of its entry point is its name everywhere.

    Criteria judge it as the field ``added.NAME``; tables of campaigns show its mean over the runs, with its unit.

    Attributes:
        unit: unit of the values, such as "m"; empty for none.
        better: which values are better.
    """

    unit: ClassVar[str] = ""
    better: ClassVar[Better] = Better.NEITHER

    @abstractmethod
    def measure(self, run: Run) -> float | None:
        """Returns the value of a recorded run; None if there is nothing to measure."""


@cache
def added_metrics() -> dict[str, Metric]:
    """Returns the installed measures, by name.

    Raises:
        InputError: one cannot be imported.
    """
    return {name: plugins.load(plugins.METRICS, name)() for name in plugins.names(plugins.METRICS)}


def measure_added(run: Run) -> dict[str, float | None]:
    """Returns values of the installed measures of a run, by name.

    Raises:
        InputError: a value is no finite number.
    """
    values = {name: metric.measure(run) for name, metric in added_metrics().items()}
    for name, value in values.items():
        if value is not None and not math.isfinite(value):
            raise InputError(f"measure {name} is {value}, expected a finite number, or None for nothing to measure")
    return {name: None if value is None else float(value) for name, value in values.items()}


def title_of(name: str) -> str:
    """Returns name, unit and better direction of an installed measure, for tables."""
    metric = added_metrics()[name]
    direction = {Better.LOWER: " (lower is better)", Better.HIGHER: " (higher is better)", Better.NEITHER: ""}
    return f"{name} {metric.unit}".rstrip() + direction[metric.better]
