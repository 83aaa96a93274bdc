"""Several runs at once: their scenes are stepped together in the same arrays, without influence on each other.

The cost of a step is mostly that of its calls, rather than of its agents, so that several scenes cost little more than
one. Scenes can be batched if the stages need the same of all their scenarios; egos may differ.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from litsim_eval.runs.runner import StepResult, as_recorded, configured
from litsim_policy.driving.pipeline import Pipeline
from litsim_policy.driving.policy import policy_class
from litsim_policy.ego.batched import BatchedEgos
from litsim_predictor.models import DEFAULT_MODEL, model_names
from litsim_sim.core import plugins
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import ControlTable
from litsim_sim.core.stages import BRIDGE, EGO, PREDICTOR
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.record.run import Run as RecordedRun
from litsim_sim.scenario.batched import BatchedScenario
from litsim_sim.scenario.run_info import REPLAY, RunPlan
from litsim_sim.world.world import World


class BatchedRunner:
    """Runs S plans together in this process, without SUMO.

    Attributes:
        plans: the plans.
        summaries: the world's summary of each run that is over, by number of the plan; see :meth:`World.summary`.

    Raises:
        ValueError: the plans differ in policy or in parameters other than the ego's, or their scenarios in kind
            (:func:`litsim_sim.scenario.batched.kind`).
        InputError: as :class:`litsim_eval.runs.runner.Runner`.
    """

    def __init__(self, plans: Sequence[RunPlan]) -> None:
        first = plans[0]
        common = common_parameters(first)
        if any((plan.policy, common_parameters(plan)) != (first.policy, common) for plan in plans):
            raise ValueError("runs of different policies or parameters cannot be stepped together")
        self.plans = tuple(plans)
        self._batch = BatchedScenario.of([plan.scenario for plan in plans])
        reacts = first.policy != REPLAY
        self._world = World(self._batch, guard_entries=reacts)
        egos = [configured(plan.ego, plan.policy, plan.parameters)[EGO](plan.scenario) for plan in plans]
        self._egos = BatchedEgos(self._batch, egos)
        stages = configured(None, first.policy, common)
        self._pipeline = Pipeline(stages, first.policy, self._batch) if reacts else None
        self.summaries: dict[int, dict[str, Any]] = {}
        load_kernels()

    def steps(self) -> Iterator[dict[int, StepResult]]:
        """Yield each step of the runs that are not over, with its answers, by number of the plan.

        Wall times of stages are divided equally among the runs.
        """
        begin = time.perf_counter()
        table, batch = self._world.reset(), self._batch
        while len(self.summaries) < len(self.plans):
            self._world.catch_up()
            tables = batch.tables(table)
            marks = {BRIDGE: time.perf_counter() - begin}
            takeovers: Sequence[TakeoverTable | None] = [None] * len(tables)
            controls: Sequence[ControlTable | None] = [None] * len(tables)
            together = ControlTable.empty(table.step)
            if self._pipeline is not None:
                taken, together = self._pipeline.to(table, marks)
                takeovers, controls = self._apart(taken, self._pipeline), batch.controls(together)
            begin = time.perf_counter()
            running = [k for k in range(len(tables)) if k not in self.summaries]
            commands = self._egos.plan(table, running)
            marks[EGO] = time.perf_counter() - begin
            shares = {stage: wall / len(running) for stage, wall in marks.items()}
            yield {k: StepResult(tables[k], takeovers[k], controls[k], commands[k], shares) for k in running}
            begin = time.perf_counter()
            for k in running:
                if self._world.ends[k] is not None or table.step == self.plans[k].scenario.total_steps:
                    self.summaries[k] = self._world.summary(k, batch.recorded_id_in(k))
                    self._world.drop(k)
            if len(self.summaries) < len(self.plans):
                table = self._world.step_batch(together, commands)

    def _apart(self, takeovers: TakeoverTable, pipeline: Pipeline) -> list[TakeoverTable]:
        """The takeovers by scene."""
        rounds = pipeline.manager.iterations.tolist(), pipeline.manager.converged.tolist()
        return [
            TakeoverTable(takeovers.step, own, iterations, converged)
            for own, iterations, converged in zip(self._batch.takeovers(takeovers.takeovers), *rounds, strict=True)
        ]


def can_batch(policy: str, parameters: Parameters) -> bool:
    """Whether the policy and the predictor of a run can drive and forecast the agents of several scenes at once."""
    if policy == REPLAY:
        return True
    model = str(parameters.get(PREDICTOR, {}).get("model", DEFAULT_MODEL))
    predictor = plugins.load(plugins.PREDICTORS, model).batched if model in model_names() else True  # a file's is ours
    return bool(policy_class(policy).batched and predictor)


def common_parameters(plan: RunPlan) -> Parameters:
    """Parameters of the stages that batched runs share: all but the ego."""
    return {stage: values for stage, values in plan.parameters.items() if stage != EGO}


def record_batch(plans: Sequence[RunPlan]) -> list[RecordedRun]:
    """Run `plans` together and return the runs as if read from recordings.

    Raises:
        ValueError, InputError: as :class:`BatchedRunner`.
    """
    begin = time.perf_counter()
    runner = BatchedRunner(plans)
    results: list[list[StepResult]] = [[] for _ in plans]
    for now in runner.steps():
        for k, result in now.items():
            results[k].append(result)
    wall = (time.perf_counter() - begin) / len(plans)
    return [as_recorded(plan, results[k], runner.summaries[k], wall) for k, plan in enumerate(plans)]
