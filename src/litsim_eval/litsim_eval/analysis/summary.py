"""Measures of the runs of one variant: each is declared once, for the summary, its bounds, and the tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from litsim_eval.analysis.displacement import HORIZONS_S
from litsim_eval.analysis.metric import ADDED, Better, added_metrics, title_of
from litsim_eval.analysis.metrics_tree import leaves, metric_fields
from litsim_sim.core.errors import shown

Metrics = Mapping[str, Any]
Figure = Callable[[Metrics], float | None]
"""A number of one run from its metrics; None where the run has none."""

MARK = "*"
"""Behind values that leave out runs without measures."""


def total(values: Sequence[float | None]) -> float | None:
    """Returns the sum of `values`; None if there are none, or if one is None: an older version measured that run."""
    return None if None in values or not values else sum(value for value in values if value is not None)


def known_total(values: Sequence[float | None]) -> float | None:
    """Returns the sum of the known `values`; None if there are none."""
    return sum(known) if (known := _known(values)) else None


def mean(values: Sequence[float | None]) -> float | None:
    """Returns the mean of the known `values`; None if there are none."""
    return float(np.mean(known)) if (known := _known(values)) else None


def least(values: Sequence[float | None]) -> float | None:
    """Returns the smallest of the known `values`; None if there are none."""
    return min(_known(values), default=None)


def largest(values: Sequence[float | None]) -> float | None:
    """Returns the largest of the known `values`; None if there are none."""
    return max(_known(values), default=None)


def middle(values: Sequence[float | None]) -> float | None:
    """Returns the median of the known `values`; None if there are none."""
    return float(np.median(known)) if (known := _known(values)) else None


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


@dataclass(frozen=True)
class Measure:
    """A measure of the runs of a variant.

    Attributes:
        name: in the summary; `BRANCH.LEAF` for one of several.
        title: in tables.
        figure: of a run; None if the summary makes the measure of the runs themselves.
        over: what is made of the figures of the runs.
        better: which of several values is the best, if less or more is clearly better.
        below: figure by whose sum that of `figure` is divided.
        share: whether it is a share of a whole.
        of_all: whether runs without measures count in it.
        of_control: whether it is of agents under control, which a replay has not.
    """

    name: str
    title: str
    figure: Figure | None
    over: Callable[[Sequence[float | None]], float | None] = total
    better: Callable[[Iterable[float]], float] | None = None
    below: Figure | None = None
    share: bool = False
    of_all: bool = False
    of_control: bool = False

    def value(self, runs: Sequence[Metrics]) -> float | None:
        """Returns the measure of the measured `runs`."""
        assert self.figure is not None
        above = self.over([self.figure(run) for run in runs])
        if self.below is None:
            return above
        below = total([self.below(run) for run in runs])
        return above / below if above is not None and below else None

    def mark(self, row: Mapping[str, Any]) -> str:
        """Returns the mark of its value in `row`, the leaves of a variant's summary; empty if it is over all runs."""
        return MARK if row["failed"] and not self.of_all else ""

    def reached(self, row: Mapping[str, Any]) -> str:
        """Returns how many runs lasted up to the horizon of a displacement, as a suffix; empty if all of them did."""
        runs = row.get(f"ade_runs.{self.name.rpartition('.')[2]}", row["measured"])
        return f" ({runs} of {row['measured']})" if runs < row["measured"] and row[self.name] is not None else ""


def _at(path: str) -> Figure:
    """Returns the figure at `path` in `metrics.json`, the length of a list; it fails where a branch is missing."""

    def figure(run: Metrics) -> float | None:
        value: Any = run
        for key in path.split("."):
            value = value[key]
        return len(value) if isinstance(value, list) else value

    return figure


def _if_there(path: str) -> Figure:
    """Returns the figure at `path`, None where older versions, or some runs, have none."""

    def figure(run: Metrics) -> float | None:
        value: Any = run
        for key in path.split("."):
            value = value.get(key) if isinstance(value, Mapping) else None
        return float(len(value)) if isinstance(value, list) else value

    return figure


def _least_kept(run: Metrics) -> float | None:
    """Returns the share of the ego's bound of comfort that is least kept."""
    ego = run.get("comfort", {}).get("ego") or {}
    return min((share for share in ego.get("within", {}).values() if share is not None), default=None)


def _sum_of(mean_or_share: str, count: str) -> Figure:
    """Returns the figure of the sum that a mean or share was made of, both by their paths; 0 over nothing."""
    value, number = _if_there(mean_or_share), _if_there(count)

    def figure(run: Metrics) -> float | None:
        known, over = value(run), number(run)
        return 0.0 if over == 0 else None if known is None or over is None else known * over

    return figure


def _released(run: Metrics) -> float:
    return sum(each["released_step"] is not None for each in run["ledger"])


def _held_to_the_end(run: Metrics) -> float:
    return sum(each["released_step"] is None and each["outcome"] is None for each in run["ledger"])


OF_EGO = (
    Measure("runs", "runs", None, of_all=True),
    Measure("passed", "passed", None, better=max, of_all=True),
    Measure("not_passed", "failed", None, better=min, of_all=True),
    Measure("errors", "errors", None, better=min, of_all=True),
    Measure("ego_contacts", "contacts of the ego", _at("collision.ego_contacts"), better=min),
    Measure("ego_at_fault", "at the ego's fault", _if_there("collision.ego_at_fault"), known_total, min),
    Measure("red_ego", "red lights passed", _if_there("signals.red_ego"), known_total, min),
    Measure("standoffs", "standoffs", _if_there("standoffs"), known_total, min),
    Measure("min_ttc_s", "shortest TTC s", _if_there("safety.min_ttc_s"), least, max),
    Measure("min_headway_s", "shortest headway s", _if_there("safety.min_headway_s"), least, max),
    Measure("ego_comfort", "steps in comfort", _least_kept, mean, max, share=True),
    Measure("ego_progress", "progress, of its log's", _if_there("ego_motion.progress_ratio"), mean, share=True),
)
"""Measures of the ego, which are shown first."""

_FAULT, _CONTROLLED, _GUARDED = "collision.by_fault", "comfort.controlled", "comfort.controlled.guarded"
_COMMANDS = _if_there(f"{_GUARDED}.commands")
_Controlled = partial(Measure, of_control=True)
OF_SIMULATION = (
    Measure("agents", "agents", _at("agents")),
    Measure("colliding_agents", "colliding agents", _at("collision.agents"), better=min),
    Measure("colliding_runs", "colliding runs", lambda run: not run["reactive"], better=min),
    Measure("background_faults", "contacts, background's fault", _if_there(f"{_FAULT}.background"), better=min),
    Measure("ego_faults_avoidable", "ego's fault, other could avoid", _if_there(f"{_FAULT}.ego_avoidable"), better=min),
    Measure("ego_faults_unavoidable", "ego's fault, other could not", _if_there(f"{_FAULT}.ego_unavoidable")),
    Measure("rate_all", "collision rate, all", _at("collision.rate_all"), mean, min, share=True),
    _Controlled(
        "rate_controlled", "collision rate, controlled", _at("collision.rate_controlled"), mean, min, share=True
    ),
    Measure("reactive", "no new contacts", None, better=max, share=True, of_all=True),
    _Controlled("takeovers", "takeovers", _at("takeovers")),
    _Controlled("takeovers_per_run", "takeovers per run", lambda run: float(run["takeovers"]), mean),
    _Controlled("releases", "handed back to their logs", _released),
    _Controlled("released_share", "share handed back", _released, below=_at("takeovers"), share=True),
    _Controlled("releases_missing", "held to the end of the run", _held_to_the_end),
    _Controlled("held_s", "time under control s", lambda run: sum(each["held_s"] for each in run["ledger"])),
    _Controlled("bound_hits", "steps cut short in detection", _at("detection.bound_hits")),
    _Controlled("false_alarms", "false alarms", _at("false_alarms"), better=min),
    _Controlled("relevant_ratio", "taken over near ego", _at("relevant_ratio"), mean, share=True),
    _Controlled("hard_brakes", "hard brakes under control", _at(f"{_CONTROLLED}.hard_brakes")),
    _Controlled("hard_brakes_log", "of the log meanwhile", _if_there(f"{_CONTROLLED}.hard_brakes_log")),
    _Controlled("guarded", "guarded steps of policy C", _at(f"{_GUARDED}.count"), below=_COMMANDS, share=True),
    _Controlled("off_road", "off road, controlled", _at("off_road_controlled"), mean, share=True),
    Measure("progress_m", "progress of all agents m", _at("progress_m"), mean),
    _Controlled("max_position_jump_m", "largest jump m", _at("handback.max_position_jump_m"), largest, min),
    _Controlled("max_residual_m", "largest distance at return m", _at("handback.max_residual_m"), largest, min),
)
"""Measures of the simulation, which are shown on request."""

_WHOSE = {"driven": "driven", "same_log": "of their logs", "log": "of all logs"}
"""Whose driving the branches of `traffic` tell of."""


def _drivers(name: str, title: str, over: str | None = None, *, share: bool = False) -> Iterator[Measure]:
    """Yields a measure of how agents drive, by whose driving: the mean over what `over` counts, or median of the runs'.

    The mean is over all agent-steps of all runs.
    """
    for whose, named in _WHOSE.items():
        at = f"traffic.{whose}"
        figure = _if_there(f"{at}.{name}") if over is None else _sum_of(f"{at}.{name}", f"{at}.{over}")
        yield Measure(
            f"traffic_{whose}.{name}",
            f"{title}, {named}",
            figure,
            middle if over is None else total,
            below=None if over is None else _if_there(f"{at}.{over}"),
            share=share,
            of_control=whose != "log",
        )


TRAFFIC = (
    *_drivers("headway_s", "median headway s"),
    *_drivers("headway_below_half_s", "headway below 0.5 s", "following", share=True),
    *_drivers("gap_m", "median gap m"),
    *_drivers("ttc_below_3_s", "TTC below 3 s", "following", share=True),
    *_drivers("braking_beyond_2_mps2", "braking beyond 2 m/s²", "accelerations", share=True),
    *_drivers("jerk_mps3", "mean jerk m/s³", "jerks"),
    *_drivers("lane_changes_per_minute", "lane changes per minute", "minutes"),
)
"""How agents drive under control, beside the same agents' logs and all of the log."""

NOT_SHOWN = (
    Measure("excess_pairs", "", _at("collision.excess")),
    Measure("realtime_factor", "", _at("timing.realtime_factor"), mean),
    Measure("replay_error_max_m", "", _at("replay_error_max_m"), largest),
)
"""Measures of the summary that no table shows."""

DISPLACEMENTS = tuple(
    Measure(
        f"{path}.{horizon}",
        f"ADE@{horizon} s m, {whose}",
        lambda run, path=path, horizon=horizon: run[path].get(str(horizon)),  # type: ignore[misc]
        mean,
        of_control=whose == "controlled",
    )
    for horizon in HORIZONS_S
    for path, whose in (("ade_controlled_m", "controlled"), ("ade_all_m", "all"))
)
"""Average displacement from the log by horizon, of controlled agents and of all."""


def added() -> Iterator[Measure]:
    """Yields means of the measures that other packages add."""
    better: dict[Better, Callable[[Iterable[float]], float]] = {Better.LOWER: min, Better.HIGHER: max}
    for name, metric in added_metrics().items():
        path = f"{ADDED}.{name}"
        yield Measure(path, title_of(name), _if_there(path), mean, better.get(metric.better))


def measures() -> list[Measure]:
    """Returns all measures that are made of figures of the runs."""
    every = (*OF_SIMULATION, *TRAFFIC, *NOT_SHOWN, *OF_EGO, *DISPLACEMENTS, *added())
    return [measure for measure in every if measure.figure is not None]


def check_summable(metrics: Metrics) -> None:
    """Checks that measures read from a file can be summarised, and that what criteria judge has its type.

    Raises:
        KeyError, TypeError, AttributeError, ValueError: they cannot; a branch is missing or a field has another type.
    """
    for measure in measures():
        for figure in filter(None, (measure.figure, measure.below)):
            figure(metrics)
    steps = [each["detected_step"] for each in metrics["ledger"]]
    steps += [each["step"] for each in metrics["collision"]["contacts"]]
    if max(steps, default=0) > metrics["steps"]:
        raise ValueError(f"a takeover or contact at step {max(steps)}, expected at most {metrics['steps']}")
    kinds = {field.name: field.kinds for field in metric_fields()}
    for name, value in leaves(metrics).items():
        expected = kinds.get(name)
        if value is None or expected is None or type(value) in expected:
            continue
        if not (type(value) is int and float in expected):
            names = " or ".join(sorted(kind.__name__ for kind in expected))
            raise ValueError(f"field {name} is {shown(value)}, expected {names}")


def summarise(runs: Iterable[Metrics], failed: int = 0) -> dict[str, Any]:
    """Returns all measures of the measured runs by name, those of one branch together; None where there are no values.

    Args:
        runs: metrics of the measured runs, valid or not.
        failed: number of runs without metrics. They count in `runs` and in the denominator of `reactive`, the share of
            runs known to be free of excess collisions; all other measures are of the `measured` runs alone, and ADE up
            to a horizon of those that lasted that long: as many as `ade_runs` says.
    """
    runs = list(runs)
    count = len(runs) + failed
    summary: dict[str, Any] = {
        "runs": count,
        "failed": failed,
        "measured": len(runs),
        "invalid": sum(not run["valid"] for run in runs),
        "reactive": sum(run["reactive"] for run in runs) / count if count else None,
        "ade_runs": {str(horizon): sum(str(horizon) in run["ade_all_m"] for run in runs) for horizon in HORIZONS_S},
        ADDED: {},
    }
    for measure in measures():
        branch, _, leaf = measure.name.rpartition(".")
        (summary.setdefault(branch, {}) if branch else summary)[leaf] = measure.value(runs)
    return summary
