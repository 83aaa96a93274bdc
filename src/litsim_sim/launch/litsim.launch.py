"""A whole run: `ros2 launch litsim_sim litsim.launch.py scenario:=demo ego:=idm policy:=litsim`.

Starts the nodes that the launcher script `ros2 run litsim_sim launch` starts, with the same parameters, and ends when
the run is over and recorded. `ros2 run litsim_eval analyze OUT` measures it then.
"""

from __future__ import annotations

import os
import shlex
from argparse import ArgumentTypeError
from collections.abc import Callable
from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from litsim_sim.core.errors import InputError
from litsim_sim.core.parameters import one_setting
from litsim_sim.core.stages import BRIDGE, RECORDER
from litsim_sim.core.topic_names import AUTO, INTERFACES
from litsim_sim.launch.domain import hold_for_this_process
from litsim_sim.launch.nodes import MODES, STOP_OR_HOLD, nodes_of
from litsim_sim.launch.output import check_output
from litsim_sim.scenario.policies import policy_choices
from litsim_sim.scenario.run_info import RunPlan, ego_names

NONE = ""  # of an argument that leaves it to the scenario, or to the node

ARGUMENTS = (
    ("scenario", "demo", "name of a packaged scenario, or a YAML file", None),
    ("ego", "idm", "what drives the ego; external: your own stack, over topics", ego_names()),
    ("policy", "litsim", "what moves the background", policy_choices()),
    ("predictor", NONE, "packaged model, or weights", None),
    ("ego_id", NONE, "vehicle of the recording that is the ego; default: the scenario's", None),
    ("seed", NONE, "seed of everything random; default: the scenario's", None),
    ("set", NONE, "parameters of the stages, STAGE.NAME=VALUE, with spaces between; quote one with spaces in it", None),
    ("out", NONE, "folder of the record; default: bags/SCENARIO", None),
    ("overwrite", "false", "replace an existing record", ("true", "false")),
    ("mode", MODES[0], "lockstep: the world waits for answers; realtime: it does not", MODES),
    ("on_missing", STOP_OR_HOLD[0], "in lockstep, after the timeout", STOP_OR_HOLD),
    ("on_invalid", STOP_OR_HOLD[0], "what to do if the ego's answer is invalid", STOP_OR_HOLD),
    ("ego_interface", AUTO, "of an external ego; auto: that of its first message", INTERFACES),
)
"""Name, default, description and choices."""


def generate_launch_description() -> LaunchDescription:
    """Returns the arguments, and the graph that follows from them."""
    declared = [
        DeclareLaunchArgument(
            name,
            default_value=default,
            description=text,
            choices=list(map(str, choices)) if choices else None,
        )
        for name, default, text, choices in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=graph)])


def graph(context: LaunchContext) -> list[object]:
    """Returns the nodes, and what happens when the bridge or the recorder ends.

    Raises:
        InputError: an argument cannot be used; found before anything is started.
    """
    values = {name: LaunchConfiguration(name).perform(context) for name, *_ in ARGUMENTS}
    plan = RunPlan.load(
        values["scenario"],
        values["ego"],
        values["policy"],
        predictor=values["predictor"] or None,
        ego_id=whole("ego_id", values["ego_id"]),
        seed=whole("seed", values["seed"]),
        settings=settings(values["set"]),
    )
    out, overwrite = Path(values["out"] or f"bags/{plan.scenario.name}"), values["overwrite"] == "true"
    bridge = {name: values[name] for name in ("mode", "on_missing", "on_invalid", "ego_interface")}
    nodes = {
        node.name: Node(
            package=node.package, executable=node.executable, parameters=[dict(node.parameters)], output="screen"
        )
        for node in nodes_of(plan, values["scenario"], out, overwrite=overwrite, progress="none", **bridge)
    }
    check_output(out, overwrite)
    hold_for_this_process(whole("ROS_DOMAIN_ID", os.environ.get("ROS_DOMAIN_ID", "")) or 0)
    over = EmitEvent(event=Shutdown(reason=f"the run is over, recorded in {out}"))
    running = {BRIDGE, RECORDER}
    handlers = [
        RegisterEventHandler(OnProcessExit(target_action=nodes[name], on_exit=on_exit(name, running, over)))
        for name in sorted(running)
    ]
    return [*handlers, *nodes.values()]


def whole(name: str, text: str) -> int | None:
    """Returns the whole number that an argument holds; None where it is empty.

    Raises:
        InputError: it holds something else.
    """
    try:
        return int(text) if text else None
    except ValueError:
        raise InputError(f"{name}:={text}: expected a whole number") from None


def settings(text: str) -> list[tuple[str, str, Any]]:
    """Returns stage, name and value of each parameter in `set`, which is split as a shell does.

    Raises:
        InputError: they are not of that form.
    """
    try:
        return [one_setting(setting) for setting in shlex.split(text)]
    except (ArgumentTypeError, ValueError) as error:  # shlex: of quotes that are not closed
        raise InputError(f"set:={text}: {error}") from None


def on_exit(name: str, running: set[str], over: EmitEvent) -> Callable[[Any, object], EmitEvent | None]:
    """Returns what is done when the node `name` ends: `over` once it is the last of those that are `running`.

    The bridge is still closing when the recorder has ended, and a node that is sent SIGINT does not end with 0.
    """

    def ended(event: Any, _: object) -> EmitEvent | None:
        if event.returncode != 0:  # only an exception ends the launch with an exit status that is not 0
            raise RuntimeError(f"node {name} ended with exit status {event.returncode}; the run is not complete")
        running.discard(name)
        return None if running else over

    return ended
