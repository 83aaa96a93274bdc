"""Cases of a campaign that a process runs in one go, as many of them stepped together as can be."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from litsim_policy.run.case_run import measured, plan_of, run_in_process
from litsim_policy.run.together import common_parameters, record_together
from litsim_sim.campaign.case import GRAPH, Case
from litsim_sim.core.errors import reason
from litsim_sim.scenario.joined import kind
from litsim_sim.scenario.run_info import REPLAY, RunPlan

TOGETHER = 16
"""Runs that are stepped together at most: each eight more hold 50 MB, and save less than those before."""
STEPS = 6000
"""Steps of all of them at most: the memory of long runs."""

T = TypeVar("T")
Found = dict[str, Any] | str
"""Metrics of a run, or why there are none, in one line."""


def batches(cases: Sequence[Case], processes: int) -> list[tuple[Case, ...]]:
    """`cases` in the portions in which processes are given them: what can be stepped together is not torn apart.

    Runs over DDS go alone. There are portions for all processes, and so many that a slow one is not waited for long;
    those of pure replay, which are quick, come last.
    """
    groups: dict[Hashable, list[Case]] = {}
    for case in sorted(cases, key=lambda case: case.policy == REPLAY):
        groups.setdefault(case.id if case.shell == GRAPH else (case.policy, str(case.parameters)), []).append(case)
    most = max(1, min(TOGETHER, -(-len(cases) // (2 * processes))))
    return [portion for group in groups.values() for portion in _portions(_by_scenario(group), most)]


def run_batch(cases: Sequence[Case], folders: Sequence[Path | None]) -> list[Found]:
    """What comes of `cases`, which are run in this process; pictures are left in their `folders`.

    A run that fails ends no other: those that were stepped together with it are run alone.
    """
    plans: dict[int, RunPlan] = {}
    found: dict[int, Found] = {}
    for k, case in enumerate(cases):
        try:
            plans[k] = plan_of(case)
        except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
            found[k] = reason(error)
    for together in _joinable(plans):
        found |= _run_joined({k: plans[k] for k in together}, folders)
    for k, case in enumerate(cases):
        if k not in found:
            found[k] = _alone(case, folders[k])
    return [found[k] for k in range(len(cases))]


def _portions(of: Sequence[T], most: int) -> Iterator[tuple[T, ...]]:
    """`of` in order, in portions of `most`; the last may be smaller."""
    return (tuple(of[begin : begin + most]) for begin in range(0, len(of), most))


def _by_scenario(cases: Sequence[Case]) -> list[Case]:
    return sorted(cases, key=lambda case: case.scenario)


def _joinable(plans: dict[int, RunPlan]) -> Iterator[tuple[int, ...]]:
    """Groups of two or more of the keys of `plans` that can be stepped together."""
    groups: dict[Hashable, list[int]] = {}
    for k, plan in plans.items():
        alike = kind(plan.scenario), plan.policy, str(common_parameters(plan))
        groups.setdefault(alike, []).append(k)
    for group in groups.values():
        longest = max(plans[k].scenario.total_steps for k in group)
        yield from (some for some in _portions(group, max(1, min(TOGETHER, STEPS // longest))) if len(some) > 1)


def _run_joined(plans: dict[int, RunPlan], folders: Sequence[Path | None]) -> dict[int, Found]:
    """What comes of the runs of `plans`, by their keys; nothing of any where one fails."""
    try:
        runs = record_together(list(plans.values()))
        return {k: measured(run, folders[k]) for k, run in zip(plans, runs, strict=True)}
    except Exception:  # noqa: BLE001 - run alone, each reports its own error
        return {}


def _alone(case: Case, folder: Path | None) -> Found:
    try:
        return run_in_process(case, folder)
    except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
        return reason(error)
