"""Several runs at once: their scenes are stepped together in the same arrays, without influence on each other.

The cost of a step is mostly that of its calls, rather than of its agents, so that several scenes cost little more than
one. Scenes can be batched if the stages need the same of all their scenarios; egos may differ.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from litsim_eval.campaign.case import GRAPH, Case
from litsim_eval.runs.case_run import RunOutcome, measured, plan_of, run_in_process
from litsim_eval.runs.in_process import as_recorded
from litsim_predictor.models import DEFAULT_MODEL, model_names
from litsim_sim.core import plugins
from litsim_sim.core.errors import reason
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.stages import EGO, PREDICTOR
from litsim_sim.record.run import Run as RecordedRun
from litsim_sim.scenario.batched import kind
from litsim_sim.scenario.policies import REPLAY, class_of_policy
from litsim_sim.scenario.run_info import RunPlan
from litsim_sim.simulation import Simulation, Step, configured

BATCH_MAX = 16
"""Most runs that are stepped together: eight more take 50 MB, and save less than the previous eight."""
STEPS_MAX = 6000
"""Most steps of such runs in total, which bounds the memory of long runs."""

T = TypeVar("T")


def batch_simulation(plans: Sequence[RunPlan]) -> Simulation:
    """Returns a simulation that steps S plans together in this process, without SUMO.

    Raises:
        ValueError: the plans differ in policy or in parameters other than the ego's, or their scenarios in kind
            (:func:`litsim_sim.scenario.batched.kind`).
        InputError: as :meth:`.Simulation.of`.
    """
    first, common = plans[0], common_parameters(plans[0])
    if any((plan.policy, common_parameters(plan)) != (first.policy, common) for plan in plans):
        raise ValueError("runs of different policies or parameters cannot be stepped together")
    egos = [configured(plan.ego, plan.policy, plan.parameters)[EGO](plan.scenario) for plan in plans]
    return Simulation([plan.scenario for plan in plans], egos, first.policy, common)


def can_batch(policy: str, parameters: Parameters) -> bool:
    """Returns whether policy and predictor of a run can drive and forecast the agents of several scenes at once."""
    if policy == REPLAY:
        return True
    model = str(parameters.get(PREDICTOR, {}).get("model", DEFAULT_MODEL))
    predictor = plugins.load(plugins.PREDICTORS, model).batched if model in model_names() else True  # a file's is ours
    return bool(class_of_policy(policy).batched and predictor)


def common_parameters(plan: RunPlan) -> Parameters:
    """Returns parameters of the stages that batched runs share: all but the ego."""
    return {stage: values for stage, values in plan.parameters.items() if stage != EGO}


def record_batch(plans: Sequence[RunPlan]) -> list[RecordedRun]:
    """Runs `plans` together and returns the runs as if read from recordings.

    Raises:
        ValueError, InputError: as :func:`batch_simulation`.
    """
    begin = time.perf_counter()
    simulation = batch_simulation(plans)
    results: list[list[Step]] = [[] for _ in plans]
    for now in simulation.steps():
        for k, result in simulation.apart(now).items():
            results[k].append(result)
    wall = (time.perf_counter() - begin) / len(plans)
    return [as_recorded(plan, results[k], simulation.summaries[k], wall) for k, plan in enumerate(plans)]


def batches(cases: Sequence[Case], processes: int) -> list[tuple[Case, ...]]:
    """Divides `cases` into batches for processes, of runs that may be stepped together.

    Runs over DDS get batches of their own. With enough cases there are about two batches per process or more, so that
    all processes end at about the same time; those of pure replay, which are fast, come last.
    """
    groups: dict[Hashable, list[Case]] = {}
    for case in sorted(cases, key=lambda case: case.policy == REPLAY):
        key = case.id if case.execution_mode == GRAPH else (case.policy, str(case.parameters))
        groups.setdefault(key, []).append(case)
    most = max(1, min(BATCH_MAX, -(-len(cases) // (2 * processes))))
    return [
        portion
        for group in groups.values()
        for portion in portions(sorted(group, key=lambda case: case.scenario), most)
    ]


def run_batch(cases: Sequence[Case], folders: Sequence[Path | None]) -> list[RunOutcome]:
    """Runs `cases` in this process, and writes their pictures to `folders`; a failure never affects other cases.

    Runs that were stepped together with a failing one are repeated one by one.
    """
    plans: dict[int, RunPlan] = {}
    outcomes: dict[int, RunOutcome] = {}
    for k, case in enumerate(cases):
        try:
            plans[k] = plan_of(case)
        except Exception as error:  # noqa: BLE001 - any error: the other runs go on, and the table reports it
            outcomes[k] = RunOutcome(None, reason(error))
    for group in batchable(plans):
        outcomes |= _run_batched({k: plans[k] for k in group}, folders)
    for k, case in enumerate(cases):
        if k not in outcomes:
            try:
                outcomes[k] = RunOutcome(run_in_process(case, folders[k]))
            except Exception as error:  # noqa: BLE001 - as above
                outcomes[k] = RunOutcome(None, reason(error))
    return [outcomes[k] for k in range(len(cases))]


def portions(of: Sequence[T], most: int) -> Iterator[tuple[T, ...]]:
    """Yields `of` in order, in portions of `most` items; the last one may be smaller."""
    return (tuple(of[begin : begin + most]) for begin in range(0, len(of), most))


def batchable(plans: dict[int, RunPlan]) -> Iterator[tuple[int, ...]]:
    """Yields groups of two or more of the keys of `plans` that can be stepped together."""
    groups: dict[Hashable, list[int]] = {}
    for k, plan in plans.items():
        if not can_batch(plan.policy, plan.parameters):
            continue
        alike = kind(plan.scenario), plan.policy, str(common_parameters(plan))
        groups.setdefault(alike, []).append(k)
    for group in groups.values():
        longest = max(plans[k].scenario.total_steps for k in group)
        yield from (some for some in portions(group, max(1, min(BATCH_MAX, STEPS_MAX // longest))) if len(some) > 1)


def _run_batched(plans: dict[int, RunPlan], folders: Sequence[Path | None]) -> dict[int, RunOutcome]:
    """Returns results of the runs of `plans`, by their keys; empty if one of them fails."""
    try:
        runs = record_batch(list(plans.values()))
        return {k: RunOutcome(measured(run, folders[k])) for k, run in zip(plans, runs, strict=True)}
    except Exception:  # noqa: BLE001 - on its own, each run reports its own error
        return {}
