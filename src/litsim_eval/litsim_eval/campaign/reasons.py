"""Why a run has not passed, as what happened in it: contacts, red lights, standoffs, and motion beyond bounds."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from litsim_eval.analysis.measure import Metrics, in_percent, percent
from litsim_eval.analysis.metrics_tree import measures_by_field


def what_happened(field: str, value: Any, limit: str, metrics: Metrics) -> str:
    """Returns a sentence on the criterion that a run misses; empty if there is none for its field.

    It is that of the measure, or of a title with a unit; of all else the criterion itself says enough.

    Args:
        field, value, limit: of the criterion, see :class:`litsim_eval.campaign.criteria.CriterionResult`.
        metrics: of the run.
    """
    measure = measures_by_field().get(field)
    if measure is None or value is None:
        return "" if measure is None else measure.missing
    with suppress(KeyError, TypeError, ValueError):  # of measures by an earlier version
        if measure.sentence is not None:
            return measure.sentence(value, limit, metrics)
        name = measure.title.format(field.rpartition(".")[2])
        if name and measure.share:
            return f"{name} {percent(value)}, expected {in_percent(limit)}"
        if name and measure.unit:
            return f"{name} {value:.2f} {measure.unit}, expected {limit} {measure.unit}"
    return ""
