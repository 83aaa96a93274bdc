"""`serve`: run one scenario after the other, as a client of simulation_interfaces loads them."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from litsim_sim.cli import launch
from litsim_sim.cli.arguments import Parser
from litsim_sim.cli.program import program
from litsim_sim.core.errors import InputError
from litsim_sim.io.files import make_folder
from litsim_sim.launch.middleware import is_secured


def parser() -> Parser:
    """Returns the parser of ``ros2 run litsim_sim serve``."""
    p = Parser(
        prog="serve",
        description=__doc__,
        usage="serve [-h] [--domain-id N] [--out FOLDER] [--worlds FOLDER] [OPTIONS OF launch] [-- COMMAND ...]",
        epilog="Each run waits at step 0 until the client sets STATE_PLAYING, or makes steps.",
    )
    p.add_argument("--domain-id", type=int, help="default: ROS_DOMAIN_ID, else 0")
    p.add_argument(
        "--out", type=Path, default=Path("bags/served"), metavar="FOLDER", help="of the records (default: bags/served)"
    )
    p.add_argument(
        "--worlds",
        type=Path,
        metavar="FOLDER",
        help="with scenario files that clients may load; default: packaged ones",
    )
    return p


@program
def main(argv: list[str] | None = None) -> None:
    """Entry point of ``ros2 run litsim_sim serve``."""
    words = sys.argv[1:] if argv is None else argv
    end = words.index("--") if "--" in words else len(words)
    arguments, options = parser().parse_known_args(words[:end])
    launch.parser().parse_args(options)  # so that bad ones are refused now
    if is_secured(os.environ):
        raise InputError("serve: the policies of DDS Security do not have its services")
    if arguments.domain_id is not None:
        os.environ["ROS_DOMAIN_ID"] = str(arguments.domain_id)
    if arguments.worlds is not None and not arguments.worlds.is_dir():
        raise InputError(f"{arguments.worlds}: no such folder of scenarios")
    make_folder(arguments.out)
    from litsim_sim.nodes.simulation_server import serve_simulations  # ROS takes a moment to load

    sys.argv[1:] = []  # read by rclpy's initialisation
    serve_simulations(options, words[end + 1 :], arguments.out, arguments.worlds)
