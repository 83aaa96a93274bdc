"""When in a run the criteria on its ego are missed: steps by field of `metrics.json`, for marks on the time line."""

from __future__ import annotations

from contextlib import suppress

from litsim_eval.analysis.measure import Metrics, Span
from litsim_eval.analysis.metrics import measures
from litsim_sim.record.run import Run


def moments(run: Run, metrics: Metrics) -> dict[str, list[Span]]:
    """Returns the spans of steps at which the ego does what each field counts against it; fields without are left out.

    Of the smallest time to collision it is the step of the smallest.
    """
    spans: dict[str, list[Span]] = {}
    for measure in measures():
        with suppress(KeyError, TypeError):  # no signals, or measures by an earlier version
            spans[measure.name] = list(measure.moments(run, metrics)) if measure.moments else []
    return {field: missed for field, missed in spans.items() if missed}
