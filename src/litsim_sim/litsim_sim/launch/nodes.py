"""The nodes of a run, with their executables and parameters, independent of how they are started."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from litsim_sim.core.errors import InputError
from litsim_sim.core.stage_registry import configured
from litsim_sim.core.stages import BRIDGE, EGO, POLICY_STAGES, RECORDER
from litsim_sim.ego_port.answer import AUTO
from litsim_sim.launch.executables import program_of, stages_program
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan

MODES = ("lockstep", "realtime")
STOP_OR_HOLD = ("stop", "hold")
DRIVER = "driver"
"""Parameter of the ego's node: name of the plug-in that drives."""
DECIDED = {
    EGO: (DRIVER,),
    BRIDGE: ("scenario", "ego", "policy", "ego_id", "seed", "end_after_contact_s", "progress", "stage_parameters"),
    RECORDER: ("output", "overwrite"),
}
"""Parameters that follow from the options of a run; if set otherwise, they would contradict the other nodes."""


@dataclass(frozen=True)
class GraphOptions:
    """Options of a run over DDS; defaults are those of the bridge's parameters of the same names.

    Attributes:
        scenario: name or file, as the bridge is to load it.
        out: folder of the recording.
        overwrite: whether a recording in `out` may be replaced.
        mode: one of :data:`MODES`.
        on_missing: one of :data:`STOP_OR_HOLD`, for missing answers in lock-step.
        on_invalid: one of :data:`STOP_OR_HOLD`, for answers of the ego that cannot be used.
        ego_interface: interface of an external ego, one of :data:`litsim_sim.ego_port.answer.INTERFACES`.
        answer_timeout_s: time limit for the answers to one step [s].
        clock: whether the bridge publishes the clock.
        real_time_factor: simulated time per wall time.
        record: topics of the ego's stack that are recorded as well.
        progress: bar, lines or none.
    """

    scenario: str
    out: Path
    overwrite: bool = False
    mode: str = MODES[0]
    on_missing: str = STOP_OR_HOLD[0]
    on_invalid: str = STOP_OR_HOLD[0]
    ego_interface: str = AUTO
    answer_timeout_s: float = 5.0
    clock: bool = True
    real_time_factor: float = 1.0
    record: tuple[str, ...] = ()
    progress: str = "lines"


@dataclass(frozen=True)
class GraphNode:
    """A node of a run, or several in one process.

    Attributes:
        name: name of its stage, the bridge or the recorder; for several nodes, that of their program.
        package, executable: package and executable of its program.
        parameters: ROS parameters that are not left at the node's defaults, by name; for several nodes, by NODE:NAME.
        several: executable of each node on its own by the node's name, if these are several.
    """

    name: str
    package: str
    executable: str
    parameters: Mapping[str, Any]
    several: Mapping[str, str] = field(default_factory=dict)


def nodes_of(plan: RunPlan, how: GraphOptions) -> list[GraphNode]:
    """The nodes of a run in the order to start them in: the bridge last, since it waits for all others.

    Raises:
        InputError: a parameter is set of a node that takes no part in this run or does not know it, or does not fit, or
            that the options of the run decide; or the interface of an ego that is not external.
    """
    if plan.ego != EXTERNAL and how.ego_interface != AUTO:
        raise InputError(f"--ego-interface {how.ego_interface}: the ego is {plan.ego}, expected --ego {EXTERNAL}")
    for node, decided in DECIDED.items():
        for name in sorted(set(decided) & set(plan.parameters.get(node, {}))):
            raise InputError(f"parameter {node}.{name} cannot be set: the options of the run decide it")
    names = (*reversed(plan.stages), BRIDGE)
    recorder = {"output": str(how.out), "overwrite": how.overwrite}
    own = {RECORDER: recorder | ({"topics": " ".join(how.record)} if how.record else {}), BRIDGE: _bridge(plan, how)}
    parameters = {name: own.get(name, {}) | dict(plan.parameters.get(name, {})) for name in (*own, *plan.parameters)}
    configured(names, parameters, plan.ego)
    if EGO in names:
        parameters[EGO] = {DRIVER: plan.ego} | parameters.get(EGO, {})
    return [GraphNode(name, *program_of(name), parameters.get(name, {})) for name in names]


def in_one_process(nodes: Sequence[GraphNode]) -> list[GraphNode]:
    """The same nodes, all of LitSim's stages in one process: they need not wait for messages of each other."""
    stages = {node.name: node for name in (EGO, *POLICY_STAGES) for node in nodes if node.name == name}
    if len(stages) < 2:
        return list(nodes)
    parameters = {f"{node.name}:{name}": value for node in stages.values() for name, value in node.parameters.items()}
    executables = {node.name: node.executable for node in stages.values()}
    program = stages_program()
    one = GraphNode(program[1], *program, parameters, executables)
    first = min(nodes.index(node) for node in stages.values())
    return [one if k == first else node for k, node in enumerate(nodes) if k == first or node.name not in stages]


def _bridge(plan: RunPlan, how: GraphOptions) -> dict[str, Any]:
    """Parameters of the bridge."""
    parameters = {
        "scenario": how.scenario,
        "ego": plan.ego,
        "policy": plan.policy,
        "ego_id": plan.scenario.ego_id,
        "seed": plan.scenario.seed,
        "mode": how.mode,
        "on_missing": how.on_missing,
        "on_invalid": how.on_invalid,
        "ego_interface": how.ego_interface,
        "answer_timeout_s": how.answer_timeout_s,
        "progress": how.progress,
        "clock": how.clock,
        "real_time_factor": how.real_time_factor,
        "stage_parameters": json.dumps(plan.stage_parameters, sort_keys=True),
    }
    if (after := plan.scenario.file.end_after_contact_s) is not None:
        parameters["end_after_contact_s"] = after
    return parameters | {f"vehicle.{name}": value for name, value in plan.scenario.file.vehicle.items()}
