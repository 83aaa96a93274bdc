"""When in a run the criteria on its ego are missed: steps by field of `metrics.json`, for marks on the time line."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from litsim_data.mining.lane_tracks import true_runs
from litsim_data.surrogates.safety import safety_series
from litsim_eval.analysis.comfort import BOUNDS, motion_values
from litsim_eval.campaign.reasons import WITHIN, at_fault, avoidable, red_lights
from litsim_sim.core.scene import BoolArray, IntArray
from litsim_sim.record.lanes import lane_map_of
from litsim_sim.record.run import Run

Span = tuple[int, int]
"""First and last step."""


def moments(run: Run, metrics: Mapping[str, Any]) -> dict[str, list[Span]]:
    """Returns the spans of steps at which the ego does what each field counts against it; fields without are left out.

    Of the smallest time to collision it is the step of the smallest.
    """
    spans: dict[str, list[Span]] = {}
    for field, events in (
        ("collision.ego_at_fault", at_fault),
        ("safety.avoidable_contacts", avoidable),
        ("signals.red_ego", red_lights),
    ):
        with suppress(KeyError, TypeError):  # no signals, or measures by an earlier version
            spans[field] = [(each["step"], each["step"]) for each in events(metrics)]
    for field in ("standoffs", "ego_motion.progress_ratio"):
        spans[field] = [(each["step"], each["end_step"]) for each in metrics.get("standoffs", [])]
    steps = run.steps.after(run.info.history_steps)
    rows, table = steps.track(run.info.ego_id), steps.stacked
    if not len(rows):
        return {field: found for field, found in spans.items() if found}
    step = steps.step[table.number[rows]]
    lane_map = lane_map_of(run)
    if lane_map is not None:
        spans["ego_motion.off_road"] = _spans(step, ~lane_map.inside_road(table.x[rows], table.y[rows]))
    values = motion_values(table.speed[rows], table.acceleration[rows], table.yaw_rate[rows], run.info.dt)
    for name, (low, high) in BOUNDS.items():
        beyond = (values[name] < low) | (values[name] > high)
        spans[WITHIN + name] = _spans(step[len(step) - len(beyond) :], beyond)
    ttc = safety_series(steps, run.info.ego_id)
    if np.isfinite(ttc.ttc).any():
        smallest = int(ttc.step[np.argmin(ttc.ttc)])
        spans["safety.min_ttc_s"] = spans["safety.min_own_ttc_s"] = [(smallest, smallest)]
    return {field: found for field, found in spans.items() if found}


def _spans(step: IntArray, is_missed: BoolArray) -> list[Span]:
    """Returns first and last of successive steps at which something is missed."""
    return [(int(step[begin]), int(step[end - 1])) for begin, end in true_runs(is_missed)]
