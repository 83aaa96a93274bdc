"""Wall time of a run, how a step spends it on its way through the stages and back, and how soon the ego answers."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from litsim_eval.analysis.measure import (
    ANY_KEY,
    HIGHER,
    LOWER,
    Branch,
    Measure,
    Metrics,
    Row,
    Table,
    family,
    figure_at,
    largest,
    mean,
)
from litsim_sim.core.scene import STEP_S
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES
from litsim_sim.record.run import Run

STEP_MS = 1e3 * STEP_S
Marks = Mapping[str, Mapping[int, Mapping[str, float]]]
"""Clock times [s] by stage, step and mark: `begin` and `answered` for every stage, and more for the bridge."""


@Branch
def timing(run: Run) -> dict[str, Any]:
    """Returns wall time and compute times; the latter without step 0, which includes loading and compilation."""
    wall = run.summary.get("wall_s")
    last = run.tables[-1].step
    path: dict[str, list[float]] = {}
    for step in sorted(step for step in run.marks.get(BRIDGE, {}) if 0 < step < last):
        for name, seconds in step_path(step, run.marks).items():
            path.setdefault(name, []).append(seconds)
    stages = {name: [s for step, s in seconds.items() if step > 0] for name, seconds in sorted(run.timing.items())}
    return {
        "wall_s": wall,
        "realtime_factor": last * run.info.dt / wall if wall else None,
        "stage_ms": _spread(stages),
        "path_ms": _spread(path),
        "answer_ms": _answer_times(run),
    }


def _answer_times(run: Run) -> dict[str, float]:
    """Returns how long the ego takes to answer a step after step 0 [ms]: median, 99th percentile, longest.

    In the graph this is from the step's publication until the bridge has the answer, in process the ego's compute time.
    Empty without answers, or if an earlier version recorded the graph.
    """
    if bridge := run.marks.get(BRIDGE):
        seconds = {
            step: mark["ego"] - mark["shown"] for step, mark in bridge.items() if {"ego", "shown"} <= mark.keys()
        }
    else:
        seconds = dict(run.timing.get(EGO, {}))
    ms = 1e3 * np.array([took for step, took in seconds.items() if step > 0])
    if not len(ms):
        return {}
    return {"median": float(np.median(ms)), "p99": float(np.percentile(ms, 99)), "max": float(ms.max())}


def pace_text(metrics: Metrics) -> str:
    """Returns a sentence if one in a hundred answers of the ego takes longer than a step; empty otherwise."""
    slowest = figure_at("timing.answer_ms.p99")(metrics)
    if slowest is None or slowest <= STEP_MS:
        return ""
    return f"too slow for {1e3 / STEP_MS:g} Hz: one in 100 answers of the ego takes {slowest:.0f} ms or longer"


def _spread(seconds: dict[str, list[float]]) -> dict[str, dict[str, float]]:
    times = {name: 1e3 * np.array(values) for name, values in seconds.items() if values}
    return {
        name: {"min": float(ms.min()), "median": float(np.median(ms)), "max": float(ms.max())}
        for name, ms in times.items()
    }


def step_path(step: int, marks: Marks) -> dict[str, float]:
    """Returns the durations [s] of the parts of one step, in order; empty if marks of a participant are missing.

    A hop between two stages is the serialisation, transport and reading of a message; it is negative where the receiver
    begins before the sender has noted that everything is published. `wait for ego` is the time by
    which the ego answered later than the policy, `recorder` the bridge's wait for the recorder's confirmation. The
    parts add up to `whole step`; the part in brackets runs in parallel.
    """
    now = {stage: mark.get(step, {}) for stage, mark in marks.items()}
    bridge, after = now.get(BRIDGE, {}), marks.get(BRIDGE, {}).get(step + 1, {})
    chain = [stage for stage in POLICY_STAGES if marks.get(stage)]
    ego = now.get(EGO, {}).get("answered")
    if not {"begin", "shown", "free", "answered", "complete"} <= bridge.keys() or "begin" not in after:
        return {}
    if not chain or not all(now[stage] for stage in chain):
        return {}
    last = now[chain[-1]]["answered"]
    ready = max(last, last if ego is None else ego)
    return {
        "bridge publishes": bridge["shown"] - bridge["begin"],
        f"hop to {chain[0]}": now[chain[0]]["begin"] - bridge["shown"],
        chain[0]: now[chain[0]]["answered"] - now[chain[0]]["begin"],
        **{
            name: seconds
            for own, other in pairwise(chain)
            for name, seconds in (
                (f"hop to {other}", now[other]["begin"] - now[own]["answered"]),
                (other, now[other]["answered"] - now[other]["begin"]),
            )
        },
        "wait for ego": ready - last,
        "hop to bridge": bridge["answered"] - ready,
        "recorder": bridge["complete"] - bridge["answered"],
        "world": after["begin"] - bridge["complete"],
        "whole step": after["begin"] - bridge["begin"],
        "(bridge: standard types and SUMO)": bridge["free"] - bridge["shown"],
    }


SPREAD = tuple(f"{ANY_KEY}.{name}" for name in ("min", "median", "max"))
ANSWER = ("median", "p99", "max")
SLOWEST = (Row("ego_answer_p99_ms", largest, Table.EGO, "ego: time to answer, p99", key="p99"),)
NOT_SHOWN = (Row(over=mean, table=Table.NONE),)
MEASURES = family(
    "wall time; simulated time over it",
    Measure("timing.wall_s", timing, "wall time", "s"),
    Measure("timing.realtime_factor", timing, "× real time", "", HIGHER, rows=NOT_SHOWN),
    "minimum, median, maximum of compute time by stage; of the parts of a step's path through the graph (empty in "
    "process and with `replay`)",
    Measure("timing.stage_ms", timing, unit="ms", keys=SPREAD),
    Measure("timing.path_ms", timing, unit="ms", keys=SPREAD),
    "median, 99th percentile, longest time from the publication of a step until the bridge has the ego's answer, with "
    "the bridge's own work meanwhile; in process the ego's compute time; without step 0 and missed answers (empty if a "
    "record of the graph by an earlier version does not tell)",
    Measure("timing.answer_ms", timing, "ego: time to answer, {}", "ms", LOWER, keys=ANSWER, rows=SLOWEST),
)
