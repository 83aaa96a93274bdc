"""Connect Autoware to the ego port: run the node between them, and after -- the command that starts Autoware."""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time
from contextlib import suppress

from litsim_autoware.stack.profile import CONTROL, TRAJECTORY, Profile, packaged_profiles
from litsim_sim.cli.arguments import DefaultsFormatter, Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import EXIT_FAILED, InputError, print_error
from litsim_sim.launch.child import check_program, how_it_ended

END_S = 3.0  # [s] for the stack to end after SIGINT
WITHOUT_TYPES = (
    "{}: not installed; on stock ROS 2: apt install ros-jazzy-autoware-msgs ros-jazzy-autoware-adapi-v1-msgs; "
    "elsewhere tools/interfaces.sh builds them (docs/autoware.md)"
)


def parser() -> argparse.ArgumentParser:
    """Arguments of ``ros2 run litsim_autoware autoware``."""
    p = Parser(prog="autoware", description=__doc__, formatter_class=DefaultsFormatter)
    p.add_argument("--profile", default="core", help=f"{', '.join(packaged_profiles())}, or a YAML file")
    p.add_argument("--answers", choices=(CONTROL, TRAJECTORY), help="what the ego follows; default: the profile's")
    p.add_argument("command", nargs="*", metavar="COMMAND", help="after --: command that starts Autoware")
    return p


@program
def main(argv: list[str] | None = None) -> int:
    """Entry point of ``ros2 run litsim_autoware autoware``."""
    arguments = parser().parse_args(argv)
    profile = Profile.load(arguments.profile)
    if arguments.answers:
        profile = profile.model_copy(update={"answers": arguments.answers})
    if arguments.command:
        check_program(arguments.command)
    try:
        from litsim_autoware.node.node import AutowareNode
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if not missing.startswith("autoware_"):
            raise
        raise InputError(WITHOUT_TYPES.format(missing)) from error
    from litsim_sim.ros.process import executor_of, process, serve

    sys.argv[1:] = []  # read by rclpy's initialisation
    with process():
        node = AutowareNode(profile)
        executor = executor_of(node)
        stack = subprocess.Popen(arguments.command) if arguments.command else None
        try:
            while not node.finished:
                serve(executor, max(0.0, node.tick(time.perf_counter())))
                if stack is not None and stack.poll() is not None and not node.finished:
                    print_error(f"{arguments.command[0]} {how_it_ended(stack.returncode)}")
                    return stack.returncode if stack.returncode > 0 else EXIT_FAILED
        finally:
            if stack is not None and stack.poll() is None:
                stack.send_signal(signal.SIGINT)
                with suppress(subprocess.TimeoutExpired):
                    stack.wait(END_S)
    return 0
