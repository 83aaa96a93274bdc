"""Batches of a campaign's cases, in which runs are stepped together where possible."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from litsim_eval.campaign.case import GRAPH, Case
from litsim_eval.runs.batched import can_batch, common_parameters, record_batch
from litsim_eval.runs.case_run import measured, plan_of, run_in_process
from litsim_sim.core.errors import reason
from litsim_sim.scenario.batched import kind
from litsim_sim.scenario.run_info import REPLAY, RunPlan

BATCH_MAX = 16
"""Most runs that are stepped together: eight more take 50 MB, and save less than the previous eight."""
STEPS_MAX = 6000
"""Most steps of such runs in total, which bounds the memory of long runs."""

T = TypeVar("T")
Found = dict[str, Any] | str
"""Metrics of a run, or the reason for their absence in one line."""


def batches(cases: Sequence[Case], processes: int) -> list[tuple[Case, ...]]:
    """Divide `cases` into batches for processes, of runs that may be stepped together.

    Runs over DDS get batches of their own. With enough cases there are about two batches per process or more, so that
    all processes end at about the same time; those of pure replay, which are fast, come last.
    """
    groups: dict[Hashable, list[Case]] = {}
    for case in sorted(cases, key=lambda case: case.policy == REPLAY):
        groups.setdefault(case.id if case.execution_mode == GRAPH else (case.policy, str(case.parameters)), []).append(
            case
        )
    most = max(1, min(BATCH_MAX, -(-len(cases) // (2 * processes))))
    return [portion for group in groups.values() for portion in _portions(_by_scenario(group), most)]


def run_batch(cases: Sequence[Case], folders: Sequence[Path | None]) -> list[Found]:
    """Run `cases` in this process, and write their pictures to `folders`; a failure never affects other cases.

    Runs that were stepped together with a failing one are repeated one by one.
    """
    plans: dict[int, RunPlan] = {}
    found: dict[int, Found] = {}
    for k, case in enumerate(cases):
        try:
            plans[k] = plan_of(case)
        except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
            found[k] = reason(error)
    for together in _batchable(plans):
        found |= _run_batched({k: plans[k] for k in together}, folders)
    for k, case in enumerate(cases):
        if k not in found:
            found[k] = _alone(case, folders[k])
    return [found[k] for k in range(len(cases))]


def _portions(of: Sequence[T], most: int) -> Iterator[tuple[T, ...]]:
    """`of` in order, in portions of `most` items; the last one may be smaller."""
    return (tuple(of[begin : begin + most]) for begin in range(0, len(of), most))


def _by_scenario(cases: Sequence[Case]) -> list[Case]:
    return sorted(cases, key=lambda case: case.scenario)


def _batchable(plans: dict[int, RunPlan]) -> Iterator[tuple[int, ...]]:
    """Groups of two or more of the keys of `plans` that can be stepped together."""
    groups: dict[Hashable, list[int]] = {}
    for k, plan in plans.items():
        if not can_batch(plan.policy, plan.parameters):
            continue
        alike = kind(plan.scenario), plan.policy, str(common_parameters(plan))
        groups.setdefault(alike, []).append(k)
    for group in groups.values():
        longest = max(plans[k].scenario.total_steps for k in group)
        yield from (some for some in _portions(group, max(1, min(BATCH_MAX, STEPS_MAX // longest))) if len(some) > 1)


def _run_batched(plans: dict[int, RunPlan], folders: Sequence[Path | None]) -> dict[int, Found]:
    """Results of the runs of `plans`, by their keys; empty if one of them fails."""
    try:
        runs = record_batch(list(plans.values()))
        return {k: measured(run, folders[k]) for k, run in zip(plans, runs, strict=True)}
    except Exception:  # noqa: BLE001 - on its own, each run reports its own error
        return {}


def _alone(case: Case, folder: Path | None) -> Found:
    try:
        return run_in_process(case, folder)
    except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
        return reason(error)
