"""The measures of variants that tables show, on the terminal and in the page of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED, Better, added_metrics, title_of

MARK = "*"
"""Behind values that leave out runs without measures."""


@dataclass(frozen=True)
class Measure:
    """One measure of a variant.

    Attributes:
        name: in tables.
        path: of its value among the leaves of :func:`.variant_summary.variant_summary`.
        better: which of several values is the best, if less or more is clearly better.
        share: whether it is a share of a whole.
        of_all: whether runs without measures count in it.
        of_control: whether it is of agents under control, which a replay has not.
    """

    name: str
    path: str
    better: Callable[[Iterable[float]], float] | None = None
    share: bool = False
    of_all: bool = False
    of_control: bool = False

    def mark(self, row: Mapping[str, Any]) -> str:
        """Returns the mark of its value in `row`, the leaves of a variant's summary; empty if it is over all runs."""
        return MARK if row["failed"] and not self.of_all else ""

    def reached(self, row: Mapping[str, Any]) -> str:
        """Returns how many runs lasted up to the horizon of a displacement, as a suffix; empty if all of them did."""
        runs = row.get(f"ade_runs.{self.path.rpartition('.')[2]}", row["measured"])
        return f" ({runs} of {row['measured']})" if runs < row["measured"] and row[self.path] is not None else ""


OF_EGO = (
    Measure("runs", "runs", of_all=True),
    Measure("passed", "passed", max, of_all=True),
    Measure("failed", "not_passed", min, of_all=True),
    Measure("errors", "errors", min, of_all=True),
    Measure("contacts of the ego", "ego_contacts", min),
    Measure("at the ego's fault", "ego_at_fault", min),
    Measure("red lights passed", "red_ego", min),
    Measure("standoffs", "standoffs", min),
    Measure("shortest TTC s", "min_ttc_s", max),
    Measure("shortest headway s", "min_headway_s", max),
    Measure("steps in comfort", "ego_comfort", max, share=True),
    Measure("progress, of its log's", "ego_progress", share=True),
)
"""Measures of the ego, which are shown first."""

OF_SIMULATION = (
    Measure("agents", "agents"),
    Measure("colliding agents", "colliding_agents", min),
    Measure("colliding runs", "colliding_runs", min),
    Measure("contacts, background's fault", "background_faults", min),
    Measure("ego's fault, other could avoid", "ego_faults_avoidable", min),
    Measure("ego's fault, other could not", "ego_faults_unavoidable"),
    Measure("collision rate, all", "rate_all", min, share=True),
    Measure("collision rate, controlled", "rate_controlled", min, share=True, of_control=True),
    Measure("no new contacts", "reactive", max, share=True, of_all=True),
    Measure("takeovers", "takeovers", of_control=True),
    Measure("takeovers per run", "takeovers_per_run", of_control=True),
    Measure("handed back to their logs", "releases", of_control=True),
    Measure("share handed back", "released_share", share=True, of_control=True),
    Measure("held to the end of the run", "releases_missing", of_control=True),
    Measure("time under control s", "held_s", of_control=True),
    Measure("steps cut short in detection", "bound_hits", of_control=True),
    Measure("false alarms", "false_alarms", min, of_control=True),
    Measure("taken over near ego", "relevant_ratio", share=True, of_control=True),
    Measure("hard brakes under control", "hard_brakes", of_control=True),
    Measure("of the log meanwhile", "hard_brakes_log", of_control=True),
    Measure("guarded steps of policy C", "guarded", share=True, of_control=True),
    Measure("off road, controlled", "off_road", share=True, of_control=True),
    Measure("progress of all agents m", "progress_m"),
    Measure("largest jump m", "max_position_jump_m", min, of_control=True),
    Measure("largest distance at return m", "max_residual_m", min, of_control=True),
)
"""Measures of the simulation, which are shown on request."""


def displacements() -> Iterator[Measure]:
    """Yields the average displacement from the log by horizon, of controlled agents and of all."""
    for horizon in HORIZONS_S:
        for path, whose in (("ade_controlled_m", "controlled"), ("ade_all_m", "all")):
            yield Measure(f"ADE@{horizon} s m, {whose}", f"{path}.{horizon}", of_control=whose == "controlled")


def added() -> Iterator[Measure]:
    """Yields means of the measures that other packages add."""
    better: dict[Better, Callable[[Iterable[float]], float]] = {Better.LOWER: min, Better.HIGHER: max}
    for name, metric in added_metrics().items():
        yield Measure(title_of(name), f"{ADDED}.{name}", better.get(metric.better))
