"""The nodes of a run, with their executables and parameters, independent of how they are started."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from litsim_sim.core import plugins
from litsim_sim.core.errors import InputError
from litsim_sim.core.plugins import configured_stages
from litsim_sim.core.stages import BRIDGE, EGO, POLICY, POLICY_STAGES, RECORDER
from litsim_sim.core.topic_names import AUTO
from litsim_sim.scenario.run_info import EXTERNAL, RunPlan

STAGES_PROGRAM = "stages"
"""Executable of several stages in one process, in the package of the policy's stage; its arguments are their names."""
MODES = ("lockstep", "realtime")
STOP_OR_HOLD = ("stop", "hold")
DRIVER = "driver"
"""Parameter of the ego's node: name of the plug-in that drives."""
DECIDED = {
    EGO: (DRIVER,),
    BRIDGE: (
        *("scenario", "ego", "policy", "ego_id", "seed", "draw"),
        *("end_after_contact_s", "progress", "stage_parameters"),
    ),
    RECORDER: ("output", "overwrite"),
}
"""Parameters that follow from the options of a run; if set otherwise, they would contradict the other nodes."""


@dataclass(frozen=True)
class GraphNode:
    """A node of a run, or several in one process.

    Attributes:
        name: name of its stage, the bridge or the recorder; for several nodes, that of their program.
        package, executable: package and executable of its program.
        parameters: ROS parameters that are not left at the node's defaults, by name; for several nodes, by NODE:NAME.
        several: names of the nodes, if these are several; also the arguments of their program.
    """

    name: str
    package: str
    executable: str
    parameters: Mapping[str, Any]
    several: Sequence[str] = ()


def find_executable(package: str, executable: str) -> Path:
    """Returns the file that ``ros2 run PACKAGE EXECUTABLE`` starts; raises InputError if its package is not built."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix  # campaigns need it over DDS only

    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except PackageNotFoundError as error:
        raise InputError(f"package {package} is not built or not sourced: {error}") from error
    if not path.is_file():
        raise InputError(f"{path}: no such executable; build the workspace (make build)")
    return path


def program_of(stage: str) -> tuple[str, str]:
    """Returns package and executable of the node of a stage: the package registers the stage, and names it so.

    The ego's node and the program of several stages are in the policy's package, whichever plug-in drives.
    """
    return plugins.package_of(plugins.STAGES, POLICY if stage in (EGO, STAGES_PROGRAM) else stage), stage


def nodes_of(
    plan: RunPlan,
    scenario: str,
    out: Path,
    *,
    overwrite: bool = False,
    record: Sequence[str] = (),
    **bridge: str | float,
) -> list[GraphNode]:
    """Returns the nodes of a run in the order to start them in.

    The bridge is the first: it takes longest to get ready, and stages that are late wait for its next greeting. It
    loads `scenario`, a name or file, and has the parameters `bridge` beside those of the plan. Topics `record` of
    the ego's stack are recorded, too, to folder `out`.

    Raises an InputError if a parameter is set of a node that takes no part in this run or does not know it, or does
    not fit, or that the options of the run decide; or the interface of an ego that is not external.
    """
    interface = bridge.get("ego_interface", AUTO)
    if plan.ego != EXTERNAL and interface != AUTO:
        raise InputError(f"--ego-interface {interface}: the ego is {plan.ego}, expected --ego {EXTERNAL}")
    for node, decided in DECIDED.items():
        for name in sorted(set(decided) & set(plan.parameters.get(node, {}))):
            raise InputError(f"parameter {node}.{name} cannot be set: the options of the run decide it")
    names = (BRIDGE, *reversed(plan.stages))
    own = {
        RECORDER: {"output": str(out), "overwrite": overwrite} | ({"topics": " ".join(record)} if record else {}),
        BRIDGE: _of_bridge(plan) | {"scenario": scenario} | bridge,
    }
    parameters = {name: own.get(name, {}) | dict(plan.parameters.get(name, {})) for name in (*own, *plan.parameters)}
    configured_stages(names, parameters, plan.ego)
    if EGO in names:
        parameters[EGO] = {DRIVER: plan.ego} | parameters.get(EGO, {})
    return [GraphNode(name, *program_of(name), parameters.get(name, {})) for name in names]


def in_one_process(nodes: Sequence[GraphNode]) -> list[GraphNode]:
    """Returns the same nodes, all of LitSim's stages in one process: they need not wait for messages of each other."""
    stages = [node for name in (EGO, *POLICY_STAGES) for node in nodes if node.name == name]
    if len(stages) < 2:
        return list(nodes)
    parameters = {f"{node.name}:{name}": value for node in stages for name, value in node.parameters.items()}
    names = tuple(node.name for node in stages)
    shared = GraphNode(STAGES_PROGRAM, *program_of(STAGES_PROGRAM), parameters, names)
    return [*(node for node in nodes if node not in stages), shared]


def _of_bridge(plan: RunPlan) -> dict[str, Any]:
    """Returns the parameters of the bridge that follow from the plan."""
    file = plan.scenario.file
    end = {} if file.end_after_contact_s is None else {"end_after_contact_s": file.end_after_contact_s}
    return {
        "ego": plan.ego,
        "policy": plan.policy,
        "ego_id": plan.scenario.ego_id,
        "seed": plan.scenario.seed,
        "draw": file.draw,
        "stage_parameters": json.dumps(plan.stage_parameters, sort_keys=True),
        **end,
        **{f"vehicle.{name}": value for name, value in file.vehicle.items()},
    }
