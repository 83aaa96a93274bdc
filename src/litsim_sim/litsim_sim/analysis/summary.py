"""Summary of several runs: one row of the table that compares policies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from litsim_sim.analysis.displacement import HORIZONS_S


def summarise(runs: Iterable[dict[str, Any]], failed: int = 0) -> dict[str, Any]:
    """One row of the table: sums, means and maxima over the measured runs; None where there are no values.

    Args:
        runs: metrics of the measured runs, valid or not.
        failed: number of runs without metrics. They count in `runs` and in the denominator of `reactive`, the share of
            runs known to be free of excess collisions; all other figures are of the `measured` runs alone, and ADE up
            to a horizon of those that lasted that long: as many as `ade_runs` says.
    """
    runs = list(runs)
    every = len(runs) + failed
    ade = {h: _mean(r["ade_controlled_m"].get(h) for r in runs) for h in map(str, HORIZONS_S)}
    return {
        "runs": every,
        "failed": failed,
        "measured": len(runs),
        "invalid": sum(not r["valid"] for r in runs),
        "agents": _known_sum(r["agents"] for r in runs),
        "colliding_agents": _known_sum(r["collision"]["agents"] for r in runs),
        "colliding_runs": _known_sum(not r["reactive"] for r in runs),
        "excess_pairs": _known_sum(r["collision"]["excess"] for r in runs),
        "ego_contacts": _known_sum(len(r["collision"]["ego_contacts"]) for r in runs),
        "background_faults": _faults(runs, "background"),
        "ego_faults_avoidable": _faults(runs, "ego_avoidable"),
        "ego_faults_unavoidable": _faults(runs, "ego_unavoidable"),
        "rate_all": _mean(r["collision"]["rate_all"] for r in runs),
        "rate_controlled": _mean(r["collision"]["rate_controlled"] for r in runs),
        "reactive": sum(r["reactive"] for r in runs) / every if every else None,
        "takeovers": _known_sum(r["takeovers"] for r in runs),
        "takeovers_per_run": _mean(float(r["takeovers"]) for r in runs),
        "releases": _known_sum(sum(e["released_step"] is not None for e in r["ledger"]) for r in runs),
        "releases_missing": _known_sum(
            sum(e["released_step"] is None and e["outcome"] is None for e in r["ledger"]) for r in runs
        ),
        "held_s": _known_sum(sum(e["held_s"] for e in r["ledger"]) for r in runs),
        "bound_hits": _known_sum(r["detection"]["bound_hits"] for r in runs),
        "false_alarms": _known_sum(r["false_alarms"] for r in runs),
        "relevant_ratio": _mean(r["relevant_ratio"] for r in runs),
        "ade_controlled_m": ade,
        "ade_all_m": {h: _mean(r["ade_all_m"].get(h) for r in runs) for h in ade},
        "ade_runs": {h: sum(h in r["ade_all_m"] for r in runs) for h in ade},
        "replay_error_max_m": max((far for r in runs if (far := r["replay_error_max_m"]) is not None), default=None),
        "hard_brakes": _known_sum(r["comfort"]["controlled"]["hard_brakes"] for r in runs),
        "hard_brakes_log": _known_sum(r["comfort"]["controlled"].get("hard_brakes_log") for r in runs),
        "guarded": _guarded(runs),
        "off_road": _mean(r["off_road_controlled"] for r in runs),
        "progress_m": _mean(r["progress_m"] for r in runs),
        "max_position_jump_m": max((r["handback"]["max_position_jump_m"] for r in runs), default=None),
        "max_residual_m": max(
            (far for r in runs if (far := r["handback"]["max_residual_m"]) is not None), default=None
        ),
        "realtime_factor": _mean(r["timing"]["realtime_factor"] for r in runs),
    }


def _faults(runs: list[dict[str, Any]], whose: str) -> float | None:
    """Number of contacts by fault; None if an older version measured a run without it."""
    return _known_sum(r["collision"].get("by_fault", {}).get(whose) for r in runs)


def _guarded(runs: list[dict[str, Any]]) -> float | None:
    """Share of the policy's commands that a guard changed; None if an older version measured a run without it."""
    found = [r["comfort"]["controlled"]["guarded"] for r in runs]
    commands = _known_sum(each.get("commands") for each in found)
    return sum(each["count"] for each in found) / commands if commands else None


def _known_sum(values: Iterable[float | None]) -> float | None:
    """Sum of `values`; None if there are none, or if one is None since an older version measured the run without it."""
    found = list(values)
    return None if None in found or not found else sum(value for value in found if value is not None)


def _mean(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.mean(known)) if known else None
