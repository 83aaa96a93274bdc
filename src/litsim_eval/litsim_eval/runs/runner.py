"""Runs in process: the cores of the graph's nodes composed without ROS, with bit-identical results."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from litsim_policy.driving.pipeline import Pipeline
from litsim_policy.ego.ego import Ego
from litsim_sim.core import stage_registry
from litsim_sim.core.parameters import Parameters
from litsim_sim.core.scene import AgentTable, ControlTable, EgoCommand
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, StageState
from litsim_sim.core.takeover import TakeoverTable
from litsim_sim.kernels.compiled import load_kernels
from litsim_sim.kernels.garbage import spared_from_collection
from litsim_sim.record.run import Detection, RunInfo, Status
from litsim_sim.record.run import Run as RecordedRun
from litsim_sim.scenario.perception import Perception
from litsim_sim.scenario.run_info import REPLAY, RunPlan
from litsim_sim.world.world import World

if TYPE_CHECKING:
    from litsim_sim.world.sumo import SumoMirror


@dataclass(frozen=True)
class StepResult:
    """A step and the answers to it.

    Attributes:
        table: all agents.
        takeovers, controls: None with policy replay.
        ego: the ego's command.
        stage_s: time of each stage, by the clock of the runner [s].
    """

    table: AgentTable
    takeovers: TakeoverTable | None
    controls: ControlTable | None
    ego: EgoCommand
    stage_s: dict[str, float]


def configured(ego: str | None, policy: str, parameters: Parameters) -> dict[str, Callable[..., Any]]:
    """Returns the constructors of the stages of runs with this policy and this ego, by stage; no ego stage for None.

    Raises:
        InputError: there are parameters of a stage that takes no part, a parameter is unknown to its stage or invalid,
            or the ego is unknown.
    """
    taking_part = () if policy == REPLAY else POLICY_STAGES
    stages = (*taking_part, *(() if ego is None else (EGO,)))
    return stage_registry.configured(stages, parameters, ego or "")


class Runner:
    """Runs a plan in this process, with or without a mirror (libsumo, of which a process can have one).

    `ego`, if given, replaces the ego of the plan; `clock` times the stages [s].

    Raises:
        InputError: a parameter is unknown to its stage or invalid, or a stage cannot be built.
    """

    def __init__(
        self,
        plan: RunPlan,
        mirror: SumoMirror | None = None,
        ego: Ego | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        scenario = plan.scenario
        self.plan, self._clock = plan, clock
        reacts = plan.policy != REPLAY
        stages = configured(None if ego else plan.ego, plan.policy, plan.parameters)
        self.world = World(scenario, mirror, guard_entries=reacts)
        self._ego = ego or stages[EGO](scenario)
        self._perception = Perception(scenario)
        self._pipeline = Pipeline(stages, plan.policy, scenario, clock) if reacts else None
        load_kernels()

    def steps(self) -> Iterator[StepResult]:
        """Yields each step with its answers: all steps of the scenario, or fewer if the run ends early."""
        with spared_from_collection():
            yield from self._steps()

    def _steps(self) -> Iterator[StepResult]:
        """See :meth:`steps`."""
        begin = self._clock()
        table = self.world.reset()
        try:
            for step in range(self.plan.scenario.total_steps + 1):
                self.world.catch_up()
                marks = {BRIDGE: self._clock() - begin}
                takeovers, controls = None, None
                if self._pipeline is not None:
                    takeovers, controls = self._pipeline.to(table, marks)
                begin = self._clock()
                ego = self._ego.plan(self._perception.of(table))
                marks["ego"] = self._clock() - begin
                yield StepResult(table, takeovers, controls, ego, marks)
                begin = self._clock()
                if self.world.ended is not None:
                    return
                if step < self.plan.scenario.total_steps:
                    table = self.world.step(controls or ControlTable.empty(step), ego)
        finally:
            self.world.close()


def record(runner: Runner, progress: Callable[[], object] = lambda: None) -> RecordedRun:
    """Runs to the end and returns the run as if read from a recording.

    Args:
        runner: not yet run.
        progress: called after each step.
    """
    begin = time.perf_counter()
    results = []
    for now in runner.steps():
        results.append(now)
        progress()
    return as_recorded(runner.plan, results, runner.world.summary(), time.perf_counter() - begin)


def as_recorded(plan: RunPlan, results: Sequence[StepResult], summary: Mapping[str, Any], wall_s: float) -> RecordedRun:
    """Returns a run of `plan` as if read from a recording.

    Args:
        plan: of the run.
        results: of all steps.
        summary: of the world.
        wall_s: wall time of the run [s].
    """
    scenario = plan.scenario
    info = RunInfo(**plan.facts(), mode="in-process", topics=(), configuration="", versions="")
    last = results[-1].table.step
    finished = Status(last, BRIDGE, StageState.FINISHED, wall_s, yaml.safe_dump(dict(summary)))
    return RecordedRun(
        path=Path(plan.run_id),
        info=info,
        tables=[r.table for r in results],
        log=scenario.log.replay(last),
        controls={r.table.step: r.controls for r in results if r.controls is not None},
        ego_commands={r.table.step: r.ego for r in results},
        takeovers={r.table.step: list(r.takeovers.takeovers) for r in results if r.takeovers is not None},
        detections={
            r.table.step: Detection(r.takeovers.iterations, r.takeovers.converged)
            for r in results
            if r.takeovers is not None
        },
        timing={stage: {r.table.step: r.stage_s[stage] for r in results} for stage in results[0].stage_s},
        statuses=[finished],
        scenario_yaml=info.scenario_yaml,
        net_xml=scenario.net_path.read_bytes(),
        signals=scenario.signals,
    )
