"""Runs in process: the cores of the graph's nodes composed without ROS, with bit-identical results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from litsim_sim.core.stages import BRIDGE, StageState
from litsim_sim.record.run import Detection, RunInfo, Status
from litsim_sim.record.run import Run as RecordedRun
from litsim_sim.scenario.mission import ego_mission
from litsim_sim.scenario.run_info import IN_PROCESS, RunPlan
from litsim_sim.simulation import Driver, Simulation, Step

if TYPE_CHECKING:
    from litsim_sim.world.sumo import SumoMirror


def record(
    plan: RunPlan,
    mirror: SumoMirror | None = None,
    ego: Driver | None = None,
    progress: Callable[[], object] = lambda: None,
) -> RecordedRun:
    """Returns the run of a plan, which is made to its end, as if read from a recording; `mirror` is closed.

    Args:
        plan, mirror, ego: as :meth:`.Simulation.of`, errors included.
        progress: called after each step.
    """
    begin = time.perf_counter()
    simulation = Simulation.of(plan, mirror, ego)
    results = []
    with closing(simulation.world):
        for now in simulation.steps():
            results.append(now)
            progress()
    return as_recorded(plan, results, simulation.world.summary(), time.perf_counter() - begin)


def as_recorded(plan: RunPlan, results: Sequence[Step], summary: Mapping[str, Any], wall_s: float) -> RecordedRun:
    """Returns a run of `plan` as if read from a recording.

    Args:
        plan: of the run.
        results: of all steps.
        summary: of the world.
        wall_s: wall time of the run [s].
    """
    scenario = plan.scenario
    info = RunInfo(**plan.facts(), mode=IN_PROCESS, topics=(), configuration="", versions="")
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
        mission=ego_mission(scenario),
    )
